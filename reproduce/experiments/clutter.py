"""C-5: fifty rectangles over every image, and a quarter of its pixels noise; two views, with a pose prior.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", Fig. 11.8: "50 varying rectangles with random
position, size, and gray value and 25% uncorrelated pixel noise". Here they have random colours.

    python -m reproduce C-5 --seeds 0-7 --out out/C-5
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reproduce.arms import Arm, Comparison, Trace, by_arm, landmark_error_mm
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import JOINT_CENTRES, Row, row
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Settings

WITHOUT, WITH = "without prior", "with prior"


def cluttered(seed: int) -> Capture:
    """A walk in two views, whose every image is spoilt anew."""
    return capture(StudioConfig(seed=seed, views=2, rectangles=50, uniform_noise=0.25))


def _error(scene: Capture, estimate: Estimate) -> float:
    return landmark_error_mm(scene, estimate, JOINT_CENTRES)


def _rows(traces: Sequence[Trace]) -> list[Row]:
    return [line for arm in dict.fromkeys(t.arm for t in traces) for line in _arm_rows(by_arm(traces, arm))]


def _arm_rows(traces: Sequence[Trace]) -> list[Row]:
    arm, lost = traces[0].arm, [float(t.lost) for t in traces]
    joints, worst = [float(t.joints_mm.mean()) for t in traces], [float(t.joints_mm.max()) for t in traces]
    name, limit = f"C-5 {arm}", (0.0 if arm == WITH else None)
    return [
        row(name, "lost sequences", sum(lost), "sequences", at_most=limit, seeds=lost, lost=int(sum(lost))),
        row(name, "joints", float(np.mean(joints)), "mm", seeds=joints),
        row(name, "largest joint error", max(worst), "mm", seeds=worst),
    ]


C5 = Comparison(
    "C-5",
    "50 rectangles and 25 % uniform noise in every image of 2 views, anew each time: followed with the pose prior",
    "mean joint error, mm",
    cluttered,
    (Arm(WITHOUT, Settings()), Arm(WITH, Settings(), "another's walk")),
    _error,
    _rows,
    shown=(40, 0),
)
