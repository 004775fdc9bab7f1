"""Image rows of poses and shape: derivatives by the poses of one or two frames and by the shape."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from twistcap.adjust.refine.sums import Derivatives, derivatives
from twistcap.arrays import Float, Int
from twistcap.body import Posed
from twistcap.body.kinematics import skin_points
from twistcap.body.shape import RestMotion
from twistcap.camera.projection import projected
from twistcap.cues.view import View
from twistcap.render import RenderedView, SurfacePoints
from twistcap.terms import PointTerm
from twistcap.terms.photometric import sampled
from twistcap.terms.points import projected_rows
from twistcap.terms.robust import weighted_cauchy

Term = TypeVar("Term", PointTerm, "BrightnessPair")


def reshaped(term: Term, maps: Float | None) -> Term:
    """The term with its rest points moved by maps (S, 4, 4) of the segments, as a change of shape moves them."""
    if maps is None:
        return term
    points: SurfacePoints = term.points  # pyright: ignore[reportAttributeAccessIssue]  (every term of points has them)
    moved = skin_points(maps, points.segments, points.weights, points.local)
    return replace(term, points=replace(points, local=moved))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class End:
    """One of the two frames between which brightness is compared, by N points. Where they were seen (`pixels`, under
    P): their brightness `value` (N,) and its gradient `slope` (N, 2), 1/px."""

    P: Float
    value: Float
    slope: Float
    pixels: Float

    @staticmethod
    def of(view: View, seen: RenderedView, points: SurfacePoints, blur: float) -> End:
        """As an image shows points under a blur (m on the body); NaN for points off the image."""
        pixels, _ = projected(view.camera, points.at(seen.posed))
        value, slope = sampled(view.blurred(blur * seen.px_per_m), pixels)
        return End(view.camera.P, value, slope, pixels)

    def at(self, posed: Posed, points: SurfacePoints) -> tuple[Float, Float]:
        """Brightness (N,) at a pose, to first order in the pixel, and its gradient (N, 3) by the world points."""
        change, gradient = projected_rows(self.P, points.at(posed), self.slope, self.pixels)
        return self.value + change, gradient

    def subset(self, which: Int) -> End:
        return End(self.P, self.value[which], self.slope[which], self.pixels[which])


@dataclass(frozen=True)
class BrightnessPair:
    """Brightness constancy of N points between two frames, ``I_b(π(x_b)) − I_a(π(x_a))``, both poses free.

    Bregler and Malik, DOI 10.1109/CVPR.1998.698581, eq. 17 ff., here in perspective. `first` and `second` are numbers
    of frames, `earlier` and `later` how these show the points. A difference of `scale` counts by half (Cauchy).
    """

    first: int
    second: int
    points: SurfacePoints
    earlier: End
    later: End
    information: float
    scale: float

    @staticmethod
    def of(
        frames: tuple[int, int], points: SurfacePoints, earlier: tuple[View, RenderedView],
        later: tuple[View, RenderedView], blur: float, noise: tuple[float, float, float],
    ) -> BrightnessPair:  # fmt: skip
        """Of those points of the earlier view that both show, in each the body as rendered.

        They are compared under a blur (m on the body). `noise` is the information of each difference, the scale of the
        loss, and the depth (m) by which a point may be behind the surface.
        """
        points = points[later[1].visible(points, noise[2])[0]]
        a, b = End.of(*earlier, points, blur), End.of(*later, points, blur)
        known = np.flatnonzero(np.isfinite(a.value) & np.isfinite(b.value)).astype(np.int32)
        return BrightnessPair(*frames, points[known], a.subset(known), b.subset(known), *noise[:2])

    def energy(self, earlier: Posed, later: Posed) -> float:
        """At the two poses."""
        residual = self.later.at(later, self.points)[0] - self.earlier.at(earlier, self.points)[0]
        return weighted_cauchy(residual, np.full(len(residual), self.information), self.scale)[0]

    def rows(
        self, earlier: Posed, later: Posed, motion: RestMotion
    ) -> tuple[float, Derivatives, Derivatives, Float, Float]:
        """Energy, derivatives by either end, weights (N,) and residuals (N,)."""
        (a, by_a), (b, by_b) = self.earlier.at(earlier, self.points), self.later.at(later, self.points)
        energy, weight = weighted_cauchy(b - a, np.full(len(a), self.information), self.scale)
        one = derivatives(earlier, motion, self.points, -by_a)
        return energy, one, derivatives(later, motion, self.points, by_b), weight, b - a
