"""motion-prediction: predictors of motion over gaps that start at every phase: knee error, and the root's.

Each case tracks one clip with training on another; the truth plays the tracker up to the gap, no image is looked at.
Errors are means over the frames of all gaps, and the largest mean of a single gap. "honest" is the root mean square of
joint errors over stated standard deviations at the last frame of the gap: 1 where the covariance tells the truth.

    TWISTCAP_DATA=... python -m reproduce motion-prediction
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.autoregressive import AutoregressiveMotion
from reproduce.running import Tell
from reproduce.scenes.motion_cases import BODY, Case, opensim_cases, other_cases
from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.evaluate import Row, row
from twistcap.motion import Expected, FollowedMotion, MotionLibrary, MotionPredictor, PaperMotion, motion_predictor
from twistcap.predict import Moment

FIRST = 30  # frames that are seen before the first gap
EVERY = 12  # frames between the starts of two gaps
KNEES = ("knee_angle_r", "knee_angle_l")
UNITS = {"knees": "deg", "knees, worst gap": "deg", "root, at the end": "mm", "root's turn, at the end": "deg",
         "honest": "ratio", "gaps": ""}  # fmt: skip

FINER = tuple(0.5 + 0.02 * k for k in range(76))  # 0.5 … 2.0

METHODS: dict[str, Callable[[MotionLibrary, Body], MotionPredictor]] = {
    "standard": lambda library, body: PaperMotion(library, body, "standard"),
    "unscaled": lambda library, body: PaperMotion(library, body, "unscaled"),
    "scaled (paper)": lambda library, body: PaperMotion(library, body),
    "scaled, m = 10": lambda library, body: PaperMotion(library, body, poses=10),
    "scaled, m = 20": lambda library, body: PaperMotion(library, body, poses=20),
    "scaled, m = 30": lambda library, body: PaperMotion(library, body, poses=30),
    "scaled, steps of 0.02": lambda library, body: PaperMotion(library, body, scales=FINER),
    "autoregressive": AutoregressiveMotion,
    "followed": FollowedMotion,
    "guarded": lambda library, body: motion_predictor("guarded", library, body),
}


@dataclass(frozen=True)
class MotionPrediction:
    """The experiment; it draws no numbers at random, so that seeds change nothing. See `Experiment`."""

    id: str = "motion-prediction"
    says: str = "all predictors of motion over gaps in 14 recorded motions, no image looked at: error of the knees"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """One row for each case, method and measure."""
        del seeds, out
        rows: list[Row] = []
        cases = [*opensim_cases(), *other_cases()]
        for done, case in enumerate(cases, 1):
            library = MotionLibrary.of(case.training, case.tracked.rate, BODY.coordinate_names)
            for name, made in METHODS.items():
                found = errors(made(library, BODY), case, BODY)
                rows += [row(f"{case.name}, {name}", k, value, UNITS[k]) for k, value in found.items()]
            progress(case.name, done, len(cases))
        return Findings(rows, "", ())


def errors(predictor: MotionPredictor, case: Case, body: Body) -> Mapping[str, float]:
    """Knee errors, the root's at the end of the gap, and how honest the covariance is, by name."""
    clip = case.tracked
    moments = [Moment(k / clip.rate, pose) for k, pose in enumerate(clip.poses())]
    gaps = range(FIRST - 1, len(clip) - case.gap - 1, EVERY)
    table = np.array([_gap_errors(predictor, moments, last, case.gap, body) for last in gaps])
    means = table.mean(axis=0)
    return {
        "knees": float(means[0]), "knees, worst gap": float(table[:, 0].max()), "root, at the end": float(means[1]),
        "root's turn, at the end": float(means[2]), "honest": float(np.sqrt(means[3])), "gaps": float(len(table)),
    }  # fmt: skip


def _gap_errors(predictor: MotionPredictor, moments: Sequence[Moment], last: int, gap: int, body: Body) -> Float:
    """(4,) of a gap behind frame `last`: knees, deg; the root at its end, mm and deg; squared z-score of joints."""
    knees, truth = [body.coordinate(name) for name in KNEES], moments[last + 1 : last + 1 + gap]
    found, memory = list[Expected](), None
    for moment in truth:
        expected, memory = predictor.predict(moments[: last + 1], moment.time, memory)
        found.append(expected)
    wrong = np.array([e.pose.q - m.pose.q for e, m in zip(found, truth, strict=True)])
    end, true_root = found[-1], truth[-1].pose.root
    shift = np.linalg.norm(end.pose.root[:3, 3] - true_root[:3, 3])
    turn = np.arccos(np.clip((np.trace(end.pose.root[:3, :3].T @ true_root[:3, :3]) - 1) / 2, -1, 1))
    squared = np.mean(wrong[-1] ** 2 / np.diag(end.covariance)[6:])
    knee = np.degrees(np.abs(wrong[:, knees]).mean())
    return np.array([knee, 1e3 * shift, np.degrees(turn), squared], dtype=np.float64)


MOTION_PREDICTION = MotionPrediction()
