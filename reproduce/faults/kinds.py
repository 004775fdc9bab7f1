"""All kinds of faults, and the take of a seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from reproduce.faults import on_images as images
from reproduce.faults import on_scene as scenes
from reproduce.faults.motions import MOTIONS, Motion, reach, sit
from reproduce.faults.on_images import seeded
from reproduce.faults.staged import staged
from reproduce.faults.take import Take, own_pictures
from twistcap.errors import InputError
from twistcap.studio import StudioConfig, capture
from twistcap.studio.scene import default_body

Fault = Callable[[Take, np.random.Generator], Take]

SIZE = (320, 240)  # px: small pictures, the person 160 px high
VIEWS, RATES = (2, 3, 4), (15.0, 30.0, 60.0)
_RUN_RATE = 30.0  # least frames per second of a runner
BEFORE, AFTER = (12, 25), (30, 50)  # frames before and after the fault


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    Attributes:
        id, says: its name, and one line about it.
        faults: what happens, one after the other.
        shortest, longest: frames of the fault; lengths are drawn evenly in their logarithm.
        ends: whether it ends, so that the body is to be found again.
        studio: what it changes of the studio's settings.
        motions: what the person may do meanwhile.
        rates: frames per second that it may be filmed at.
    """

    id: str
    says: str
    faults: tuple[Fault, ...] = ()
    shortest: int = 5
    longest: int = 40
    ends: bool = True
    studio: Mapping[str, Any] = field(default_factory=dict[str, Any])
    motions: Mapping[str, Motion] = field(default_factory=lambda: MOTIONS)
    rates: tuple[float, ...] = RATES


KINDS: tuple[Kind, ...] = (
    Kind("clean", "no fault", ends=False),
    Kind("gap", "no camera has images for 5 to 200 frames", (images.gap,), longest=200),
    Kind("leave", "the person leaves all images and comes back from elsewhere", (scenes.out_and_in,),
         studio={"size": (220, 240)}, motions={"arms": MOTIONS["arms"]}),
    Kind("freeze", "some or all cameras repeat their last picture", (images.frozen,)),
    Kind("bump", "one camera is turned by 1 to 5 degrees, for good", (images.bump,), ends=False),
    Kind("blackout", "some cameras, not all, give nothing or black pictures", (images.blackout,)),
    Kind("drops", "10 to 40 % of the images are missing", (images.dropped,)),
    Kind("swap", "two neighbouring cameras give each other's pictures", (images.swapped,)),
    Kind("out of step", "one camera is late by 1 to 5 frames", (images.out_of_step,)),
    Kind("flicker", "the exposure wavers by 50 %", (images.flicker,)),
    Kind("light", "a light is switched, for good", (images.light_switched,), ends=False),
    Kind("crossing, other", "somebody in other clothes walks past in front", (scenes.crossing_other,), 40, 80,
         rates=(15.0, 30.0)),
    Kind("crossing, alike", "somebody in the same clothes walks past in front", (scenes.crossing_alike,), 40, 80,
         rates=(15.0, 30.0)),
    Kind("first pose", "the first pose is 0.3 m beside the person", (scenes.first_pose_beside,)),
    Kind("first limb", "a limb of the first pose is 50 degrees off", (scenes.first_limb_wrong,)),
    Kind("cropped", "arms or shins are out of all pictures", (scenes.cropped,), ends=False,
         motions={"reach": reach, **{name: MOTIONS[name] for name in ("walk", "knee bends")}}),
    Kind("jerks", "the person moves in jerks", (scenes.jerks,)),
    Kind("noise", "25 to 70 % of all pixels are noise", (images.grain,)),
    Kind("hard", "person and room have nearly the same colours", ends=False, studio={"hard": True}),
    Kind("one colour", "the whole person has one colour", ends=False, studio={"one_colour": True}),
    Kind("dark chair", "dark trousers on a dark chair", (scenes.dark_chair,), ends=False, motions={"sit": sit}),
    Kind("two faults", "two faults of cameras and lights at once", (scenes.two_at_once,)),
)  # fmt: skip


def kind_of(seed: int) -> Kind:
    """Kinds follow each other over the seeds."""
    return KINDS[seed % len(KINDS)]


def kind_named(name: str) -> Kind:
    """The kind of a name.

    Raises:
        InputError: where there is none.
    """
    for kind in KINDS:
        if kind.id == name:
            return kind
    raise InputError(f"there is no kind of fault {name!r}; choose one of {', '.join(kind.id for kind in KINDS)}.")


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
    length = round(float(np.exp(rng.uniform(np.log(kind.shortest), np.log(kind.longest)))))
    config = StudioConfig(
        seed=seed,
        views=int(rng.choice(VIEWS)),
        size=SIZE,
        frames=before + length + after,
        fps=float(rng.choice(kind.rates)),
    )
    config, motion = replace(config, **kind.studio), str(rng.choice(list(kind.motions)))
    if motion == "run":  # at 15 per second the tracker loses a runner without any fault
        config = replace(config, fps=max(config.fps, _RUN_RATE))
    body = default_body(config)
    poses = kind.motions[motion](body, config.frames, config.fps, rng)
    scene = staged(capture(config, body, poses))
    source = own_pictures(config.frames, config.views)
    last = before + length - 1 if kind.ends else None
    return Take(kind.id, motion, scene, scene.first_pose, source, (before, last))
