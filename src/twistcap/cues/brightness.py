"""The brightness cue: visible surface points remember how bright they were in the frame before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.cues.view import View
from twistcap.render import RenderedView, SurfacePoints
from twistcap.render.raster import project_pinhole
from twistcap.terms import PhotometricTerm
from twistcap.terms.photometric import sample_with_gradient


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

    def __getitem__(self, which: Int) -> Template:
        """The points of some indices."""
        return Template(self.points[which], np.take(self.value, which, axis=1), np.take(self.gradient, which, axis=1))

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
        area = max(int(np.count_nonzero(seen.mask)), 1)
        cell = max(1, round(float(np.sqrt(area / max(self.points, 1)))))
        occupied = np.zeros((view.grey.shape[0] // cell + 1, view.grey.shape[1] // cell + 1), dtype=np.bool_)
        kept = None if old is None else self._still_seen(view, seen, posed, old, cell, occupied)
        rows, columns = strongest_in_cells(view.grey, seen.inverse_depth_image, cell, occupied)
        fresh = self._template(view, seen, posed, seen.surface_points(rows, columns))
        return fresh if kept is None else kept + fresh

    def _still_seen(
        self, view: View, seen: RenderedView, posed: Posed, old: Template, cell: int, occupied: Bool
    ) -> Template:
        """The old points that are still seen, one in each cell, refreshed; their cells are marked as occupied."""
        P, world = view.camera.P, old.points.at(posed)
        visible = visible_points(P, world, seen.inverse_depth_image, self.depth_tolerance)
        old = old[first_in_cells(project_pinhole(P, world)[0], visible, cell, occupied)]
        now = self._template(view, seen, posed, old.points)
        off_by = np.abs(now.value[-1] - old.value[-1])
        a = self.update
        followed = Template(
            old.points, (1.0 - a) * old.value + a * now.value, (1.0 - a) * old.gradient + a * now.gradient
        )
        return followed[np.flatnonzero(off_by < 2.0 * self.scale).astype(np.int32)]

    def _template(self, view: View, seen: RenderedView, posed: Posed, points: SurfacePoints) -> Template:
        """Brightness of points as they now lie in the image; NaN outside it."""
        pixels, _ = project_pinhole(view.camera.P, points.at(posed))
        x, y = np.ascontiguousarray(pixels.T)
        value, gradient = np.empty((len(self.blurs), len(points))), np.empty((len(self.blurs), len(points), 2))
        for level, blur in enumerate(self.blurs):
            image = view.blurred(blur * seen.px_per_m)
            value[level], gradient[level, :, 0], gradient[level, :, 1], valid = sample_with_gradient(image, x, y)
            value[level, valid == 0] = np.nan
        return Template(points, value, gradient)

    def term(self, view: View, seen: RenderedView, template: Template, level: int) -> PhotometricTerm:
        """Brightness constancy of the template's points that the rendered view says are visible."""
        P = view.camera.P
        visible = visible_points(P, template.points.at(seen.posed), seen.inverse_depth_image, self.depth_tolerance)
        return PhotometricTerm(
            P, template.points, view.blurred(self.blurs[level] * seen.px_per_m), template.value[level],
            template.gradient[level], visible * (self.share / self.sigma**2), self.scale,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def first_in_cells(pixels: Float, visible: Float, cell: int, occupied: Bool) -> Int:
    """Indices of the points that are visible and the first in their cell of the grid `occupied`, which is filled in."""
    out = np.empty(len(pixels), dtype=np.int32)
    count = 0
    for n in range(len(pixels)):
        if visible[n] == 0.0:
            continue
        r, c = (int(np.round(pixels[n, 1])) - 2) // cell, (int(np.round(pixels[n, 0])) - 2) // cell
        if 0 <= r < occupied.shape[0] and 0 <= c < occupied.shape[1] and not occupied[r, c]:
            occupied[r, c] = True
            out[count] = n
            count += 1
    return out[:count]


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
                    depth = 1.0 / w
                    at_rim = False
                    for dr, dc in ((-2, 0), (2, 0), (0, -2), (0, 2)):
                        other = inverse_depth[r + dr, c + dc]
                        if other == 0.0 or abs(1.0 / other - depth) > 0.04:
                            at_rim = True
                    if at_rim:
                        continue
                    gx, gy = grey[r, c + 1] - grey[r, c - 1], grey[r + 1, c] - grey[r - 1, c]
                    strength = 1e-9 + gx * gx + gy * gy
                    if strength > best:
                        best, best_row, best_column = strength, r, c
            if best_row >= 0:
                rows[count], columns[count] = best_row, best_column
                count += 1
    return rows[:count], columns[:count]


@njit(cache=True, nogil=True)
def visible_points(P: Float, world: Float, inverse_depth: Float32, tolerance: float) -> Float:
    """(N,) 1.0 where a surface point lies no more than `tolerance` m behind the rendered surface, else 0.0."""
    h, w = inverse_depth.shape
    out = np.zeros(len(world))
    for n in range(len(world)):
        x, y, z = world[n, 0], world[n, 1], world[n, 2]
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        if depth < 1e-3:
            continue
        column = int(np.round((P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth))
        row = int(np.round((P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth))
        if 0 <= column < w and 0 <= row < h:
            surface = inverse_depth[row, column]
            if surface > 0.0 and depth < 1.0 / surface + tolerance:
                out[n] = 1.0
    return out
