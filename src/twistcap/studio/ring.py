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
    views: int, radius: float, height: ArrayLike, target: ArrayLike, size: tuple[int, int], focal: float | None = None,
    offset_deg: float = 0.0,
) -> Rig:  # fmt: skip
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


def zoom_to_fit(rig: Rig, points: Float) -> Rig:
    """The rig zoomed out, if needed, until all points (N, 3) are inside every image with a margin."""
    reach = 0.0
    for camera in rig:
        half = (np.array(camera.size) - 1) / 2
        pixels, _ = camera.project(points)
        reach = max(reach, float(np.max(np.abs(pixels - half) / half)))
    factor = min(1.0, (1.0 - 2 * _MARGIN) / reach)
    zoom = np.array([[factor, factor, 1.0], [factor, factor, 1.0], [1.0, 1.0, 1.0]])
    return Rig(tuple(replace(camera, K=camera.K * zoom) for camera in rig))
