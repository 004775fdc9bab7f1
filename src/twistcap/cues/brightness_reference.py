"""Readable twins of the kernels of `brightness`: one point after another."""

from __future__ import annotations

import numpy as np

from twistcap._typing import Bool, Float, Float32, Int
from twistcap.render import SurfaceArrays
from twistcap.terms.accumulate import projected_point_reference
from twistcap.terms.photometric import brightness_at_reference, sample_reference


def _projected(P: Float, surface: SurfaceArrays) -> Float:
    """(N, 3) pixel and inverse depth, 0 behind the camera."""
    return np.array([projected_point_reference(P, *surface, n) for n in range(len(surface[3]))]).reshape(-1, 3)


def template_values_reference(P: Float, surface: SurfaceArrays, image: Float32) -> tuple[Float, Float]:
    """Readable twin of `template_values`."""
    places = _projected(P, surface)
    found = np.array([sample_reference(image, x, y) for x, y, _ in places], dtype=float).reshape(-1, 4)
    inside = (found[:, 3] == 1.0) & (places[:, 2] > 0.0)
    return np.where(inside, found[:, 0], np.nan), np.where(inside[:, None], found[:, 1:3], 0.0)


def unmoved_reference(
    P: Float, surface: SurfaceArrays, before: Float32, now: Float32, shift: Float
) -> tuple[Float, Float]:
    """Readable twin of `unmoved`."""
    places = _projected(P, surface)
    ahead = places[:, 2] > 0.0
    change = [
        brightness_at_reference(now, x + shift[0], y + shift[1]) - brightness_at_reference(before, x, y)
        for x, y, _ in places
    ]
    return np.where(ahead, change, np.nan), np.where(ahead[:, None], places[:, :2], 0.0)


def refreshed_reference(
    P: Float, surface: SurfaceArrays, known: tuple[Float, Float], image: Float32, inverse_depth: Float32,
    rule: tuple[float, float, float], cell: int, occupied: Bool,
) -> tuple[Float, Float, Int]:  # fmt: skip
    """Readable twin of `refreshed`."""
    (value, gradient), (tolerance, update, most), places = known, rule, _projected(P, surface)
    values, gradients, kept = list[float](), list[Float](), list[int]()
    for n in np.flatnonzero(visible_points_reference(P, surface, inverse_depth, tolerance)):
        x, y, _ = places[n]
        row, column = int(y + 0.5), int(x + 0.5)
        here, gx, gy, inside = sample_reference(image, x, y)
        place = (row - 2) // cell, (column - 2) // cell
        if min(row, column) >= 2 and not occupied[place] and inside and abs(here - value[n]) < most:
            occupied[place] = True
            kept.append(int(n))
            values.append((1.0 - update) * value[n] + update * here)
            gradients.append((1.0 - update) * gradient[n] + update * np.array([gx, gy]))
    return np.array(values), np.reshape(gradients, (-1, 2)), np.array(kept, np.int32)


def visible_points_reference(P: Float, surface: SurfaceArrays, inverse_depth: Float32, tolerance: float) -> Float:
    """Readable twin of `visible_points`."""
    x, y, w = _projected(P, surface).T
    height, width = inverse_depth.shape
    inside = (w > 0.0) & (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)
    rows, columns = (np.where(inside, at + 0.5, 0.0).astype(int) for at in (y, x))
    there = inverse_depth[rows, columns].astype(float)
    known = inside & (there > 0.0)
    return (known & (1.0 / np.where(known, w, 1.0) < 1.0 / np.where(known, there, 1.0) + tolerance)).astype(float)


def strongest_in_cells_reference(grey: Float32, inverse_depth: Float32, cell: int, occupied: Bool) -> tuple[Int, Int]:
    """Readable twin of `strongest_in_cells`: cell by cell."""
    height, width = grey.shape
    strength = np.zeros_like(grey)
    strength[1:-1, 1:-1] = (grey[1:-1, 2:] - grey[1:-1, :-2]) ** 2 + (grey[2:, 1:-1] - grey[:-2, 1:-1]) ** 2
    strength += np.float32(1e-9)
    for dr, dc in ((0, 0), (-2, 0), (2, 0), (0, -2), (0, 2)):
        other = np.roll(inverse_depth, (dr, dc), axis=(0, 1))
        rim = (other == 0.0) | (np.abs(inverse_depth - other) > 0.04 * inverse_depth * other)
        strength[rim] = 0.0
    rows, columns = list[int](), list[int]()
    for i, j in np.argwhere(~occupied):
        top, left = i * cell + 2, j * cell + 2
        patch = strength[top : min(top + cell, height - 2), left : min(left + cell, width - 2)]
        if patch.size and patch.max() > 0.0:
            r, c = np.unravel_index(np.argmax(patch), patch.shape)
            rows.append(top + int(r))
            columns.append(left + int(c))
    return np.array(rows, np.int32), np.array(columns, np.int32)
