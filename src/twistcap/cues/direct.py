"""The direct contour cue: no level set, the boundary is measured along the normals of the projected contour."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twistcap.arrays import Float
from twistcap.cues.appearance import AppearanceRule
from twistcap.cues.contour import ContourCue, ContourEvidence, part_agreement
from twistcap.cues.view import View
from twistcap.ranges import Checked, Count, Positive, Share
from twistcap.region.levelset import signed_distance
from twistcap.region.lines import Lines, LineSettings, Measured, measured_lines, ratio_lines
from twistcap.region.models import Density, RegionModel, Statistics, log_ratio_by_part, nearest_part
from twistcap.render import ContourPoints, RenderedView
from twistcap.terms import PointNormalTerm


@dataclass(frozen=True)
class DirectContour(Checked, ContourCue):
    """Settings of the direct contour cue; lengths are on the body, so that they scale with the person's size.

    Attributes:
        density: "local" Gaussians, one "global" Gaussian per region, or "parzen"; None: as the tracker has it. Local
            ones are estimated on the search lines themselves; all other models on the image, and only silhouettes are
            measured: what lies outside an inner contour is no background.
        statistics: of the "whole" body inside, or of each "part" its own; None: as the tracker has it, or part for
            local densities, else whole. Whole ones do without the parts' remembered colours and inner contours.
        parzen_sigma: kernel of Parzen densities, brightness.
        search: half length of the search lines, m.
        rho: width of the statistics' window along the contour, m.
        samples: samples on each half of a line.
        prior_mass: samples with which a part's whole statistics enter.
        floor: least variance of a density, brightness².
        clip: largest log density ratio per pixel, nats.
        least_sigma: measurement noise that no posterior goes below, px.
        surface_sigma: how far the body's surface may lie off the person's, m, standard deviation; None: as the tracker
            has it, or 0.
        share: share of the contour samples' information that counts: neighbours see the same pixels and statistics,
            so that they are not independent.
        robust: displacement at which a point begins to lose its say, m.
        inner: share of the information of contours before another part of the body.
        colour_mass: samples with which a part's remembered colours enter, where they are sure.
        alternations: fine alternations of correspond and update in each frame.
        appearance: how the parts' colours are remembered.
        slip: share of its running mean below which a part's agreement calls for coarse alternations.
    """

    density: Density | None = None
    statistics: Statistics | None = None
    parzen_sigma: Positive = 0.02
    search: float = 0.035
    rho: Positive = 0.06
    samples: Count = 8
    prior_mass: float = 3.0
    floor: Positive = 4e-4
    clip: Positive = 3.0
    least_sigma: Positive = 0.25
    surface_sigma: float | None = None
    share: Share = 1.0
    robust: Positive = 0.01
    inner: float = 0.3
    colour_mass: float = 20.0
    alternations: Count = 1
    slip: float = 0.7
    appearance: AppearanceRule = field(default_factory=AppearanceRule)
    name: str = field(default="contour", init=False)

    def locate(
        self, view: View, seen: RenderedView, contour: ContourPoints, reach: float, colours: Float,
        scratch: dict[str, Any] | None = None,
    ) -> ContourEvidence:  # fmt: skip
        """Measure every contour point along its normal and make a point-to-normal term of it.

        `reach` lengthens the search lines and loosens the robust scale.
        """
        size, local = seen.px_per_m, self.density in (None, "local")
        if not local or self.statistics == "whole":
            contour = contour[contour.outer]
        focal = float(view.camera.K[0, 0])
        measured = self._on_lines if local else self._on_image
        displacement, weight, contrast, target = measured(view, seen, contour, reach * self.search * focal, colours)
        term = PointNormalTerm(
            view.camera.P, contour.points, target, contour.normals, weight, reach * self.robust * size
        )
        parts = len(seen.posed.body.segment_names)
        agreement = part_agreement(contour, displacement, contrast, focal, parts)
        return ContourEvidence(
            term, len(contour), agreement, contour=contour, displacement=displacement, contrast=contrast
        )

    def _on_lines(
        self, view: View, seen: RenderedView, contour: ContourPoints, reach: float, colours: Float
    ) -> Measured:
        """Local Gaussians of the lines about each one."""
        group = contour.part
        if self.statistics == "whole":
            group, colours = np.zeros_like(group), np.zeros_like(colours)
        visible = (seen.face_index, seen.posed.body.face_part)
        settings = self._settings(view, seen)
        return measured_lines(view.features, visible, _lines(contour), group, colours, reach, settings)

    def _on_image(
        self, view: View, seen: RenderedView, contour: ContourPoints, reach: float, colours: Float
    ) -> Measured:
        """Any region model, whose log ratio on the image is looked up along the lines."""
        longest = reach * float(contour.inverse_depth.max(initial=0.0))
        model = RegionModel(self.density or "local", self.rho, self.floor, 0.0, self.parzen_sigma)
        inside, wanted = seen.mask.astype(np.float32), np.abs(signed_distance(seen.mask)) <= longest + 2.0
        if self.statistics == "part":
            part = nearest_part(seen.part)
            ratio = log_ratio_by_part(model, view.features, inside, part, seen.px_per_m, wanted)
        else:
            ratio = model.log_ratio(view.features, inside, np.float32(1.0) - inside, seen.px_per_m, wanted)
        visible = (seen.face_index, seen.posed.body.face_part)
        return ratio_lines(ratio, visible, _lines(contour), reach, self._settings(view, seen))

    def _settings(self, view: View, seen: RenderedView) -> LineSettings:
        return LineSettings(
            half=self.samples, clip=self.clip, fraction=self.share, inner=self.inner, least_sigma=self.least_sigma,
            surface_sigma=(self.surface_sigma or 0.0) * float(view.camera.K[0, 0]), rho=self.rho * seen.px_per_m,
            prior_mass=self.prior_mass, floor=self.floor, colour_mass=self.colour_mass,
        )  # fmt: skip


def _lines(contour: ContourPoints) -> Lines:
    return contour.pixels, contour.normals, contour.part, contour.outer, contour.inverse_depth
