"""The brightness cue: visible surface points remember how bright they were in the frame before."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.cues.view import View
from twistcap.render import RenderedView, SurfacePoints
from twistcap.terms import PhotometricTerm
from twistcap.terms.accumulate import projected_point
from twistcap.terms.photometric import sample


@dataclass(frozen=True)
class Template:
    """Brightness of surface points in one view at one past frame, at several blurs.

    Attributes:
        points: N places on the surface.
        value: (B, N) brightness under each blur.
        gradient: (B, N, 2) image gradient there, 1/px.
    """

    points: SurfacePoints
    value: Float
    gradient: Float

    def __add__(self, other: Template) -> Template:
        """Both templates' points."""
        return Template(
            self.points + other.points, np.concatenate([self.value, other.value], axis=1),
            np.concatenate([self.gradient, other.gradient], axis=1),
        )  # fmt: skip


@dataclass(frozen=True)
class Brightness:
    """Settings of the brightness cue.

    Attributes:
        points: how many surface points are followed in each view.
        blurs: Gaussians under which images are compared, coarse to fine, m on the body.
        sigma: brightness noise (sensor, shading, template).
        scale: difference at which a point begins to lose its say.
        share: share of the points' information that counts (neighbouring points see the same pixels).
        update: share of the new brightness that a template point takes over in each frame.
        depth_tolerance: m that a point may lie behind the rendered surface and still count as seen.
    """

    points: int = 500
    blurs: tuple[float, ...] = (0.020, 0.005)
    sigma: float = 0.015
    scale: float = 0.03
    share: float = 0.8
    update: float = 0.2
    depth_tolerance: float = 0.012

    def remember(self, view: View, seen: RenderedView, posed: Posed, old: Template | None) -> Template:
        """Template for the next frame; `seen` chooses the points now visible, `posed` (the settled pose) places them.

        Points of the old template that are still seen stay, one in each cell of a grid, and their brightness follows
        the image slowly, which keeps the track from creeping along the surface; new points fill the empty cells.
        """
        cell = max(1, round(math.sqrt(max(np.count_nonzero(seen.mask), 1) / max(self.points, 1))))
        occupied = np.zeros((view.grey.shape[0] // cell + 1, view.grey.shape[1] // cell + 1), dtype=np.bool_)
        images = tuple(view.blurred(blur * seen.px_per_m) for blur in self.blurs)
        P = view.camera.P
        kept: Template | None = None
        if old is not None:
            value, gradient, which = refreshed(
                P, *old.points.bound_to(posed), old.value, old.gradient, images, seen.inverse_depth_image,
                self.depth_tolerance, self.update, 2.0 * self.scale, cell, occupied,
            )  # fmt: skip
            kept = Template(old.points[which], value, gradient)
        fresh = seen.surface_points(*strongest_in_cells(view.grey, seen.inverse_depth_image, cell, occupied))
        new = Template(fresh, *template_values(P, *fresh.bound_to(posed), images))
        return new if kept is None else kept + new

    def term(self, view: View, seen: RenderedView, template: Template, level: int) -> PhotometricTerm:
        """Brightness constancy of the template's points that the rendered view says are visible."""
        P = view.camera.P
        visible = visible_points(
            P, *template.points.bound_to(seen.posed), seen.inverse_depth_image, self.depth_tolerance
        )
        return PhotometricTerm(
            P, template.points, view.blurred(self.blurs[level] * seen.px_per_m), template.value[level],
            template.gradient[level], visible * (self.share / self.sigma**2), self.scale,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def template_values(
    P: Float, transforms: Float, segments: Int, weights: Float, local: Float, images: tuple[Float32, ...]
) -> tuple[Float, Float]:
    """Brightness (B, N) and image gradient (B, N, 2) of surface points in the B blurs of an image; NaN outside it."""
    B, N = len(images), len(local)
    value, gradient = np.full((B, N), np.nan), np.zeros((B, N, 2))
    for n in range(N):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        for b in range(B):
            here, gx, gy, inside = sample(images[b], x, y)
            if w > 0.0 and inside:
                value[b, n], gradient[b, n, 0], gradient[b, n, 1] = here, gx, gy
    return value, gradient


@njit(cache=True, nogil=True)
def refreshed(
    P: Float, transforms: Float, segments: Int, weights: Float, local: Float, value: Float, gradient: Float,
    images: tuple[Float32, ...], inverse_depth: Float32, tolerance: float, update: float, most: float, cell: int,
    occupied: Bool,
) -> tuple[Float, Float, Int]:  # fmt: skip
    """Template points that are still seen, the first in each cell of the grid `occupied`, which is filled in.

    Args:
        value, gradient: (B, N) and (B, N, 2) of the old template, finest blur last.
        images: the B blurs of the present image.
        inverse_depth: (H, W) of the rendered body; a point is seen no more than `tolerance` m behind it.
        update: share of the present brightness that is taken over.
        most: difference of brightness beyond which a point is given up.

    Returns:
        New values (B, M), gradients (B, M, 2) and indices (M,) of the points kept.
    """
    B, N = value.shape
    kept, now, slope = np.empty(N, dtype=np.int32), np.empty((B, N)), np.empty((B, N, 2))
    count = 0
    for n in range(N):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        if not _in_sight(x, y, w, inverse_depth, tolerance):
            continue
        row, column = int(np.round(y)), int(np.round(x))
        r, c = (row - 2) // cell, (column - 2) // cell
        if row < 2 or column < 2 or occupied[r, c]:
            continue
        all_inside = True
        for b in range(B):
            here, gx, gy, inside = sample(images[b], x, y)
            all_inside &= inside
            now[b, count] = value[b, n] + update * (here - value[b, n])
            slope[b, count, 0] = gradient[b, n, 0] + update * (gx - gradient[b, n, 0])
            slope[b, count, 1] = gradient[b, n, 1] + update * (gy - gradient[b, n, 1])
        if all_inside and abs(now[B - 1, count] - value[B - 1, n]) < update * most:
            occupied[r, c] = True
            kept[count] = n
            count += 1
    return now[:, :count].copy(), slope[:, :count].copy(), kept[:count].copy()


@njit(cache=True, nogil=True, inline="always")
def _in_sight(x: float, y: float, w: float, inverse_depth: Float32, tolerance: float) -> bool:
    """Whether a point of inverse depth w, seen at (x, y), lies no more than `tolerance` m behind the surface there."""
    height, width = inverse_depth.shape
    column, row = int(np.round(x)), int(np.round(y))
    if w == 0.0 or not (0 <= column < width and 0 <= row < height):
        return False
    surface = inverse_depth[row, column]
    return surface > 0.0 and 1.0 / w < 1.0 / surface + tolerance


@njit(cache=True, nogil=True)
def strongest_in_cells(grey: Float32, inverse_depth: Float32, cell: int, occupied: Bool) -> tuple[Int, Int]:
    """Rows and columns of body pixels, the most textured of each cell that is not occupied, none at a rim."""
    height, width = grey.shape
    most = (height // cell + 1) * (width // cell + 1)
    rows, columns = np.empty(most, dtype=np.int32), np.empty(most, dtype=np.int32)
    count = 0
    for top in range(2, height - 2, cell):
        for left in range(2, width - 2, cell):
            if occupied[(top - 2) // cell, (left - 2) // cell]:
                continue
            best, best_row, best_column = 0.0, -1, -1
            for r in range(top, min(top + cell, height - 2)):
                for c in range(left, min(left + cell, width - 2)):
                    w = inverse_depth[r, c]
                    if w == 0.0:
                        continue
                    gx, gy = grey[r, c + 1] - grey[r, c - 1], grey[r + 1, c] - grey[r - 1, c]
                    strength = 1e-9 + gx * gx + gy * gy
                    if strength > best and not _at_rim(inverse_depth, r, c):
                        best, best_row, best_column = strength, r, c
            if best_row >= 0:
                rows[count], columns[count] = best_row, best_column
                count += 1
    return rows[:count], columns[:count]


@njit(cache=True, nogil=True, inline="always")
def _at_rim(inverse_depth: Float32, r: int, c: int) -> bool:
    """Whether the body ends, or its depth jumps by 4 cm, two pixels off."""
    w = inverse_depth[r, c]
    for dr, dc in ((-2, 0), (2, 0), (0, -2), (0, 2)):
        other = inverse_depth[r + dr, c + dc]
        if other == 0.0 or abs(w - other) > 0.04 * w * other:
            return True
    return False


@njit(cache=True, nogil=True)
def visible_points(
    P: Float, transforms: Float, segments: Int, weights: Float, local: Float, inverse_depth: Float32, tolerance: float
) -> Float:
    """(N,) 1.0 where a surface point lies no more than `tolerance` m behind the rendered surface, else 0.0."""
    out = np.zeros(len(local))
    for n in range(len(local)):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        out[n] = 1.0 if _in_sight(x, y, w, inverse_depth, tolerance) else 0.0
    return out
