"""The direct contour cue: no level set, the boundary is measured along the normals of the projected contour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.cues.evidence import ContourEvidence
from twistcap.cues.view import View
from twistcap.region.lines import measured_lines
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
    samples: int = 8
    prior_mass: float = 3.0
    floor: float = 4e-4
    clip: float = 3.0
    least_sigma: float = 0.25
    share: float = 1.0
    robust: float = 0.01
    inner: float = 0.3

    def measure(self, view: View, seen: RenderedView, contour: ContourPoints, coarse: float) -> ContourEvidence:
        """Measure every contour point along its normal and make a point-to-normal term of it.

        `coarse` ≥ 1 lengthens the search lines and loosens the robust scale in early alternations.
        """
        step = np.maximum(coarse * self.search / self.samples * view.camera.K[0, 0] * contour.inverse_depth, 0.25)
        displacement, spread, contrast = measured_lines(
            view.features, seen.part, contour.pixels, contour.normals, contour.part, contour.outer, step, self.samples,
            self.rho * seen.px_per_m, self.prior_mass, self.floor, self.clip,
        )  # fmt: skip
        weight = self.share / (spread + self.least_sigma**2) * np.where(contour.outer, 1.0, self.inner)
        term = PointNormalTerm(
            view.camera.P, contour.points, contour.pixels + displacement[:, None] * contour.normals, contour.normals,
            weight, coarse * self.robust * seen.px_per_m,
        )  # fmt: skip
        return ContourEvidence(term, contour, displacement, contrast)
