"""Estimates for result files."""

from __future__ import annotations

import numpy as np

from twistcap import se3
from twistcap.body import Body, Landmarks, Pose
from twistcap.estimate import Estimate


def two_links() -> Body:
    """A hinge between two tetrahedra."""
    vertices = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.5]] * 2, float)
    vertices[4:, 2] += 0.5
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    marks = Landmarks(("knee_r", "tip"), np.array([1, 1], np.int32), np.array([[0, 0, 0.5], [0, 0, 1.0]]))
    return Body(
        name="two links",
        coordinate_names=("knee_angle_r", "slide"),
        parent=np.array([-1, 0], np.int32),
        twists=np.array([[0, 1.0, 0, -0.5, 0, 0], [0, 0, 0, 0, 0, 1.0]]),
        limits=np.array([[-2.0, 2.0], [-0.1, 0.1]]),
        segment_names=("base", "arm"),
        segment_joint=np.array([-1, 1], np.int32),
        vertices=vertices,
        faces=np.concatenate([faces, faces + 4]),
        skin_segments=np.repeat(np.array([[0], [1]], np.int32), 4, axis=0),
        skin_weights=np.ones((8, 1)),
        landmarks=marks,
    )


def estimate(k: int) -> Estimate:
    rng = np.random.default_rng(k)
    A = rng.normal(size=(8, 8))
    energies = {"contour": 1.5 * k, **({"late": 2.0} if k > 2 else {})}
    pose = Pose(se3.exp(rng.normal(size=6)), rng.normal(size=2) * 0.1)
    parts = None if k == 2 else np.array([0.25, 0.5])
    doubt = (0.125, parts, (1,) if k == 1 else (), (0, 1)[:k])
    return Estimate(k, k / 60, pose, A @ A.T, energies, "converged", k, k == 3, 0.9, "hold", *doubt)
