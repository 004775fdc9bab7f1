"""History across frames without images: what was predicted there, drawn to what was seen on both sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap.body import Pose
from twistcap.predict.history import Moment, constant_velocity


def bridged(history: Sequence[Moment]) -> list[Moment]:
    """The moments from the first seen one to the last, predicted poses between them ending where the seen ones go on.

    A straight line across a gap of half a cycle is no motion of a body and like nothing in a library. A prediction has
    the right form but has drifted: what it is off by when the body is seen again is spread over the gap, growing
    evenly with time.

    Args:
        history: at least one seen moment, the latest last.
    """
    seen = np.flatnonzero([moment.seen for moment in history])
    out = list(history[seen[0] : seen[-1] + 1])
    for a, b in zip(seen[:-1] - seen[0], seen[1:] - seen[0], strict=True):
        if b - a > 1:
            out[a + 1 : b] = _drawn(out[a : b + 1])
    return out


def _drawn(stretch: Sequence[Moment]) -> list[Moment]:
    """The predicted moments between a seen first and last one."""
    first, *predicted, last = stretch
    came = constant_velocity(stretch[:-1], last.time)  # where the prediction would have gone on to
    turn = se3.log(se3.inverse(came.root) @ last.pose.root)
    joints = np.remainder(last.pose.q - came.q + np.pi, 2.0 * np.pi) - np.pi
    shares = [(moment.time - first.time) / (last.time - first.time) for moment in predicted]
    poses = [
        Pose(m.pose.root @ se3.exp(w * turn), m.pose.q + w * joints) for m, w in zip(predicted, shares, strict=True)
    ]
    return [replace(moment, pose=pose) for moment, pose in zip(predicted, poses, strict=True)]
