"""From scaled views to calibrated cameras and back: where the body stands in the world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.camera import Camera, ScaledView
from twistcap.differential.state import State

_DEPTH = 1e-3
"""Information of a view along its ray against across it: scale tells depth badly, so that other views decide it."""


def state_of(pose: Pose, cameras: Iterable[Camera], perspective: bool = False) -> State:
    """The state of a body at a pose before calibrated cameras, distortion left out.

    With `perspective` the views are those of the pinholes, else scaled orthography.
    """
    return State(tuple(ScaledView.of(camera, pose.root, perspective) for camera in cameras), pose.q)


def world_pose(state: State, cameras: Sequence[Camera]) -> Pose:
    """The pose in the world that all views together tell; one view's depth follows from its scale.

    Each view has turns of its own in the tracker; the mean of their rotations is taken (in the chordal sense), and the
    point that is nearest to all of their rays.
    """
    roots = [view.root(camera) for view, camera in zip(state.views, cameras, strict=True)]
    U, _, Vt = np.linalg.svd(np.sum([root[:3, :3] for root in roots], axis=0))
    rotation = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Pose(se3.transform(rotation, _nearest([root[:3, 3] for root in roots], cameras)), state.q)


def _nearest(points: Sequence[Float], cameras: Sequence[Camera]) -> Float:
    A, b = np.zeros((3, 3)), np.zeros(3)
    for point, camera in zip(points, cameras, strict=True):
        ray = point - camera.centre
        ray /= np.linalg.norm(ray)
        weight = np.eye(3) - (1.0 - _DEPTH) * np.outer(ray, ray)
        A += weight
        b += weight @ point
    return np.asarray(np.linalg.solve(A, b), np.float64)
