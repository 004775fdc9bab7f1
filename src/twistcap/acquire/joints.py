"""Joints in silhouettes: skeleton corners and narrowest slices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from twistcap.acquire.outline import corners, skeleton
from twistcap.arrays import Bool, Float
from twistcap.errors import check


@dataclass(frozen=True)
class ArmCorner:
    """A bent arm of the joint view, pixels: skeleton (N, 2) from the fingertip, index of its corner, elbow (2,)."""

    path: Float
    corner: int
    elbow: Float


def arm_corner(arm: Bool, trunk_side: Float, height: float) -> ArmCorner:
    """The elbow of a bent arm (H, W): the corner of its skeleton, moved to where the lines of both limbs meet.

    A skeleton cuts its corners inside a bend; the lines that it follows farther away do not. The arm leaves the trunk
    near the pixel `trunk_side` (2,), of a person of a `height`, px. Raises InputError if the arm is not bent enough for
    a corner.
    """
    path = _longest_path(skeleton(arm), trunk_side)
    smooth = gaussian_filter1d(path, 0.008 * height, axis=0, mode="nearest")
    reach = max(4, round(0.05 * height)), max(8, round(0.1 * height))
    index, _ = corners(smooth, reach, np.deg2rad(140.0), closed=False)
    inner = index[(index > 0.15 * len(path)) & (index < 0.75 * len(path))]  # beyond are hand and trunk
    check("key view 'elbows'", len(inner) != 0, "an arm is straight; hold the upper arms out sideways, the forearms up")
    corner = int(inner[0])
    near, far = round(0.035 * height), round(0.11 * height)
    limbs = (smooth[max(0, corner - far) : max(2, corner - near)], smooth[corner + near : corner + far])
    p, q = (limb.mean(axis=0) for limb in limbs)
    d, e = (np.linalg.svd(limb - limb.mean(axis=0))[2][0] for limb in limbs)
    t = np.linalg.solve(np.stack([d, -e], axis=1), q - p)
    return ArmCorner(smooth, corner, p + t[0] * d)


def _longest_path(pixels: Bool, start_near: Float) -> Float:
    """(N, 2) the longest path through a skeleton from the pixel nearest to a point, in order from its far end."""
    points = np.argwhere(pixels)[:, ::-1]
    number = {tuple(p): i for i, p in enumerate(points.tolist())}
    start = int(np.argmin(((points - start_near) ** 2).sum(axis=1)))
    before, queue = {start: -1}, [start]
    for i in queue:
        x, y = points[i]
        for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            j = number.get((int(x + dx), int(y + dy)))
            if j is not None and j not in before:
                before[j] = i
                queue.append(j)
    way, i = [], queue[-1]
    while i >= 0:
        way.append(i)
        i = before[i]
    return points[way].astype(float)


def narrowest(control: Float, along: Float, between: tuple[float, float]) -> float:
    """Place along a limb, m, of the least girth of its slices (n, 4, 3), within a range of `along` (n,). Raises
    InputError where no slice is in the range."""
    a = np.linalg.norm(control[:, 1] - control[:, 0] + control[:, 2] - control[:, 3], axis=1) / 2
    b = np.linalg.norm(control[:, 3] - control[:, 0] + control[:, 2] - control[:, 1], axis=1) / 2
    area = gaussian_filter1d(a * b, 1.0, mode="nearest")
    inside = np.flatnonzero((along >= between[0]) & (along <= between[1]))
    check("key views", len(inside), "a limb is too short to find its narrowest place; check the silhouettes")
    return float(along[inside[np.argmin(area[inside])]])
