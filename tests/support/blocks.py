"""What tests need of blocks and systems: the step between two values, an arrow as one matrix."""

from __future__ import annotations

from typing import Any

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.solve import Arrow, CameraBlock, PoseTrack, Variables, Vector


def step_between(after: Any, before: Any) -> Float:
    """The step that `retract` needs to come from one value to the other."""
    if isinstance(after, Vector):
        return after.values - before.values
    if isinstance(after, PoseTrack):
        return np.concatenate([a.minus(b) for a, b in zip(after.poses, before.poses, strict=True)])
    if isinstance(after, CameraBlock):
        return se3.difference_one(after.camera.T_cam_world, before.camera.T_cam_world)
    assert isinstance(after, Variables)
    return np.concatenate([step_between(after[name], before[name]) for name in after.free])


def whole_matrix(arrow: Arrow) -> Float:
    """((F D + K), (F D + K)) of an arrow."""
    F, D, K = arrow.border.shape
    out = np.zeros((F * D + K, F * D + K))
    for t in range(F):
        for j in range(min(arrow.reach + 1, F - t)):
            rows, columns = slice((t + j) * D, (t + j + 1) * D), slice(t * D, (t + 1) * D)
            out[rows, columns] = arrow.band[t, j]
            out[columns, rows] = arrow.band[t, j].T
    out[: F * D, F * D :] = arrow.border.reshape(F * D, K)
    out[F * D :, : F * D] = out[: F * D, F * D :].T
    out[F * D :, F * D :] = arrow.corner
    return out
