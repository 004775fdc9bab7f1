"""Errors of the tracker's body, cameras and first pose in `mismatch` scenes, as in a laboratory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose
from twistcap.body.kinematics import Posed, skin_points, unit_vertex_normals
from twistcap.body.shape import joints_moved, segment_axes
from twistcap.camera import Camera, Rig

GIRTH = 1.04  # factor of the surface's distance from each segment's axis
BUMPS = 0.004  # m, root mean square of the smooth surface error along the normals
BUMP_WAVE, BUMP_COUNT = 0.15, 24  # m, wavelength of the bumps; number of waves
JOINT_NOISE = 0.006  # m, error of each joint centre, in a random direction
CAMERA_DEG, CAMERA_FOCAL = 0.05, 0.002  # error of each camera's orientation, and relative error of its focal length
POSE_DEG, ROOT_SHIFT, ROOT_DEG = 1.0, 0.005, 1.0  # first pose: uniform ± per joint; error of the root (m, deg)


def wrong_body(body: Body, rng: np.random.Generator) -> Body:
    """The body with girths +4 %, a bumpy surface (4 mm) and joint centres 6 mm off."""
    return with_joint_noise(bumpy(fattened(body, GIRTH), BUMPS, rng), JOINT_NOISE, rng)


def fattened(body: Body, factor: float) -> Body:
    """The surface grown about each segment's own axis; joints and landmarks stay."""
    _, axes = segment_axes(body)
    maps = np.zeros((len(axes), 4, 4))
    for s, axis in enumerate(axes):
        own = body.vertices[body.vertex_part == s]
        centre = own.mean(axis=0) if len(own) else np.zeros(3)
        A = factor * np.eye(3) + (1 - factor) * np.outer(axis, axis)
        maps[s] = se3.transform(A, centre - A @ centre)
    return replace(body, vertices=skin_points(maps, body.skin_segments, body.skin_weights, body.vertices))


def bumpy(body: Body, height: float, rng: np.random.Generator) -> Body:
    """The surface moved along its normals by a random smooth field with a root mean square of `height` m."""
    directions = _directions(rng, BUMP_COUNT)
    phases = rng.uniform(0, 2 * np.pi, BUMP_COUNT)
    field = np.sin(body.vertices @ directions.T * (2 * np.pi / BUMP_WAVE) + phases).sum(axis=1)
    field *= height / np.sqrt(np.mean(field**2))
    normals = unit_vertex_normals(body.vertices, body.faces)
    return replace(body, vertices=body.vertices + np.clip(field, -2 * height, 2 * height)[:, None] * normals)


def with_joint_noise(body: Body, distance: float, rng: np.random.Generator) -> Body:
    """Every joint centre moved, with its landmark, by `distance` (m) in a random direction; see `joints_moved`."""
    jointed = [name for name, joint in zip(body.segment_names, body.segment_joint, strict=True) if joint >= 0]
    return joints_moved(body, {name: distance * _directions(rng, 1)[0] for name in jointed})


def wrong_rig(rig: Rig, rng: np.random.Generator) -> Rig:
    """Every camera turned by 0.05° about a random axis through its centre, its focal length wrong by 0.2 %."""
    wrong: list[Camera] = []
    for camera in rig:
        turn = se3.transform(se3.exp_rotation(np.deg2rad(CAMERA_DEG) * _directions(rng, 1)[0]), np.zeros(3))
        K = camera.K.copy()
        K[[0, 1], [0, 1]] *= 1 + CAMERA_FOCAL * rng.choice([-1.0, 1.0])
        wrong.append(replace(camera, K=K, T_cam_world=turn @ camera.T_cam_world))
    return Rig(tuple(wrong))


def wrong_pose(body: Body, pose: Pose, rng: np.random.Generator) -> Pose:
    """The pose with uniform errors of ± 1° in the joints, the root moved 5 mm and turned 1° about the body's middle."""
    middle = Posed(body, pose).vertices.mean(axis=0)
    turn = se3.exp_rotation(np.deg2rad(ROOT_DEG) * _directions(rng, 1)[0])
    shift = ROOT_SHIFT * _directions(rng, 1)[0]
    motion = se3.transform(turn, middle - turn @ middle + shift)
    q = pose.q + np.deg2rad(rng.uniform(-POSE_DEG, POSE_DEG, size=len(pose.q)))
    return Pose(motion @ pose.root, q).within(body.limits)


def _directions(rng: np.random.Generator, count: int) -> Float:
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
