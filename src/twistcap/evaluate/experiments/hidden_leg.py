"""C-4: a leg that no view shows for half a second is lost without a pose prior, and kept with one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twistcap._typing import Float
from twistcap.evaluate import metrics
from twistcap.evaluate.cases import Case
from twistcap.evaluate.experiments.arms import Findings
from twistcap.evaluate.metrics import Row, row
from twistcap.evaluate.parallel import Tell, one_thread_processes
from twistcap.evaluate.sequence import Pictures, joint_errors_mm, tracked
from twistcap.studio import Board, StudioConfig, capture
from twistcap.track import TrackerConfig

LEG = ("femur_r", "tibia_r", "foot_r")
HIDDEN = (15, 44)  # frames in which no view shows the leg
KNEE = "knee_angle_r"

_LEG_HIDDEN = Case(
    "C-4",
    "a walk in 4 views; for 30 frames boards hide the right leg in all of them",
    StudioConfig(views=4, frames=60, boards=(Board(LEG, *HIDDEN),)),
    TrackerConfig(),
    (),
)
ARMS: Mapping[str, Case] = {
    "without prior": _LEG_HIDDEN,
    "with prior": replace(_LEG_HIDDEN, prior="another's walk"),
}


@dataclass(frozen=True)
class HiddenLeg:
    """What one sequence with a hidden leg gave.

    Attributes:
        knee_deg: (N,) error of the hidden knee while it was hidden.
        mean_mm, worst_mm: mean and largest error of the joints over all frames.
        afterwards_deg: its mean error in the last ten frames, when it is seen again.
    """

    knee_deg: Float
    mean_mm: float
    worst_mm: float
    afterwards_deg: float

    @property
    def lost(self) -> bool:
        """Whether the sequence was lost, as everywhere: by its mean joint error."""
        return self.mean_mm > metrics.LOST_SEQUENCE_MM


@dataclass(frozen=True)
class HiddenLegs:
    """The `Experiment`: both arms on every seed."""

    id: str = "C-4"
    says: str = "a leg hidden for 30 frames in all views: lost without the pose prior, kept with it"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """The table; two scenes at a time. There is no picture of it yet."""
        found: dict[int, dict[str, HiddenLeg]] = {}
        with one_thread_processes(min(2, len(seeds))) as pool:
            waiting = {pool.submit(both_arms, seed): seed for seed in seeds}
            for done, future in enumerate(as_completed(waiting), 1):
                found[waiting[future]] = future.result()
                progress(f"{self.id}, seed {waiting[future]}", done, len(seeds))
        return Findings([r for arm in ARMS for r in _rows(arm, [found[seed][arm] for seed in seeds])], "", ())


def both_arms(seed: int) -> dict[str, HiddenLeg]:
    """Both arms on one scene, which is rendered once."""
    pictures = Pictures(capture(replace(_LEG_HIDDEN.studio, seed=seed)))
    return {arm: _followed(case, pictures) for arm, case in ARMS.items()}


def _followed(case: Case, pictures: Pictures) -> HiddenLeg:
    scene = pictures.scene
    body, _, estimates, _ = tracked(case, pictures)
    joints = joint_errors_mm(scene, body, [e.pose for e in estimates], [e.index for e in estimates])
    k = body.coordinate(KNEE)
    true = np.array([scene.true_poses[e.index].q[scene.true_body.coordinate(KNEE)] for e in estimates])
    knee = np.degrees(np.abs(np.array([e.pose.q[k] for e in estimates]) - true))
    return HiddenLeg(
        knee[HIDDEN[0] : HIDDEN[1] + 1], metrics.mean_known(joints), float(joints.max()), float(knee[-10:].mean())
    )


def _rows(arm: str, found: Sequence[HiddenLeg]) -> list[Row]:
    """The lost sequences and the knee: with the prior none may be lost, without it most are to be."""
    helped, most = arm == "with prior", len(found) // 2 + 1
    knees, after = [float(one.knee_deg.mean()) for one in found], [one.afterwards_deg for one in found]
    lost = sum(one.lost for one in found)
    name = f"C-4 {arm}"
    at_most, at_least = (0.0, None) if helped else (None, float(most))
    return [
        row(
            name, "lost sequences", lost, "sequences", at_most=at_most, at_least=at_least,
            seeds=[float(one.lost) for one in found], lost=lost,
        ),
        row(
            name, "knee while hidden", float(np.mean(knees)), "deg", at_most=5.0 if helped else None, seeds=knees,
            lost=lost,
        ),
        row(name, "joints", float(np.mean([o.mean_mm for o in found])), "mm", seeds=[o.mean_mm for o in found]),
        row(name, "largest joint error", max(one.worst_mm for one in found), "mm", seeds=[o.worst_mm for o in found]),
        row(name, "knee, seen again", float(np.mean(after)), "deg", seeds=after),
    ]  # fmt: skip


C4 = HiddenLegs()
