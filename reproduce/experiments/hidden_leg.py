"""C-4: a leg that no view shows for half a second is lost without a pose prior, and kept with one.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", Fig. 11.7. A third arm shows what of it is the
prior's own doing: there too a hidden part is masked, but nothing replaces it.

    python -m reproduce C-4 --seeds 0-7 --out out/C-4
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reproduce.arms import Arm, Comparison, Trace, by_arm
from reproduce.scenes.disturbed import Board, boarded
from twistcap.body import Posed
from twistcap.cues.visibility import OcclusionRule
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import Row, row
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, Settings

LEG = ("femur_r", "tibia_r", "foot_r")
HIDDEN = (15, 44)  # frames in which no view shows the leg
KNEE = "knee_angle_r"


def _masked(model: Model) -> Model:
    """What a view does not show is taken out, although no prior decides instead."""
    return replace(model, occlusion=OcclusionRule())


WITHOUT, RULE, WITH = "without prior", "hidden rule alone", "with prior"
ARMS = (
    Arm(WITHOUT, Settings()),
    Arm(RULE, Settings(), changed=_masked),
    Arm(WITH, Settings(), "another's walk"),
)


def leg_hidden(seed: int) -> Capture:
    """A walk in four views; boards hide the right leg in all of them."""
    return boarded(capture(StudioConfig(seed=seed, views=4, frames=60)), (Board(LEG, *HIDDEN),))


def _knee_deg(posed: Posed) -> float:
    return float(np.degrees(posed.pose.q[posed.body.coordinate(KNEE)]))


def _error(scene: Capture, estimate: Estimate) -> float:
    truth = Posed(scene.true_body, scene.true_poses[estimate.index])
    return abs(_knee_deg(Posed(scene.body, estimate.pose)) - _knee_deg(truth))


def _rows(traces: Sequence[Trace]) -> list[Row]:
    return [line for arm in dict.fromkeys(t.arm for t in traces) for line in _arm_rows(by_arm(traces, arm))]


def _arm_rows(traces: Sequence[Trace]) -> list[Row]:
    """The lost sequences and the knee: with the prior none may be lost, without it most are to be."""
    arm, lost = traces[0].arm, sum(t.lost for t in traces)
    knees = [float(t.errors[HIDDEN[0] : HIDDEN[1] + 1].mean()) for t in traces]
    after = [float(t.errors[-10:].mean()) for t in traces]
    joints, worst = [float(t.joints_mm.mean()) for t in traces], [float(t.joints_mm.max()) for t in traces]
    most = len(traces) // 2 + 1
    at_most, at_least = (0.0 if arm == WITH else None), (most if arm == WITHOUT else None)
    name, limit = f"C-4 {arm}", (5.0 if arm == WITH else None)
    return [
        row(
            name, "lost sequences", lost, "sequences", at_most=at_most, at_least=at_least,
            seeds=[float(t.lost) for t in traces], lost=lost,
        ),
        row(name, "knee while hidden", float(np.mean(knees)), "deg", at_most=limit, seeds=knees, lost=lost),
        row(name, "joints", float(np.mean(joints)), "mm", seeds=joints),
        row(name, "largest joint error", max(worst), "mm", seeds=worst),
        row(name, "knee, seen again", float(np.mean(after)), "deg", seeds=after),
    ]  # fmt: skip


C4 = Comparison(
    "C-4",
    "a leg hidden for 30 frames in all of 4 views: lost without the pose prior, kept with it",
    "error of the hidden knee, deg",
    leg_hidden,
    ARMS,
    _error,
    _rows,
    shown=(HIDDEN[1], 0),
    watched="angle of the hidden knee, deg",
    course=_knee_deg,
    span=HIDDEN,
)
