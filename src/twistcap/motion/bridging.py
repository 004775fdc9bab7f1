"""History across frames without images: the predictions there, corrected to join the poses on both sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap.body import Pose
from twistcap.predict.history import Moment, constant_velocity


def bridged(history: Sequence[Moment]) -> list[Moment]:
    """The moments from the first to the last with images, with corrected predictions between them.

    A straight line across a gap of half a cycle matches nothing in a library. A prediction has the right form but has
    drifted: its error at the end of the gap is spread over the gap, linear in time.

    Args:
        history: at least one moment with images, the latest last.
    """
    seen = np.flatnonzero([moment.seen for moment in history])
    out = list(history[seen[0] : seen[-1] + 1])
    for a, b in zip(seen[:-1] - seen[0], seen[1:] - seen[0], strict=True):
        if b - a > 1:
            out[a + 1 : b] = _corrected(out[a : b + 1])
    return out


def _corrected(moments: Sequence[Moment]) -> list[Moment]:
    """The predicted moments between a first and a last one with images."""
    first, *predicted, last = moments
    end = constant_velocity(moments[:-1], last.time)  # of the prediction
    turn = se3.log(se3.inverse(end.root) @ last.pose.root)
    joints = np.remainder(last.pose.q - end.q + np.pi, 2.0 * np.pi) - np.pi
    fractions = [(m.time - first.time) / (last.time - first.time) for m in predicted]
    return [
        replace(m, pose=Pose(m.pose.root @ se3.exp(f * turn), m.pose.q + f * joints))
        for m, f in zip(predicted, fractions, strict=True)
    ]
