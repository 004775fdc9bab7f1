"""Level-set evolution towards a shape: the contour step of the coupled method.

``∂_t Φ = H'(Φ) (log p₁/p₂ + ν div(∇Φ/|∇Φ|)) + 2λ (Φ₀ − Φ)``, started from Φ₀, Φ > 0 inside
(Brox, Rosenhahn and Cremers, eq. 11.12-11.14; Rosenhahn, Brox and Seidel, eq. 16).
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32

_TABLE = 512  # entries of the table of H'


def signed_distance(mask: Bool) -> Float32:
    """(H, W) distance to the mask's outline, half a pixel outside its pixel centres, in px, positive inside, to 2 %."""
    inside = mask.astype(np.uint8)
    to_outside = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_5)
    to_inside = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.where(mask, to_outside - np.float32(0.5), np.float32(0.5) - to_inside)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def evolve(
    phi0: Float32, log_ratio: Float32, steps: int, tau: float, nu: float, lam: float, width: float, clip: float
) -> Float32:
    """Evolve from the shape Φ₀ (H, W) under a fixed log ratio (H, W), clipped to ±`clip`; reflecting borders.
    `width` is the standard deviation of H' in px; beyond four of them Φ does not change.
    """
    height, width_px = phi0.shape
    band = 4.0 * width
    pull_of = np.exp(-0.5 * (np.arange(_TABLE + 2) * 4.0 / _TABLE) ** 2) / (np.sqrt(2.0 * np.pi) * width)
    rows, columns = np.nonzero(np.abs(phi0) <= band)  # Φ does not change beyond it
    phi, new = phi0.copy(), phi0.copy()
    for _ in range(steps):
        for n in range(len(rows)):
            r, c = rows[n], columns[n]
            value = phi[r, c]
            new[r, c] = value
            if abs(value) > band:
                continue
            up, down, left, right = max(r - 1, 0), min(r + 1, height - 1), max(c - 1, 0), min(c + 1, width_px - 1)
            px, py = 0.5 * (phi[r, right] - phi[r, left]), 0.5 * (phi[down, c] - phi[up, c])
            pxx = phi[r, right] - 2.0 * value + phi[r, left]
            pyy = phi[down, c] - 2.0 * value + phi[up, c]
            pxy = 0.25 * (phi[down, right] - phi[down, left] - phi[up, right] + phi[up, left])
            slope2 = px * px + py * py + 1e-6
            curvature = (pxx * py * py - 2.0 * px * py * pxy + pyy * px * px) / (slope2 * np.sqrt(slope2))
            curvature = min(max(curvature, -1.0), 1.0)
            ratio = min(max(log_ratio[r, c], -clip), clip)
            place = abs(value) / band * _TABLE
            i = int(place)
            pull = pull_of[i] + (place - i) * (pull_of[i + 1] - pull_of[i])
            new[r, c] = value + tau * (pull * (ratio + nu * curvature) + 2.0 * lam * (phi0[r, c] - value))
        phi, new = new, phi
    return phi


def evolve_reference(
    phi0: Float32, log_ratio: Float32, steps: int, tau: float, nu: float, lam: float, width: float, clip: float
) -> Float:
    """Readable twin of `evolve`."""
    shape = phi0.astype(float)
    phi, ratio = shape.copy(), np.clip(log_ratio, -clip, clip)
    for _ in range(steps):
        p = np.pad(phi, 1, mode="edge")
        px, py = (p[1:-1, 2:] - p[1:-1, :-2]) / 2, (p[2:, 1:-1] - p[:-2, 1:-1]) / 2
        pxx = p[1:-1, 2:] - 2 * phi + p[1:-1, :-2]
        pyy = p[2:, 1:-1] - 2 * phi + p[:-2, 1:-1]
        pxy = (p[2:, 2:] - p[2:, :-2] - p[:-2, 2:] + p[:-2, :-2]) / 4
        slope2 = px**2 + py**2 + 1e-6
        curvature = np.clip((pxx * py**2 - 2 * px * py * pxy + pyy * px**2) / slope2**1.5, -1, 1)
        pull = np.exp(-0.5 * (phi / width) ** 2) / (np.sqrt(2 * np.pi) * width)
        moved = phi + tau * (pull * (ratio + nu * curvature) + 2 * lam * (shape - phi))
        phi = np.where(np.abs(phi) > 4 * width, phi, moved)
    return phi


@njit(cache=True, nogil=True)
def zero_crossings(phi: Float32) -> tuple[Float, Float]:
    """Sub-pixel points (N, 2) px of the zero level, one per grid edge that it crosses, and outward unit normals."""
    height, width = phi.shape
    points, normals = np.empty((2 * height * width, 2)), np.empty((2 * height * width, 2))
    count = 0
    for r in range(1, height - 2):
        for c in range(1, width - 2):
            here = phi[r, c]
            for direction in range(2):
                dr, dc = direction, 1 - direction
                there = phi[r + dr, c + dc]
                if (here > 0.0) == (there > 0.0):
                    continue
                t = here / (here - there)
                gx0, gx1 = phi[r, c + 1] - phi[r, c - 1], phi[r + dr, c + dc + 1] - phi[r + dr, c + dc - 1]
                gy0, gy1 = phi[r + 1, c] - phi[r - 1, c], phi[r + dr + 1, c + dc] - phi[r + dr - 1, c + dc]
                gx, gy = (1.0 - t) * gx0 + t * gx1, (1.0 - t) * gy0 + t * gy1
                length = np.sqrt(gx * gx + gy * gy)
                if length < 1e-9:
                    continue
                points[count, 0], points[count, 1] = c + t * dc, r + t * dr
                normals[count, 0], normals[count, 1] = -gx / length, -gy / length
                count += 1
    return points[:count].copy(), normals[:count].copy()


def zero_crossings_reference(phi: Float32) -> tuple[Float, Float]:
    """Readable twin of `zero_crossings`: grid edge by grid edge, to the right and down."""
    slope = np.zeros((*phi.shape, 2))
    slope[:, 1:-1, 0], slope[1:-1, :, 1] = phi[:, 2:] - phi[:, :-2], phi[2:] - phi[:-2]
    points, normals = list[Float](), list[Float]()
    for r, c in np.ndindex(phi.shape[0] - 3, phi.shape[1] - 3):
        here = (r + 1, c + 1)
        for there in ((r + 1, c + 2), (r + 2, c + 1)):
            if (phi[here] > 0.0) != (phi[there] > 0.0):
                t = float(phi[here]) / float(phi[here] - phi[there])
                inward = (1.0 - t) * slope[here] + t * slope[there]
                if (length := np.hypot(*inward)) >= 1e-9:
                    points.append(((1.0 - t) * np.array(here) + t * np.array(there))[::-1])
                    normals.append(-inward / length)
    return np.reshape(points, (-1, 2)), np.reshape(normals, (-1, 2))


@njit(cache=True, nogil=True)
def nearest_with_normal(
    points: Float, normals: Float, candidates: Float, candidate_normals: Float, least_cosine: float
) -> tuple[Float, Float]:
    """For each point (N, 2) the nearest candidate (N, 2) whose normal agrees, and its distance (N,), inf for none."""
    N, M = len(points), len(candidates)
    partner, distance = np.zeros((N, 2)), np.full(N, np.inf)
    order = np.argsort(candidates[:, 1])
    heights = candidates[:, 1][order]
    for n in range(N):
        best = np.inf
        start = np.searchsorted(heights, points[n, 1])
        for direction in (-1, 1):  # up and down from the point's own height, until no nearer one can follow
            k = start if direction > 0 else start - 1
            while 0 <= k < M:
                m = order[k]
                dx, dy = candidates[m, 0] - points[n, 0], candidates[m, 1] - points[n, 1]
                if dy * dy >= best:
                    break
                k += direction
                if dx * dx + dy * dy >= best:
                    continue
                if normals[n, 0] * candidate_normals[m, 0] + normals[n, 1] * candidate_normals[m, 1] < least_cosine:
                    continue
                best = dx * dx + dy * dy
                partner[n, 0], partner[n, 1] = candidates[m, 0], candidates[m, 1]
        distance[n] = np.sqrt(best)
    return partner, distance


def nearest_with_normal_reference(
    points: Float, normals: Float, candidates: Float, candidate_normals: Float, least_cosine: float
) -> tuple[Float, Float]:
    """Readable twin of `nearest_with_normal`: every pair."""
    apart = np.linalg.norm(points[:, None] - candidates, axis=2)
    apart = np.where(normals @ candidate_normals.T < least_cosine, np.inf, apart)
    apart = np.concatenate([apart, np.full((len(points), 1), np.inf)], axis=1)  # there may be no candidates
    best = np.argmin(apart, axis=1)
    found = np.isfinite(apart[np.arange(len(points)), best])
    partner = np.zeros((len(points), 2))
    partner[found] = candidates[best[found]]
    return partner, apart.min(axis=1)
