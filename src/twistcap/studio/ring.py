"""Cameras on a ring around the person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from twistcap.arrays import Float
from twistcap.camera import Camera, Rig, look_at

STEREO_ANGLE_DEG = 135.0  # between two cameras; 90° and 160° were measured to be worse
_MARGIN = 0.03  # of the image, on each side


def ring(
    views: int,
    radius: float,
    height: float | ArrayLike,
    target: ArrayLike,
    size: tuple[int, int],
    focal: float | None = None,
    offset_deg: float = 0.0,
) -> Rig:
    """Cameras evenly spaced on a circle, all looking at one point; two are 135° apart.

    Args:
        views: number of cameras, named cam01 ….
        radius: horizontal distance from the target, m.
        height: of the cameras above z = 0, m; one for all or one each.
        target: (3,) point at the principal point of all, m.
        size: (width, height) of the images, px.
        focal: px; by default 1.75 m at the target fill 0.68 of the image's height.
        offset_deg: direction from the target to the first camera, from x towards y.
    """
    target = np.asarray(target, float)
    heights = np.broadcast_to(np.asarray(height, float), (views,))
    focal = 0.68 * size[1] * radius / 1.75 if focal is None else focal
    K = np.array([[focal, 0.0, (size[0] - 1) / 2], [0.0, focal, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
    step = STEREO_ANGLE_DEG if views == 2 else 360.0 / views
    cameras: list[Camera] = []
    for k in range(views):
        angle = np.deg2rad(offset_deg + k * step)
        eye = [target[0] + radius * np.cos(angle), target[1] + radius * np.sin(angle), heights[k]]
        cameras.append(Camera(f"cam{k + 1:02d}", K, look_at(eye, target), size))
    return Rig(tuple(cameras))


def with_focal(rig: Rig, factor: float) -> Rig:
    """The rig zoomed by a factor about each principal point."""
    return Rig(tuple(replace(c, K=np.diag([factor, factor, 1.0]) @ (c.K - _principal(c)) + _principal(c)) for c in rig))


def zoom_to_fit(rig: Rig, points: Float) -> Rig:
    """The rig zoomed out, if needed, until all points (N, 3) are inside every image with a margin."""
    reach = 0.0
    for camera in rig:
        half = (np.array(camera.size) - 1) / 2
        pixels, _ = camera.project(points)
        reach = max(reach, float(np.max(np.abs(pixels - half) / half)))
    return with_focal(rig, min(1.0, (1.0 - 2 * _MARGIN) / reach))


def _principal(camera: Camera) -> Float:
    out = np.zeros((3, 3))
    out[:2, 2], out[2, 2] = camera.K[:2, 2], 1.0
    return out
