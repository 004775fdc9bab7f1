"""The direct contour cue: no level set, the boundary is measured along the normals of the projected contour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap._typing import Float
from twistcap.cues.view import View
from twistcap.region.lines import boundary_posterior, line_moments, pooled_gaussians, sample_lines
from twistcap.render import ContourPoints, RenderedView
from twistcap.terms import PointNormalTerm


@dataclass(frozen=True)
class DirectContour:
    """Settings of the direct contour cue; lengths are on the body, so that they scale with the person's size.

    Attributes:
        search: half length of the search lines, m.
        rho: width of the statistics' window along the contour, m.
        samples: samples on each half of a line.
        prior_mass: samples with which a part's whole statistics enter.
        floor: least variance of a density, brightness².
        clip: largest log density ratio per pixel, nats.
        least_sigma: measurement noise that no posterior goes below, px.
        share: share of the contour samples' information that counts: neighbours see the same pixels and statistics,
            so that they are not independent.
        robust: displacement at which a point begins to lose its say, m.
        inner: share of the information of contours before another part of the body.
    """

    search: float = 0.035
    rho: float = 0.06
    samples: int = 12
    prior_mass: float = 3.0
    floor: float = 4e-4
    clip: float = 3.0
    least_sigma: float = 0.5
    share: float = 0.2
    robust: float = 0.02
    inner: float = 1.0

    def measure(self, view: View, seen: RenderedView, contour: ContourPoints) -> ContourMeasurement:
        """Displacement, variance and evidence of every contour point."""
        px_per_m = seen.camera.K[0, 0] * contour.inverse_depth
        step = np.maximum(self.search * px_per_m / self.samples, 0.25)
        values, first, last = sample_lines(
            view.features, seen.part, contour.pixels, contour.normals, contour.part, contour.outer,
            step, self.samples,
        )  # fmt: skip
        moments = line_moments(values, first, last, step)
        mean, variance = pooled_gaussians(
            moments, contour.pixels, contour.part, self.rho * seen.px_per_m, self.prior_mass, self.floor
        )
        displacement, spread, evidence = boundary_posterior(values, first, last, step, mean, variance, self.clip)
        return ContourMeasurement(displacement, spread, evidence, (first, last, step))

    def term(self, seen: RenderedView, contour: ContourPoints, measured: ContourMeasurement) -> PointNormalTerm:
        """Point-to-normal term of the measured displacements."""
        target = contour.pixels + measured.displacement[:, None] * contour.normals
        weight = self.share / (measured.variance + self.least_sigma**2)
        weight *= np.where(contour.outer, 1.0, self.inner)
        return PointNormalTerm(seen.camera.P, contour.points, target, contour.normals, weight, self.robust * seen.px_per_m)


@dataclass(frozen=True)
class ContourMeasurement:
    """What the lines across a contour say, each (N,): displacement px, variance px², evidence nats; and their extent."""

    displacement: Float
    variance: Float
    evidence: Float
    extent: tuple[Float, ...] = ()
