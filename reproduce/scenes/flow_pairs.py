"""Pairs of images with exact optic flow: a studio body in two consecutive frames, its visible points followed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Bool, Float32, UInt8
from twistcap.body import Body, Pose, Posed
from twistcap.render import render
from twistcap.studio import StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.scene import Capture, default_body, default_poses

CROP = (150, 250)  # width and height, px
_WALK = 3.0  # times real speed at 60 frames a second: what 20 frames a second see
_LARGEST = 30.0  # px that the fastest point of a fast scene moves
# Degrees by which a swing of 1 turns the joints of one side; the elbow and the knee of a blow and a kick stretch.
_SWING = {"arm_flex": 60.0, "arm_add": -30.0, "elbow_flex": -30.0, "hip_flexion": 40.0, "knee_angle": -30.0}


@dataclass(frozen=True)
class FlowPair:
    """Two grey images (H, W) uint8, the body's mask (H, W) in the first, and its true flow (H, W, 2) px, NaN off it."""

    first: UInt8
    second: UInt8
    mask: Bool
    flow: Float32

    @property
    def largest(self) -> float:
        """Length of the longest flow vector, px."""
        return float(np.nanmax(np.linalg.norm(self.flow, axis=-1)))


def flow_pair(seed: int, fast: bool) -> FlowPair:
    """A walk at three times real speed, or (`fast`) one arm and one leg thrown so that some point moves 30 px."""
    config = StudioConfig(seed=seed, views=2, frames=2, colour=False, speed_factor=_WALK)
    body, heading = default_body(config), float(stream(seed, "heading").uniform(0, 2 * np.pi))
    poses = default_poses(config, body, heading)
    if not fast:
        return _pair(capture(config, body, poses))
    low, high, scene = 0.0, 2.0, capture(config, body, poses)
    for _ in range(12):
        swing = 0.5 * (low + high)
        scene = capture(config, body, [poses[0], _thrown(body, poses[0], swing, seed)])
        low, high = (swing, high) if _largest_motion(scene) < _LARGEST else (low, swing)
    return _pair(scene)


def _thrown(body: Body, pose: Pose, swing: float, seed: int) -> Pose:
    arm, leg = ("r", "l") if seed % 2 else ("l", "r")
    q = pose.q.copy()
    for name, degrees in _SWING.items():
        q[body.coordinate(f"{name}_{leg if name in ('hip_flexion', 'knee_angle') else arm}")] += np.deg2rad(
            swing * degrees
        )
    return replace(pose, q=q)


def _largest_motion(scene: Capture) -> float:
    first, second = (scene.true_rig[0].project(Posed(scene.true_body, p).vertices)[0] for p in scene.true_poses)
    return float(np.linalg.norm(second - first, axis=1).max())


def _pair(scene: Capture) -> FlowPair:
    camera = scene.true_rig[0]
    before, after = (Posed(scene.true_body, pose) for pose in scene.true_poses)
    seen = render(before, camera)
    rows, columns = (axis.astype(np.int32) for axis in np.nonzero(seen.mask))
    pixels, _ = camera.project(seen.surface_points(rows, columns).at(after))
    flow = np.full((*seen.mask.shape, 2), np.nan, np.float32)
    flow[rows, columns] = pixels - np.stack([columns, rows], axis=1)
    window = _window(seen.mask, camera.size)
    first, second = (scene.image(k, 0) for k in range(2))
    assert first is not None and second is not None
    return FlowPair(
        np.ascontiguousarray(first[window]), np.ascontiguousarray(second[window]),
        np.ascontiguousarray(seen.mask[window]), np.ascontiguousarray(flow[window]),
    )  # fmt: skip


def _window(mask: Bool, size: tuple[int, int]) -> tuple[slice, slice]:
    middle = np.array([np.nonzero(mask)[axis].mean() for axis in (1, 0)])
    low = np.clip(middle - np.array(CROP) / 2, 0, np.array(size) - CROP).astype(int)
    return slice(low[1], low[1] + CROP[1]), slice(low[0], low[0] + CROP[0])
