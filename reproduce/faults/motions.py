"""What the filmed people do; every motion stays near one place, so that cameras can stay near too."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from reproduce.scenes.subjects import limbering, squats
from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.studio.motion import gait

Motion = Callable[[Body, int, float, np.random.Generator], list[Pose]]
"""Body, frames, frames per second and random numbers to poses."""

_EXERCISE = 5.0  # s, of all joints swung
_SQUAT = 2.5  # s, of one knee bend
_ARM_JOINTS = {"arm_add": (-50, 30), "arm_flex": (40, 55), "arm_rot": (0, 30), "elbow_flex": (60, 50)}  # middle, ± deg


def walk(body: Body, frames: int, fps: float, rng: np.random.Generator) -> list[Pose]:
    """A walk round a circle of 1.6 to 2.4 m."""
    speed, phase, radius = rng.uniform(0.9, 1.5), rng.uniform(), rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 1.2)
    straight = gait(body, fps=fps, frames=frames, speed=float(speed), phase=float(phase))
    return [_bent(pose, 1.0 / float(radius)) for pose in straight]


def run(body: Body, frames: int, fps: float, rng: np.random.Generator) -> list[Pose]:
    """Jogging on a treadmill, elbows bent."""
    speed = float(rng.uniform(2.2, 2.8))
    poses = gait(body, fps=fps, frames=frames, speed=speed, phase=float(rng.uniform()))
    bend = _added(body, {"elbow_flex_r": 60.0, "elbow_flex_l": 60.0, "lumbar_extension": -8.0})
    still = [se3.transform(np.eye(3), np.array([-speed * k / fps, 0.0, 0.0])) for k in range(frames)]
    return [Pose(T @ pose.root, pose.q + bend).within(body.limits) for T, pose in zip(still, poses, strict=True)]


def arms(body: Body, frames: int, fps: float, rng: np.random.Generator) -> list[Pose]:
    """Somebody stands and moves both arms, each joint at its own pace."""
    time, q = np.arange(frames) / fps, np.zeros((frames, len(body.coordinate_names)))
    for joint, (middle, swing) in _ARM_JOINTS.items():
        for side in ("r", "l"):
            pace, phase = rng.uniform(0.2, 0.5), rng.uniform(0, 2 * np.pi)
            degrees = middle + swing * np.sin(2 * np.pi * pace * time + phase)
            q[:, body.coordinate(f"{joint}_{side}")] = np.deg2rad(degrees)
    return standing(body, q)


def exercise(body: Body, frames: int, fps: float, rng: np.random.Generator) -> list[Pose]:
    """Every joint swung through much of its range."""
    period = round(_EXERCISE * fps)
    lift = np.array([0.0, 0.0, -float(body.vertices[:, 2].min())])
    poses, first = moved(limbering(body, period), 0.0, lift), int(rng.integers(period))
    return [poses[(first + k) % period] for k in range(frames)]


def bends(body: Body, frames: int, fps: float, rng: np.random.Generator) -> list[Pose]:
    """Knee bends with the arms held forward."""
    period = round(_SQUAT * fps)
    q, first = squats(body, period, 1), int(rng.integers(period))
    return standing(body, q[(first + np.arange(frames)) % period])


def reach(body: Body, frames: int, fps: float, rng: np.random.Generator) -> list[Pose]:
    """Somebody stands and raises the arms above the head, one after the other, and lowers them."""
    time, q = np.arange(frames) / fps, np.zeros((frames, len(body.coordinate_names)))
    pace, phase = rng.uniform(0.25, 0.4), rng.uniform(0, 2 * np.pi)
    for side, lag in (("r", 0.0), ("l", rng.uniform(1.0, np.pi))):
        q[:, body.coordinate(f"arm_flex_{side}")] = np.deg2rad(90 + 75 * np.sin(2 * np.pi * pace * time + phase - lag))
        q[:, body.coordinate(f"arm_add_{side}")], q[:, body.coordinate(f"elbow_flex_{side}")] = -0.25, 0.35
    return standing(body, q)


def sit(body: Body, frames: int, fps: float, rng: np.random.Generator) -> list[Pose]:
    """Somebody sits, moves the arms, and leans and stretches the knees a little."""
    moving = arms(body, frames, fps, rng)
    time, pace, phase = np.arange(frames) / fps, rng.uniform(0.2, 0.4), rng.uniform(0, 2 * np.pi)
    wave = np.sin(2 * np.pi * pace * time + phase)
    out = np.stack([pose.q for pose in moving])
    out[:, body.coordinate("lumbar_extension")] = np.deg2rad(-5 + 8 * wave)
    for side, lift in (("r", wave), ("l", -wave)):
        out[:, body.coordinate(f"hip_flexion_{side}")] = np.deg2rad(85)
        out[:, body.coordinate(f"knee_angle_{side}")] = np.deg2rad(80 - 20 * np.maximum(lift, 0.0))
        out[:, body.coordinate(f"arm_flex_{side}")] *= 0.7
    low = float(Posed(body, Pose(np.eye(4), out[0])).vertices[:, 2].min())
    root = se3.transform(np.eye(3), np.array([0.0, 0.0, 0.02 - low]))
    return [Pose(root, q).within(body.limits) for q in out]


MOTIONS: dict[str, Motion] = {"walk": walk, "run": run, "arms": arms, "exercise": exercise, "knee bends": bends}


def standing(body: Body, q: Float) -> list[Pose]:
    """Poses of joint angles (N, J), each with its lowest point on the floor."""
    out: list[Pose] = []
    for angles in np.clip(q, body.limits[:, 0], body.limits[:, 1]):
        low = float(Posed(body, Pose(np.eye(4), angles)).vertices[:, 2].min())
        out.append(Pose(se3.transform(np.eye(3), np.array([0.0, 0.0, -low])), angles))
    return out


def jerked(body: Body, poses: list[Pose], size_deg: float, rng: np.random.Generator) -> list[Pose]:
    """The poses with random jerks of every joint, of `size_deg` standard deviation, a few frames long."""
    raw = rng.standard_normal((len(poses) + 4, len(body.coordinate_names)))
    smooth = np.stack([np.convolve(column, np.ones(3) / np.sqrt(3), "valid") for column in raw.T], axis=1)
    return [
        Pose(pose.root, pose.q + np.deg2rad(size_deg) * extra).within(body.limits)
        for pose, extra in zip(poses, smooth, strict=False)
    ]


def moved(poses: list[Pose], heading: float, place: Float) -> list[Pose]:
    """The poses turned by `heading` rad about the vertical through the origin, then shifted by `place` (3,) m."""
    T = se3.transform(se3.exp_rotation(np.array([0.0, 0.0, heading])), place)
    return [Pose(T @ pose.root, pose.q) for pose in poses]


def _bent(pose: Pose, curvature: float) -> Pose:
    """A pose of a walk along x, on a circle instead."""
    x, y, z = pose.root[:3, 3]
    angle = float(curvature * x)
    s, c = np.sin(angle), np.cos(angle)
    place = np.array([s / curvature - y * s, (1 - c) / curvature + y * c, z])
    return Pose(se3.transform(se3.exp_rotation(np.array([0.0, 0.0, angle])) @ pose.root[:3, :3], place), pose.q)


def _added(body: Body, degrees: dict[str, float]) -> Float:
    out = np.zeros(len(body.coordinate_names))
    for name, value in degrees.items():
        out[body.coordinate(name)] = np.deg2rad(value)
    return out
