"""The brightness cue: visible surface points remember how bright they were in the frame before."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numba import njit

from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.cues.support_maps import Neighbourhood, posterior, robust_scale
from twistcap.cues.view import View
from twistcap.errors import InputError
from twistcap.render import RenderedView, SurfaceArrays, SurfacePoints
from twistcap.terms import PhotometricTerm
from twistcap.terms.accumulate import projected_point
from twistcap.terms.photometric import EXPOSURE, Samples, brightness_at, sample

Support = Literal["none", "robust", "em"]

_NEW = 0.9  # trust in a point that was not followed before
_PAST = 0.6  # its weight in the running excess of each part, per lesson
_NEITHER = 0.05  # density of differences that neither motion explains, per standard deviation of the noise
_LEAST = 0.02  # no point is known to move as the body does, nor not to, beyond this probability


@dataclass(frozen=True)
class Template:
    """Brightness of surface points in one view, as past frames showed it.

    Attributes:
        samples: N places on the surface, and their brightness under the finest blur.
        trust: (N,) running probability that the image moves with the body there.
        excess: (S,) running robust scale of each part's differences, in units of the noise that was expected.
        image: (H, W) the last frame's under the finest blur.
        view, posed: that frame's, where coarser blurs are read when they are wanted.
    """

    samples: Samples
    trust: Float
    excess: Float
    image: Float32
    view: View
    posed: Posed

    @property
    def points(self) -> SurfacePoints:
        """The N places."""
        return self.samples.points

    def blurred(self, sigma: float) -> Samples:
        """The points as the last frame's image has them under a Gaussian of `sigma` px."""
        image = self.view.blurred(sigma)
        return Samples(self.points, *template_values(self.view.camera.P, self.points.bound_to(self.posed), image))


@dataclass(frozen=True)
class Brightness:
    """Settings of the brightness cue.

    Attributes:
        points: how many surface points are followed in each view.
        blurs: Gaussians under which images are compared, coarse to fine, m on the body.
        sigma: noise of the brightness (sensor, sampling).
        slide: m by which the picture on the surface strays from its place (cloth, a wrong shape): more noise where
            brightness is steep.
        scale: difference, in standard deviations of the noise, at which a point begins to lose its say.
        jump: difference beyond which a point is given up for another.
        share: share of the points' information that counts (neighbouring points see the same pixels).
        update: share of the new brightness that a template point takes over in each frame.
        depth_tolerance: m that a point may lie behind the rendered surface and still count as seen.
        support: "robust": each part's noise grows by its differences in the frames before; "em": beside that each
            point counts as far as it was seen to move with the body, and not to stand still as what lies behind;
            "none": neither, which a body that does not fit needs: its contours and its brightness disagree steadily,
            and the brightness is not to lose its say.
        most: factor by which a part's noise grows at most.
    """

    points: int = 500
    blurs: tuple[float, ...] = (0.020, 0.005)
    sigma: float = 0.015
    slide: float = 0.0
    scale: float = 2.0
    jump: float = 0.06
    share: float = 0.8
    update: float = 0.2
    depth_tolerance: float = 0.012
    support: Support = "none"
    most: float = 10.0

    def __post_init__(self) -> None:
        positive = all(value > 0.0 for value in (self.sigma, self.scale, self.jump, self.share))
        if not (positive and self.slide >= 0.0 and self.most >= 1.0):
            raise InputError(
                "brightness: sigma, scale, jump and share must be positive, slide not negative and most 1 or more."
            )

    def remember(self, view: View, seen: RenderedView, posed: Posed, old: Template | None, lesson: bool) -> Template:
        """Template for the next frame; `seen` chooses the points now visible, `posed` (the settled pose) places them.

        Points of the old template that are still seen stay, one in each cell of a grid, and their brightness follows
        the image slowly, which keeps the track from creeping along the surface. In a `lesson` they are judged by how
        they agreed, and new points fill the empty cells.
        """
        cell, occupied = empty_grid(view, seen, self.points)
        image, kept = view.blurred(self.blurs[-1] * seen.px_per_m), None
        if old is not None:
            if lesson and self.support != "none":
                old = self._judged(old, view, image, seen, posed, cell)
            kept = self._kept(view, image, seen, posed, old, cell, occupied)
            if not lesson:
                return kept
        points = seen.surface_points(*strongest_in_cells(view.grey, seen.inverse_depth_image, cell, occupied))
        fresh = Samples(points, *template_values(view.camera.P, points.bound_to(posed), image))
        trust, S = np.full(len(points), _NEW if self.support == "em" else 1.0), len(posed.body.segment_names)
        if kept is None:
            return Template(fresh, trust, np.ones(S), image, view, posed)
        return replace(kept, samples=kept.samples + fresh, trust=np.concatenate([kept.trust, trust]))

    def _kept(
        self, view: View, image: Float32, seen: RenderedView, posed: Posed, old: Template, cell: int, occupied: Bool
    ) -> Template:
        """The old template's points that are still seen, their brightness brought up to date."""
        surface, known = old.points.bound_to(posed), (old.samples.value, old.samples.gradient)
        rule, depths = (self.depth_tolerance, self.update, self.jump), seen.inverse_depth_image
        value, gradient, which = refreshed(view.camera.P, surface, known, image, depths, rule, cell, occupied)
        samples = Samples(old.points[which], value, gradient)
        return Template(samples, old.trust[which], old.excess, image, view, posed)

    def _judged(
        self, old: Template, view: View, image: Float32, seen: RenderedView, posed: Posed, cell: int
    ) -> Template:
        """The template with excess and trust as a settled frame makes them."""
        P, points = view.camera.P, old.points
        visible = visible_points(P, points.bound_to(posed), seen.inverse_depth_image, self.depth_tolerance)
        noise = self._noise(old.samples, seen.px_per_m)
        r = old.samples.residuals(posed, P, image, np.zeros(EXPOSURE)) / noise
        now = robust_scale(r, points.part, len(old.excess), visible * old.trust, 1.0, self.most)
        known = (visible * old.trust > 0.0) & np.isfinite(r)
        shown = np.bincount(points.part, known, len(old.excess)) > 0  # of what is hidden nothing is learnt
        excess = np.where(shown, _PAST * old.excess + (1.0 - _PAST) * now, old.excess)
        if self.support == "robust":
            return replace(old, excess=excess)
        last = old.view.camera
        shift = view.camera.K[:2, 2] - last.K[:2, 2]  # of the crops
        behind, pixels = unmoved(last.P, points.bound_to(old.posed), old.image, image, shift)
        support = posterior(
            r[:, None], (behind / noise)[:, None], np.clip(old.trust, _LEAST, 1.0 - _LEAST),
            old.excess[points.part][:, None], np.ones(1), Neighbourhood.about(pixels / cell, 1.0), _NEITHER,
        )  # fmt: skip
        return replace(old, excess=excess, trust=np.where(visible > 0.0, 0.5 * (old.trust + support), old.trust))

    def _noise(self, samples: Samples, px_per_m: float) -> Float:
        """(N,) expected standard deviation of the points' differences."""
        return np.sqrt(self.sigma**2 + (self.slide * px_per_m) ** 2 * np.sum(samples.gradient**2, axis=1))

    def term(self, view: View, seen: RenderedView, template: Template, level: int) -> PhotometricTerm:
        """Brightness constancy of the template's points that the rendered view says are visible."""
        P, blur, points = view.camera.P, self.blurs[level] * seen.px_per_m, template.points
        visible = visible_points(P, points.bound_to(seen.posed), seen.inverse_depth_image, self.depth_tolerance)
        samples = template.samples if level in (-1, len(self.blurs) - 1) else template.blurred(blur)
        noise = template.excess[points.part] * self._noise(samples, seen.px_per_m)
        weight = visible * template.trust * (self.share / noise**2)
        return PhotometricTerm(P, samples, view.blurred(blur), weight, self.scale * noise)


LOOSE_CLOTHES = Brightness(sigma=0.006, slide=0.001, share=0.5, update=0.1, support="em")
"""For a body that fits under clothes that do not."""


def empty_grid(view: View, seen: RenderedView, count: int) -> tuple[int, Bool]:
    """Side of a cell, px, and the cells of a grid of which about `count` lie on the body; none is occupied."""
    cell = max(1, round(math.sqrt(max(np.count_nonzero(seen.mask), 1) / max(count, 1))))
    return cell, np.zeros((view.grey.shape[0] // cell + 1, view.grey.shape[1] // cell + 1), dtype=np.bool_)


@njit(cache=True, nogil=True)
def template_values(P: Float, surface: SurfaceArrays, image: Float32) -> tuple[Float, Float]:
    """Brightness (N,) and image gradient (N, 2) of surface points in an image; NaN and 0 outside it."""
    transforms, segments, weights, local = surface
    N = len(local)
    value, gradient = np.full(N, np.nan), np.zeros((N, 2))
    for n in range(N):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        here, gx, gy, inside = sample(image, x, y)
        if w > 0.0 and inside:
            value[n], gradient[n, 0], gradient[n, 1] = here, gx, gy
    return value, gradient


@njit(cache=True, nogil=True)
def unmoved(P: Float, surface: SurfaceArrays, before: Float32, now: Float32, shift: Float) -> tuple[Float, Float]:
    """How much brightness has changed where surface points were in the frame before, and those pixels.

    Args:
        P, surface: of that frame.
        before, now: its image, and the present one.
        shift: (2,) px from the pixels of the one to those of the other.

    Returns:
        (N,) differences, NaN off the images, and (N, 2) pixels in the image before.
    """
    transforms, segments, weights, local = surface
    change, pixels = np.full(len(local), np.nan), np.zeros((len(local), 2))
    for n in range(len(local)):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        if w > 0.0:
            pixels[n, 0], pixels[n, 1] = x, y
            change[n] = brightness_at(now, x + shift[0], y + shift[1]) - brightness_at(before, x, y)
    return change, pixels


@njit(cache=True, nogil=True)
def refreshed(
    P: Float, surface: SurfaceArrays, known: tuple[Float, Float], image: Float32, inverse_depth: Float32,
    rule: tuple[float, float, float], cell: int, occupied: Bool,
) -> tuple[Float, Float, Int]:  # fmt: skip
    """Template points that are still seen, the first in each cell of the grid `occupied`, which is filled in.

    Args:
        known: brightness (N,) and gradient (N, 2) of the old template.
        image: the present one, blurred as the template's.
        inverse_depth: (H, W) of the rendered body.
        rule: m that a point may lie behind it and still be seen, the fraction of the present brightness that is taken
            over, and the difference of brightness beyond which a point is given up.

    Returns:
        New values (M,), gradients (M, 2) and indices (M,) of the points kept.
    """
    (transforms, segments, weights, local), (value, gradient), (tolerance, update, most) = surface, known, rule
    N = len(value)
    kept, now, slope = np.empty(N, dtype=np.int32), np.empty(N), np.empty((N, 2))
    count = 0
    for n in range(N):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        if not _in_sight(x, y, w, inverse_depth, tolerance):
            continue
        row, column = int(y + 0.5), int(x + 0.5)
        r, c = (row - 2) // cell, (column - 2) // cell
        if row < 2 or column < 2 or occupied[r, c]:
            continue
        here, gx, gy, inside = sample(image, x, y)
        if not inside or not abs(here - value[n]) < most:
            continue
        now[count] = value[n] + update * (here - value[n])
        slope[count, 0] = gradient[n, 0] + update * (gx - gradient[n, 0])
        slope[count, 1] = gradient[n, 1] + update * (gy - gradient[n, 1])
        occupied[r, c] = True
        kept[count] = n
        count += 1
    return now[:count].copy(), slope[:count].copy(), kept[:count].copy()


@njit(cache=True, nogil=True, inline="always")
def _in_sight(x: float, y: float, w: float, inverse_depth: Float32, tolerance: float) -> bool:
    """Whether a point of inverse depth w, seen at (x, y), lies no more than `tolerance` m behind the surface there."""
    height, width = inverse_depth.shape
    if w == 0.0 or not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):
        return False
    surface = inverse_depth[int(y + 0.5), int(x + 0.5)]
    return surface > 0.0 and 1.0 / w < 1.0 / surface + tolerance


@njit(cache=True, nogil=True)
def strongest_in_cells(grey: Float32, inverse_depth: Float32, cell: int, occupied: Bool) -> tuple[Int, Int]:
    """Rows and columns of body pixels, the most textured of each cell that is not occupied, none at a rim."""
    height, width = grey.shape
    best = np.zeros(occupied.shape, dtype=np.float32)
    best_row, best_column = np.empty(best.shape, dtype=np.int32), np.empty(best.shape, dtype=np.int32)
    cell_of = (np.arange(width) - 2) // cell  # divisions are slow
    for r in range(2, height - 2):
        i = (r - 2) // cell
        for c in range(2, width - 2):
            if inverse_depth[r, c] == 0.0:
                continue
            j = cell_of[c]
            if occupied[i, j]:
                continue
            gx, gy = grey[r, c + 1] - grey[r, c - 1], grey[r + 1, c] - grey[r - 1, c]
            strength = np.float32(1e-9) + gx * gx + gy * gy
            if strength > best[i, j] and not _at_rim(inverse_depth, r, c):
                best[i, j], best_row[i, j], best_column[i, j] = strength, r, c
    rows, columns = np.empty(best.size, dtype=np.int32), np.empty(best.size, dtype=np.int32)
    count = 0
    for i, j in np.ndindex(occupied.shape):
        if best[i, j] > 0.0:
            rows[count], columns[count] = best_row[i, j], best_column[i, j]
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
def visible_points(P: Float, surface: SurfaceArrays, inverse_depth: Float32, tolerance: float) -> Float:
    """(N,) 1.0 where a surface point lies no more than `tolerance` m behind the rendered surface, else 0.0."""
    transforms, segments, weights, local = surface
    out = np.zeros(len(local))
    for n in range(len(local)):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        out[n] = 1.0 if _in_sight(x, y, w, inverse_depth, tolerance) else 0.0
    return out
