"""Robust triangulation of keypoints: every pair of views proposes a point, and all views vote."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.camera import Rig

_REACH = 4.0  # standard deviations


def triangulate(rig: Rig, pixels: Float, confidence: Float, sigma_px: Float) -> tuple[Float, Bool]:
    """Points (L, 3) in the world seen by at least two views within four standard deviations, and these views (C, L).

    Points are NaN where fewer than two views agree. Pixels are (C, L, 2), NaN where nothing was seen; their confidence,
    0 there, and standard deviation are (C, L).
    """
    weight = np.where(np.isfinite(pixels).all(axis=-1), confidence, 0.0)
    rays = [camera.rays(pixels[c]) for c, camera in enumerate(rig)]
    directions = np.nan_to_num(np.stack([r[0] for r in rays]))
    centres = np.stack([camera.centre for camera in rig])
    best, score = np.full((pixels.shape[1], 3), np.nan), np.zeros(pixels.shape[1])
    for pair in combinations(range(len(rig)), 2):
        chosen = np.zeros_like(weight)
        chosen[list(pair)] = np.minimum(weight[pair[0]], weight[pair[1]])
        points = nearest_points(centres, directions, chosen)
        votes = np.where(_residuals(rig, pixels, points) < _REACH * sigma_px, weight, 0.0).sum(axis=0)
        better = votes > score
        best[better], score[better] = points[better], votes[better]
    for _ in range(2):
        best = nearest_points(centres, directions, weight * (_residuals(rig, pixels, best) < _REACH * sigma_px))
    inliers = (_residuals(rig, pixels, best) < _REACH * sigma_px) & (weight > 0)
    return best, np.asarray(inliers)


def nearest_points(centres: Float, directions: Float, weights: Float) -> Float:
    """Points (L, 3) nearest to weighted rays: centres (C, 3), unit directions (C, L, 3), weights (C, L). NaN where
    fewer than two rays count, or all are parallel."""
    across = np.eye(3) - directions[..., :, None] * directions[..., None, :]
    A = np.einsum("cl,clij->lij", weights, across)
    b = np.einsum("cl,clij,cj->li", weights, across, centres)
    good = ((weights > 0).sum(axis=0) >= 2) & (np.linalg.det(A) > 1e-6 * np.maximum(weights.sum(axis=0), 1e-9) ** 3)
    A[~good] = np.eye(3)
    points = np.linalg.solve(A, b[..., None])[..., 0]
    points[~good] = np.nan
    return points


def _residuals(rig: Rig, pixels: Float, points: Float) -> Float:
    """(C, L) distance in pixels, infinite where there is none."""
    projected = np.stack([camera.project(points)[0] for camera in rig])
    return np.nan_to_num(np.linalg.norm(projected - pixels, axis=-1), nan=np.inf)


def rigid_fit(source: Float, target: Float, weights: Float) -> Float:
    """(4, 4) motion that best carries points (N, 3) onto others (Kabsch, DOI 10.1107/S0567739476001873)."""
    w = weights / weights.sum()
    a, b = w @ source, w @ target
    U, _, Vt = np.linalg.svd((source - a).T @ (w[:, None] * (target - b)))
    R = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, b - R @ a
    return out
