"""A bumped camera and a late clock, found from keypoints of a moving person with the other cameras as gauge."""

from __future__ import annotations

import numpy as np
import pytest

from support.blocks import FixedShape, step_between
from twistcap.camera import Camera
from twistcap.solve import Arrow, BlockProblem, CameraBlock, PoseTrack, Variables, Vector, minimise
from twistcap.studio import StudioConfig, capture
from twistcap.terms import GaussianTerm, OnPose, ReprojectionTerm

Array = np.ndarray
FINE, LATE, BUMPED = 5, 2, 3  # moments between two frames; by how many of them the bumped camera is late; which it is
FPS, NOISE_PX = 25.0, 0.2


@pytest.mark.parametrize("focal", [False, True])
def test_a_bumped_camera_and_a_late_clock_are_found(focal: bool) -> None:
    """2 degrees, 3 cm and 0.4 frames; of a true motion, which is no straight line between two frames."""
    scene = capture(StudioConfig(seed=2, views=4, frames=FINE * 7, fps=FINE * FPS))
    rng, body, cameras = np.random.default_rng(0), scene.true_body, [c.pinhole() for c in scene.true_rig]
    moments = range(0, FINE * 6, FINE)
    truth = PoseTrack(tuple(scene.true_poses[k] for k in moments), np.arange(len(moments)) / FPS)
    bump = np.r_[np.deg2rad(2.0) * unit(rng), 0.03 * unit(rng), 0.03][: 7 if focal else 6]
    terms = [
        keypoints(scene.landmarks[k + (LATE if c == BUMPED else 0)], camera, c, t, rng)
        for t, k in enumerate(moments)
        for c, camera in enumerate(cameras)
    ]
    wide = np.diag(np.r_[np.full(6, 1e-6), np.full(body.dof - 6, np.deg2rad(30.0) ** -2.0)])  # what no landmark tells
    terms += [OnPose(GaussianTerm(pose, wide), body, frame=t) for t, pose in enumerate(truth.poses)]
    blocks = {f"camera {c}": CameraBlock(camera) for c, camera in enumerate(cameras)}
    there = CameraBlock(cameras[BUMPED], focal)
    blocks |= {f"camera {BUMPED}": there.retract(bump), "clock": Vector(np.zeros(1)), "shape": FixedShape(body)}
    start = truth.retract(0.02 * rng.normal(size=truth.dof))
    x = Variables({"poses": start, **blocks}, ("poses", f"camera {BUMPED}", "clock"), longest={"clock": 0.5 / FPS})
    found = minimise(BlockProblem(terms, reach=1), x, steps=30, damping=1e-6, gain=1e-5)
    assert found.status == "converged"

    off, late = step_between(found.x[f"camera {BUMPED}"], there), found.x["clock"].values[0]
    if not focal:  # which a person in the middle of the ring hardly tells from the distance
        assert np.rad2deg(np.linalg.norm(off[:3])) < 0.15 and np.linalg.norm(off[3:6]) < 0.011
    shift = (
        found.x[f"camera {BUMPED}"].camera.project(scene.landmarks[0])[0] - there.camera.project(scene.landmarks[0])[0]
    )
    assert np.linalg.norm(shift, axis=1).max() < 0.3
    assert late * FPS == pytest.approx(LATE / FINE, abs=0.004)
    system = found.system
    assert isinstance(system, Arrow)
    marginals = system.marginals()
    error = np.r_[off, late - LATE / FINE / FPS]
    assert error @ np.linalg.solve(marginals.shared, error) < 30  # of 7 or 8 degrees of freedom
    steps = np.array([a.minus(b) for a, b in zip(found.x["poses"].poses, truth.poses, strict=True)])
    roots = np.abs(steps[:, 3:6]) / np.sqrt(np.diagonal(marginals.poses, axis1=1, axis2=2)[:, 3:6])
    assert np.median(roots) < 2.0


def keypoints(landmarks: Array, camera: Camera, c: int, frame: int, rng: np.random.Generator) -> ReprojectionTerm:
    pixels = camera.project(landmarks)[0]
    pixels = pixels + NOISE_PX * rng.normal(size=pixels.shape)
    one = np.ones(len(pixels))
    clock = "clock" if c == BUMPED else None
    marks = np.arange(len(pixels), dtype=np.int32)
    return ReprojectionTerm(marks, pixels, one, NOISE_PX * one, 100.0, f"camera {c}", frame=frame, clock=clock)


def unit(rng: np.random.Generator) -> Array:
    x = rng.normal(size=3)
    return x / np.linalg.norm(x)
