"""How far contours err together: for the shape, a sequence is worth less than its number of points.

A surface that is not quite the person's shifts the same contour in the same direction in every frame. For a pose this
is the error of one frame. For the shape, which all frames share, n such points are worth ``n / d`` independent ones,
with the design effect ``d = E (Σ w r)² / Σ w`` (Kish, "Survey Sampling", 1965, section 5.4), over groups of one part
of the body in one camera, on one side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap.adjust.refine.measure import CameraRound
from twistcap.body import Posed

_SIDES = 8  # octants of the direction in which a point's residual grows


def design_effect(rounds: Sequence[CameraRound], posed: Sequence[Posed], variance: float) -> float:
    """Factor by which the information of contours about the shape is overcounted, 1 or more.

    Args:
        rounds: of each camera.
        posed: the body in each frame.
        variance: claimed variance of a residual times its information, for points that err independently.
    """
    parts = len(posed[0].body.segment_names)
    squares, information = 0.0, 0.0
    for of_camera in rounds:
        pull, weight = np.zeros(parts * _SIDES), np.zeros(parts * _SIDES)
        for term, at in zip(of_camera.contours, posed, strict=True):
            if term is not None:
                _, points, rows = term.rows(at)
                group = np.resize(points.part, len(rows.residual)) * _SIDES + (rows.gradient > 0.0) @ [1, 2, 4]
                pull += np.bincount(group, rows.weight * rows.residual, len(pull))
                weight += np.bincount(group, rows.weight, len(weight))
        known = weight > 0.0
        squares += float(np.sum(pull[known] ** 2))  # of each group (Σ w r)² / Σ w, the mean weighted by Σ w
        information += float(np.sum(weight[known]))
    return max(1.0, squares / max(information, 1e-12) / variance)
