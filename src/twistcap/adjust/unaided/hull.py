"""Where in the room something stands out in all cameras at once: a coarse visual hull, and the bodies in it."""

from __future__ import annotations

import cv2
import numpy as np

from twistcap.arrays import Bool, Float, Int
from twistcap.camera import Rig
from twistcap.search.evidence import Evidence, EvidenceView

_VOXEL = 0.08  # m
_BODY = 0.4  # m across of what is gathered to one body
_APART = 0.5  # m between two places
_TALL = 2.4  # m above the floor that are looked at
_LOW = 0.3  # m below it
_FINE, _GAP = 0.04, 3  # m between the layers by which a height is measured; so many empty ones end a body
_HIGHEST = 4.0  # m above the floor, for bodies that a calibration has too large


def middle_of_sight(rig: Rig) -> Float:
    """(3,) the point that is nearest to all cameras' axes, m."""
    A, b = 1e-6 * np.eye(3), np.zeros(3)
    for camera in rig:
        R, t = camera.T_cam_world[:3, :3], camera.T_cam_world[:3, 3]
        across = np.eye(3) - np.outer(R[2], R[2])
        A, b = A + across, b - across @ R.T @ t
    return np.asarray(np.linalg.solve(A, b), np.float64)


def places(evidence: Evidence, centre: Float, reach: float, floor: float, count: int) -> Float:
    """(P, 3) middles of what stands out in every camera that sees it, two at least; the most first, `count` at most.

    Args:
        evidence: of one instant; all parts have the same.
        centre: (2,) m; `reach` m about it is looked at.
        floor: m.
    """
    x, y = (np.arange(c - reach, c + reach, _VOXEL) for c in centre)
    z = np.arange(floor - _LOW, floor + _TALL, _VOXEL)
    voxels = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    inside = _inside(evidence, voxels.reshape(-1, 3)).reshape(voxels.shape[:3])
    size = 2 * round(0.5 * _BODY / _VOXEL) + 1
    gathered = cv2.blur(np.asarray(inside.sum(axis=2), np.float32), (size, size))
    out = list[Float]()
    for k in np.argsort(-gathered, axis=None)[: 40 * count * size]:
        i, j = divmod(int(k), gathered.shape[1])
        here = np.array([x[i], y[j]])
        if gathered[i, j] > 0.0 and all(np.hypot(*(here - other[:2])) > _APART for other in out):
            out.append(np.append(here, _height(inside, i, j, size // 2, z)))
        if len(out) == count:
            break
    return np.array(out).reshape(-1, 3)


def height_of(evidence: Evidence, place: Float, floor: float) -> float:
    """m from the lowest to the highest point of what stands out about a place (3,), in one piece; 0 without any."""
    side, z = np.arange(-0.3, 0.31, _VOXEL), np.arange(floor - _LOW, floor + _HIGHEST, _FINE)
    voxels = np.stack(np.meshgrid(place[0] + side, place[1] + side, z, indexing="ij"), axis=-1)
    layers = _inside(evidence, voxels.reshape(-1, 3)).reshape(-1, len(z)).max(axis=0)
    there = np.flatnonzero(layers)
    pieces = np.split(there, np.flatnonzero(np.diff(there) > _GAP) + 1)
    body = max(pieces, key=lambda piece: float(layers[piece].sum()))
    return float(z[body[-1]] - z[body[0]]) if len(body) else 0.0


def share_explained(evidence: Evidence, place: Float, height: float, floor: float) -> float:
    """Share of what stands out that a body of this height about a place (3,) covers, mean of the cameras.

    It does not depend on scale: where all lengths are wrong alike, rays still meet. In cameras that are swapped or
    mirrored, or that see each another part of a body, they do not.
    """
    half = max(0.6, 0.5 * height)
    side, z = np.arange(-half, half, _FINE), np.arange(floor - _LOW, floor + _HIGHEST, _FINE)
    voxels = np.stack(np.meshgrid(place[0] + side, place[1] + side, z, indexing="ij"), axis=-1).reshape(-1, 3)
    body = voxels[_inside(evidence, voxels) > 0.0]
    return float(np.mean([_covered(view, body) for view in evidence.views]))


def _covered(view: EvidenceView, points: Float) -> float:
    """Share of what stands out in a view that lies on the points (N, 3), or between them."""
    nats = np.maximum(view.any_part[0], 0.0)
    column, row, sees = _pixels(view, points)
    on = np.zeros(nats.shape, np.uint8)
    on[row[sees], column[sees]] = 1
    on = np.asarray(cv2.morphologyEx(on, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)))
    return float(nats[on > 0].sum() / max(nats.sum(), 1e-9))


def _height(inside: Float, i: int, j: int, half: int, z: Float) -> float:
    """The middle height of what is about a column."""
    column = inside[max(0, i - half) : i + half + 1, max(0, j - half) : j + half + 1].sum(axis=(0, 1))
    return float(column @ z / column.sum())


def _inside(evidence: Evidence, points: Float) -> Float:
    """(N,) mean nats of the cameras that see a point, 0 where one of them contradicts or fewer than two see it."""
    total, least, seen = np.zeros(len(points)), np.full(len(points), np.inf), np.zeros(len(points))
    for view in evidence.views:
        nats, sees = _sampled(view, points)
        total += nats
        least = np.where(sees, np.minimum(least, nats), least)
        seen += sees
    return np.where((seen >= 2) & (least > -0.5), np.maximum(total, 0.0) / np.maximum(seen, 1.0), 0.0)


def _sampled(view: EvidenceView, points: Float) -> tuple[Float, Bool]:
    """(N,) nats where points are seen, 0 elsewhere; and whether they are."""
    column, row, sees = _pixels(view, points)
    return np.where(sees, view.any_part[0][row, column], 0.0), sees


def _pixels(view: EvidenceView, points: Float) -> tuple[Int, Int, Bool]:
    """(N,) columns and rows of points, 0 where they are not seen, and whether they are."""
    height, width = view.any_part[0].shape
    u, v, w = (points @ view.camera.P[:, :3].T + view.camera.P[:, 3]).T
    front = w > 0.0
    c, r = (np.floor(np.where(front, a / np.where(front, w, 1.0), -1.0) + 0.5).astype(int) for a in (u, v))
    sees = front & (c >= 0) & (c < width) & (r >= 0) & (r < height)
    return np.where(sees, c, 0), np.where(sees, r, 0), sees
