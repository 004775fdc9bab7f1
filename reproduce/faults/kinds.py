"""All kinds of faults, and the take of a seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from reproduce.faults import on_images, on_scene
from reproduce.faults.motions import MOTIONS, Motion
from reproduce.faults.on_images import seeded
from reproduce.faults.staged import staged
from reproduce.faults.take import Take
from twistcap.studio import StudioConfig, capture
from twistcap.studio.scene import default_body

Fault = Callable[[Take, np.random.Generator], Take]

SIZE = (320, 240)  # px: small pictures, the person 160 px high
VIEWS, RATES = (2, 3, 4), (15.0, 30.0, 60.0)
BEFORE, AFTER = (12, 25), (30, 50)  # frames before and after the fault
SHORTEST = 5  # frames of a fault


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    Attributes:
        id, says: its name, and one line about it.
        faults: what happens, one after the other.
        longest: frames of the fault; lengths are drawn evenly in their logarithm.
        ends: whether it ends, so that the body is to be found again.
        studio: what it changes of the studio's settings.
        motions: what the person may do meanwhile.
    """

    id: str
    says: str
    faults: tuple[Fault, ...] = ()
    longest: int = 40
    ends: bool = True
    studio: Mapping[str, Any] = field(default_factory=dict[str, Any])
    motions: Mapping[str, Motion] = field(default_factory=lambda: MOTIONS)


KINDS: tuple[Kind, ...] = (
    Kind("clean", "no fault", ends=False),
    Kind("gap", "no camera has images for 5 to 200 frames", (on_images.gap,), longest=200),
    Kind("leave", "the person leaves all images and comes back from elsewhere", (on_scene.out_and_in,),
         studio={"size": (220, 240)}, motions={"arms": MOTIONS["arms"]}),
    Kind("freeze", "some or all cameras repeat their last picture", (on_images.frozen,)),
    Kind("bump", "one camera is turned by 1 to 5 degrees, for good", (on_images.bump,), ends=False),
)  # fmt: skip


def kind_of(seed: int) -> Kind:
    """Kinds follow each other over the seeds."""
    return KINDS[seed % len(KINDS)]


def take_of(seed: int, kind: Kind | None = None) -> Take:
    """The take of a seed: its person, room, motion, cameras, rate, and a fault at some time and of some length.

    Args:
        seed: of everything.
        kind: of the fault; by default the seed's.
    """
    kind = kind or kind_of(seed)
    plain = plain_take(seed, kind)
    rng = seeded(seed, "fault")
    for fault in kind.faults:
        plain = fault(plain, rng)
    return plain


def plain_take(seed: int, kind: Kind) -> Take:
    """The take before anything happens, with the span in which it will."""
    rng = seeded(seed, "plan")
    before, after = int(rng.integers(*BEFORE)), int(rng.integers(*AFTER))
    length = round(float(np.exp(rng.uniform(np.log(SHORTEST), np.log(kind.longest)))))
    config = StudioConfig(
        seed=seed, views=int(rng.choice(VIEWS)), size=SIZE, frames=before + length + after, fps=float(rng.choice(RATES))
    )
    config, motion = replace(config, **kind.studio), str(rng.choice(list(kind.motions)))
    body = default_body(config)
    poses = kind.motions[motion](body, config.frames, config.fps, rng)
    scene = staged(capture(config, body, poses))
    n, c = config.frames, config.views
    source = np.stack(np.meshgrid(np.arange(n), np.arange(c), indexing="ij"), axis=-1)
    last = before + length - 1 if kind.ends else None
    return Take(kind.id, motion, scene, scene.first_pose, source, (before, last))
