"""D-7: a cartwheel followed by a flip, tracked with a library of running, cartwheels and flips.

There is one recording of a cartwheel. What is tracked is its mirror image, and that of the flip; what is known are the
recordings as they are, in which the other hand goes first, and other motion beside them.

    TWISTCAP_DATA=... python -m reproduce D-7 --seeds 0-7 --out out/D-7
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reproduce.arms import Arm, Comparison, Trace, by_arm, unsearched
from reproduce.experiments.gaps import MIMIC, RATE, RUN
from reproduce.recorded import Recording
from reproduce.sequence import joint_errors_mm
from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Posed
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import Row, row
from twistcap.motion import MotionClip, MotionLibrary
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.scene import default_body
from twistcap.track import Settings

SEARCHED = "guarded"


ARMS = (
    Arm(SEARCHED, Settings(predictor="motion", motion="guarded")),
    Arm("constant velocity", Settings()),
    Arm("followed", Settings(predictor="motion", motion="followed")),
    Arm("scaled", Settings(predictor="motion", motion="scaled")),
    Arm("guarded, no limb search", Settings(predictor="motion", motion="guarded"), changed=unsearched),
    Arm("constant velocity, no limb search", Settings(), changed=unsearched),
)

BLEND = 10  # frames over which one motion passes into the next
_STEP = 4  # frames by which each pair of seeds begins later
_BEGINNINGS = 12  # of the pairs: the person runs up for 48 frames before the cartwheel


def _mimic(name: str) -> Recording:
    return Recording(f"{MIMIC}_{name}.txt")


CARTWHEEL, FLIPS = _mimic("cartwheel"), (_mimic("sideflip"), _mimic("backflip"))
LIBRARY = (Recording(RUN, last=260), *(_mimic(name) for name in ("cartwheel", "sideflip", "backflip", "roll", "jump")))


def joined(first: MotionClip, second: MotionClip, blend: int = BLEND) -> MotionClip:
    """One motion and then another, which is turned about the vertical and shifted to where the first ends.

    Over `blend` frames joints and root pass from the one to the other smoothly.

    Raises:
        InputError: where a clip is shorter than the blend, or the two differ in coordinates or rate.
    """
    if min(len(first), len(second)) < blend or first.names != second.names or first.rate != second.rate:
        raise InputError(f"motions {first.name!r} and {second.name!r} cannot be joined: lengths, coordinates or rates.")
    ends, begins = first.roots[-blend:], second.roots[:blend]
    carried = _onto(ends[blend // 2], begins[blend // 2])
    weight = np.linspace(0.0, 1.0, blend + 2)[1:-1]
    weight = weight * weight * (3.0 - 2.0 * weight)
    begins = carried @ begins
    roots = ends @ se3.exp(weight[:, None] * se3.log(se3.inverse(ends) @ begins))
    q = first.q[-blend:] + weight[:, None] * (second.q[:blend] - first.q[-blend:])
    return replace(
        first,
        name=f"{first.name}, {second.name}",
        roots=np.concatenate([first.roots[:-blend], roots, carried @ second.roots[blend:]]),
        q=np.concatenate([first.q[:-blend], q, second.q[blend:]]),
    )


def _onto(root: Float, other: Float) -> Float:
    """(4, 4) the turn about the vertical and level shift that bring another root (4, 4) nearest to a root."""
    between = root[:3, :3] @ other[:3, :3].T
    angle = np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
    R = se3.exp_rotation(np.array([0.0, 0.0, angle]))
    return se3.transform(R, (root[:3, 3] - R @ other[:3, 3]) * [1.0, 1.0, 0.0])


@dataclass(frozen=True)
class Acrobatics:
    """Scenes of a mirrored cartwheel and a mirrored flip; even seeds flip sideways, odd ones backward.

    Attributes:
        views: cameras.
    """

    views: int = 4

    def scene(self, seed: int) -> Capture:
        """The capture of a seed: another person and room, begun a little later in the run-up."""
        body = default_body(StudioConfig(seed=seed))
        flip = FLIPS[seed % len(FLIPS)]
        motion = joined(CARTWHEEL.clip(body, RATE).mirrored(), flip.clip(body, RATE).mirrored())
        poses = motion.poses()[_STEP * (seed // len(FLIPS) % _BEGINNINGS) :]
        return capture(StudioConfig(seed=seed, views=self.views, frames=len(poses), fps=RATE), body, poses)

    def library(self, scene: Capture) -> MotionLibrary:
        """Running, and the acrobatics as they were recorded."""
        return MotionLibrary.of([clip.clip(scene.body, RATE) for clip in LIBRARY], RATE)


def _joints_mm(scene: Capture, estimate: Estimate) -> float:
    return float(joint_errors_mm(scene, scene.body, [estimate.pose], [estimate.index]).mean())


def _upright(posed: Posed) -> float:
    """How upright the pelvis is: 1 on one's feet, −1 head down."""
    return float(posed.pose.root[2, 2])


def _rows(traces: Sequence[Trace]) -> list[Row]:
    """Error and number of lost sequences by arm; none may be lost with the limb search."""
    out: list[Row] = []
    for arm in (a.name for a in ARMS):
        found = by_arm(traces, arm)
        errors = [float(t.joints_mm.mean()) for t in found]
        lost = sum(t.lost for t in found)
        out.append(row(f"D-7 {arm}", "joints", float(np.mean(errors)), "mm", seeds=errors, lost=lost))
        bar = 0.0 if arm == SEARCHED else None
        each = [float(t.lost) for t in found]
        out.append(row(f"D-7 {arm}", "lost sequences", float(lost), "", at_most=bar, seeds=each, lost=lost))
    return out


D7 = Comparison(
    "D-7",
    "a cartwheel and then a flip, 4 views, their mirror images, running and other motion known",
    "mean error of the joints, mm",
    Acrobatics().scene,
    ARMS,
    _joints_mm,
    _rows,
    shown=(185, 0),
    watched="uprightness of the pelvis",
    course=_upright,
    motions=Acrobatics().library,
)
