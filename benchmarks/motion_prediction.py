"""Open-loop prediction over gaps that start at every phase: knee error, and the root's, of all predictors.

    python benchmarks/motion_prediction.py [--every 3] [--json]

Each case tracks one clip with training on another; the truth plays the tracker up to the gap, no image is looked at.
Errors are means over the frames of all gaps, and the largest mean of a single gap. `honest` is the root mean square
of joint errors over stated standard deviations at the last frame of the gap: 1 where the covariance tells the truth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from reproduce.arrays import Float
from twistcap.body import Body
from twistcap.motion import (
    AutoregressiveMotion,
    FollowedMotion,
    MotionClip,
    MotionLibrary,
    MotionPredictor,
    PaperMotion,
    motion_predictor,
)
from twistcap.predict import Moment

FIRST = 30  # frames that are seen before the first gap
KNEES = ("knee_angle_r", "knee_angle_l")


@dataclass(frozen=True)
class Case:
    """A clip that is tracked, what is learnt from, and how long the gaps are (frames)."""

    name: str
    tracked: MotionClip
    training: tuple[MotionClip, ...]
    gap: int


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


def errors(predictor: MotionPredictor, case: Case, body: Body, every: int) -> dict[str, float]:
    """Knee errors (deg), the root's at the end of the gap (mm, deg), and how honest the covariance is."""
    clip, rows = case.tracked, list[Float]()
    moments = [Moment(k / clip.rate, pose) for k, pose in enumerate(clip.poses())]
    knees = [body.coordinate(name) for name in KNEES]
    for last in range(FIRST - 1, len(clip) - case.gap - 1, every):
        found = [predictor.predict(moments[: last + 1], m.time) for m in moments[last + 1 : last + 1 + case.gap]]
        truth = moments[last + 1 : last + 1 + case.gap]
        wrong = np.array([e.pose.q - m.pose.q for e, m in zip(found, truth, strict=True)])
        end, true_root = found[-1], truth[-1].pose.root
        shift = np.linalg.norm(end.pose.root[:3, 3] - true_root[:3, 3])
        turn = np.arccos(np.clip((np.trace(end.pose.root[:3, :3].T @ true_root[:3, :3]) - 1) / 2, -1, 1))
        honest = np.mean(wrong[-1] ** 2 / np.diag(end.covariance)[6:])
        rows.append(
            np.array(
                [np.degrees(np.abs(wrong[:, knees]).mean()), 1e3 * shift, np.degrees(turn), honest], dtype=np.float64
            )
        )
    table = np.array(rows)
    return {
        "knee_deg": float(table[:, 0].mean()), "worst_knee_deg": float(table[:, 0].max()),
        "root_mm": float(table[:, 1].mean()), "root_deg": float(table[:, 2].mean()),
        "honest": float(np.sqrt(table[:, 3].mean())), "gaps": len(table),
    }  # fmt: skip


def compare(
    cases: Iterable[Case], body: Body, every: int, as_json: bool = False, methods: Iterable[str] = METHODS
) -> None:
    """Print one row per case and method."""
    rows: list[dict[str, object]] = []
    for case in cases:
        library = MotionLibrary.of(case.training, case.tracked.rate, body.coordinate_names)
        for name in methods:
            found = errors(METHODS[name](library, body), case, body, every)
            rows.append({"case": case.name, "method": name, **found})
            if not as_json:
                cells = "  ".join(f"{key} {value:.2f}" for key, value in found.items())
                print(f"{case.name:>24}  {name:>14}  {cells}", flush=True)
    if as_json:
        print(json.dumps(rows, indent=1))


def main() -> None:
    """The cases of shared data that the repository can read."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--every", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=list(METHODS))
    given = parser.parse_args()
    from motion_cases import BODY, opensim_cases, other_cases

    compare([*opensim_cases(), *other_cases()], BODY, given.every, given.json, given.methods)


if __name__ == "__main__":
    main()
