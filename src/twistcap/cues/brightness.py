"""The brightness cue: visible surface points remember how bright they were in the frame before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32, Int
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


@dataclass(frozen=True)
class Brightness:
    """Settings of the brightness cue.

    Attributes:
        points: how many surface points are followed in each view.
        blurs: Gaussians under which images are compared, coarse to fine, m on the body.
        sigma: brightness noise (sensor, shading, template).
        scale: difference at which a point begins to lose its say.
        share: share of the points' information that counts (neighbouring points see the same pixels).
    """

    points: int = 750
    blurs: tuple[float, ...] = (0.025, 0.010)
    sigma: float = 0.03
    scale: float = 0.06
    share: float = 0.2

    def remember(self, view: View, seen: RenderedView, posed: Posed) -> Template:
        """Template of the points now visible; `seen` chooses them, `posed` (the settled pose) places them."""
        rows, columns = textured_pixels(view.grey, seen.inverse_depth_image, self.points)
        points = seen.surface_points(rows, columns)
        pixels, _ = project_pinhole(view.camera.P, points.at(posed))
        value, gradient = np.empty((len(self.blurs), len(points))), np.empty((len(self.blurs), len(points), 2))
        good = np.ones(len(points), dtype=bool)
        for level, blur in enumerate(self.blurs):
            image = view.blurred(blur * seen.px_per_m)
            value[level], gradient[level, :, 0], gradient[level, :, 1], valid = sample_with_gradient(
                image, pixels[:, 0], pixels[:, 1]
            )
            good &= valid > 0
        return Template(points[good], value[:, good], gradient[:, good])

    def term(self, view: View, seen: RenderedView, template: Template, level: int) -> PhotometricTerm:
        """Brightness constancy of the template's points that the rendered view says are visible."""
        P = view.camera.P
        visible = visible_points(P, template.points.at(seen.posed), seen.inverse_depth_image, 0.03)
        return PhotometricTerm(
            P, template.points, view.blurred(self.blurs[level] * seen.px_per_m), template.value[level],
            template.gradient[level], visible * (self.share / self.sigma**2), self.scale,
        )  # fmt: skip


def textured_pixels(grey: Float32, inverse_depth: Float32, count: int) -> tuple[Int, Int]:
    """Rows and columns of about `count` body pixels, the most textured of each cell of a grid, none at a rim."""
    area = max(int(np.count_nonzero(inverse_depth)), 1)
    cell = max(1, int(np.sqrt(area / max(count, 1))))
    return _strongest_in_cells(np.ascontiguousarray(grey), inverse_depth, cell)


@njit(cache=True, nogil=True)
def _strongest_in_cells(grey: Float32, inverse_depth: Float32, cell: int) -> tuple[Int, Int]:
    height, width = grey.shape
    rows, columns = np.empty(height * width // (cell * cell) + height + width, dtype=np.int32), np.empty(
        height * width // (cell * cell) + height + width, dtype=np.int32
    )
    count = 0
    for top in range(2, height - 2, cell):
        for left in range(2, width - 2, cell):
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
def visible_points(
    P: Float, world: Float, inverse_depth: Float32, tolerance: float
) -> Float:
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
