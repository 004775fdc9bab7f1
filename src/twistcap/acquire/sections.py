"""Slices of a body: epipolar planes of two views, four control points in each, closed B-splines through them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from twistcap.arrays import Float, Float32
from twistcap.camera import Camera

_REACH, _STEP = 0.6, 0.001  # m on either side of the middle that is searched for the silhouette; sampling
_PASSES = 3  # in which the middle is improved


@dataclass(frozen=True)
class Cut:
    """One view's part of a slice: its camera and the silhouette (H, W) of the part in question, soft at its edge."""

    camera: Camera
    soft: Float32


def section(first: Cut, second: Cut, middle: Float) -> Float | None:
    """Four control points (4, 3) of the slice through a middle (3,), in order; None where a view shows nothing.

    The slicing plane holds both optical centres: it is seen as one epipolar line in either image, so that the two edges
    of each silhouette on it are four rays in one plane, which meet in four points. Their mean is the next middle.
    Source: Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", appendix.
    """
    corners = None
    for _ in range(_PASSES):
        normal = np.cross(first.camera.centre - middle, second.camera.centre - middle)
        normal /= np.linalg.norm(normal)
        one, two = _edges(first, middle, normal), _edges(second, middle, normal)
        if one is None or two is None:
            return None
        corners = np.array([_meet(first.camera.centre, a, second.camera.centre, b, normal) for a, b in (
            (one[0], two[0]), (one[1], two[0]), (one[1], two[1]), (one[0], two[1]))])  # fmt: skip
        middle = corners.mean(axis=0)
    return corners


def _edges(cut: Cut, middle: Float, normal: Float) -> Float | None:
    """(2, 3) points on the rays of the silhouette's two edges, on a line through the middle across the sight."""
    sight = middle - cut.camera.centre
    across = np.cross(normal, sight)
    across /= np.linalg.norm(across)
    s = np.arange(-_REACH, _REACH + _STEP, _STEP)
    pixels, _ = cut.camera.project(middle + s[:, None] * across)
    values = map_coordinates(cut.soft, pixels[:, ::-1].T, order=1, mode="constant")
    inside = np.flatnonzero(values > 0.5)
    if len(inside) == 0:
        return None
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    run = min(runs, key=lambda r: float(np.abs(s[r]).min()) - 0.2 * len(r) * _STEP)
    ends = [_crossing(s, values, int(run[0]), -1), _crossing(s, values, int(run[-1]), 1)]
    return middle + np.array(ends)[:, None] * across


def _crossing(s: Float, values: Float, at: int, side: int) -> float:
    """Where the values fall below 0.5 next to a sample, by linear interpolation."""
    beyond = at + side
    if not 0 <= beyond < len(s):
        return float(s[at])
    fraction = (values[at] - 0.5) / max(values[at] - values[beyond], 1e-9)
    return float(s[at] + fraction * (s[beyond] - s[at]))


def _meet(c1: Float, p1: Float, c2: Float, p2: Float, normal: Float) -> Float:
    """(3,) intersection of the lines c1 p1 and c2 p2 of one plane."""
    d1, d2 = p1 - c1, p2 - c2
    along = np.cross(normal, d2)
    return c1 + d1 * ((c2 - c1) @ along) / (d1 @ along)


def fullness(part: str) -> float:
    """How much of its corners a slice of a part fills, for `closed_spline`: trunks are fuller than limbs.

    Of the rectangle about a slice of Anny's people (14 builds of both sexes) trunks fill 0.83 in the median, as the
    chapter's B-spline does; thighs 0.78 and shanks 0.76, as an ellipse.
    """
    return 1.0 if part == "trunk" else 0.5**0.5


def closed_spline(control: Float, count: int, fullness: float = 1.0) -> Float:
    """(…, count, 3) points of the closed quadratic B-spline of control points (…, n, 3); n divides `count`.

    It touches each edge of the control polygon in its middle: with four points, the four rays of the silhouettes are
    its tangents. `fullness` is the weight of the control points against these middles, as in NURBS: with 1 it is the
    B-spline, 5/6 of the polygon's area where that is a parallelogram; with 1/√2 an ellipse, π/4 of it.
    """
    n = control.shape[-2]
    t = np.arange(count // n)[:, None] * n / count
    before, corner = (1 - t) ** 2, 2 * fullness * t * (1 - t)
    middles = 0.5 * (control + np.roll(control, -1, axis=-2))[..., None, :]
    corners, after = np.roll(control, -1, axis=-2)[..., None, :], np.roll(middles, -1, axis=-3)
    points = (before * middles + corner * corners + t**2 * after) / (before + corner + t**2)
    return points.reshape(*control.shape[:-2], count, control.shape[-1])


def sections(first: Cut, second: Cut, middles: Iterable[Float]) -> Float:
    """(n, 4, 3) control points of the slices through middles (3,), without those that a view does not show."""
    corners = [section(first, second, middle) for middle in middles]
    return np.array([c for c in corners if c is not None]).reshape(-1, 4, 3)
