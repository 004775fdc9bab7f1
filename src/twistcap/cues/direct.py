"""The direct contour cue: no level set, the boundary is measured along the normals of the projected contour."""

from __future__ import annotations

from dataclasses import dataclass

from twistcap._typing import Float
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
        colour_mass: samples with which a part's remembered colours enter, where they are sure.
        alternations: fine alternations of correspond and update in each frame.
        slip: share of its running mean below which a part's agreement calls for coarse alternations.
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
    colour_mass: float = 20.0
    alternations: int = 1
    slip: float = 0.7

    def measure(
        self, view: View, seen: RenderedView, contour: ContourPoints, coarse: float, colours: Float,
        earlier: ContourEvidence | None = None,
    ) -> ContourEvidence:  # fmt: skip
        """Measure every contour point along its normal and make a point-to-normal term of it.

        `coarse` ≥ 1 lengthens the search lines and loosens the robust scale in early alternations.
        """
        scale, size = view.camera.K[0, 0], seen.px_per_m
        displacement, weight, contrast, target = measured_lines(
            view.features, seen.face_index, seen.posed.body.face_part, contour.pixels, contour.normals, contour.part,
            contour.outer, contour.inverse_depth, coarse * self.search * scale, self.samples, self.rho * size,
            self.prior_mass, self.floor, self.clip, self.share, self.inner, self.least_sigma, colours,
            self.colour_mass,
        )  # fmt: skip
        term = PointNormalTerm(
            view.camera.P, contour.points, target, contour.normals, weight, coarse * self.robust * size
        )
        return ContourEvidence(term, contour, displacement, contrast)
