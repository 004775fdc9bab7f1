"""The level-set contour cue: segment with the projected body as shape prior, match, and pull on the pixels' rays.

The coupled method of the chapter (Brox, Rosenhahn and Cremers, sections 11.2-11.3): the readable reference, and the
oracle that the direct cue is held against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32
from twistcap.cues.appearance import AppearanceRule
from twistcap.cues.contour import ContourCue, ContourEvidence, Segmentation, part_agreement
from twistcap.cues.view import View
from twistcap.ranges import Checked, Count, Positive, Share
from twistcap.region.densities import heaviside
from twistcap.region.levelset import evolve, nearest_with_normal, signed_distance, zero_crossings
from twistcap.region.matching import VariationalRule, displaced_partners, displacement
from twistcap.region.models import Density, RegionModel, Statistics, log_ratio_by_part, nearest_part
from twistcap.render import ContourPoints, RenderedView
from twistcap.terms import PointRayTerm

Matching = Literal["icp", "variational", "both"]


@dataclass(frozen=True)
class LevelSetContour(Checked, ContourCue):
    """Settings of the level-set cue; lengths in metres are on the body.

    Attributes:
        density: "local" Gaussians, one "global" Gaussian per region, or "parzen"; None: as the tracker has it.
        statistics: of the "whole" body inside, or of each "part" its own; None: as the tracker has it, or whole.
        parzen_sigma: kernel of Parzen densities, brightness.
        rho: window of the local densities, m.
        floor: least variance, brightness².
        prior_mass: share of a window at which global statistics weigh as much as local ones.
        gap: band about the body that counts as neither body nor background when densities are estimated, m; what the
            body leaves uncovered (a cap, cloth) is then no background.
        rounds: how often densities are estimated anew from the evolved contour (EM).
        continuation: factor on window and width in the first round, which shrinks to 1 in the last (coarse-to-fine).
        steps, tau: explicit evolution steps and their size.
        nu: weight of the contour's length.
        lam: weight λ of the shape prior.
        width: standard deviation of H', m.
        clip: largest log density ratio, nats.
        matching: partners of the contour's points on the evolved one: the nearest ("icp"), those of a smooth
            displacement field ("variational"), or both, with half the weight each.
        variational: how that field is found.
        least_cosine: partners whose normals differ by more are no match.
        sigma: measurement noise of a contour point, px.
        surface_sigma: how far the body's surface may lie off the person's, m, standard deviation; None: as the tracker
            has it, or 0.
        share: share of the points' information that counts (they are correlated).
        robust: distance at which a match begins to lose its say, m.
        alternations: fine alternations of correspond and update in each frame.
        appearance: how the parts' colours are remembered.
        slip: share of its running mean below which a part's agreement calls for coarse alternations; a
            limb before the body has no outline here, and often agrees little.
    """

    density: Density | None = None
    statistics: Statistics | None = None
    parzen_sigma: Positive = 0.02
    rho: Positive = 0.04
    floor: Positive = 4e-4
    prior_mass: float = 0.02
    gap: float = 0.0
    rounds: Count = 1
    continuation: float = 1.0
    steps: Count = 3
    tau: Positive = 2.4
    nu: float = 0.5
    lam: float = 0.05
    width: Positive = 0.015
    clip: Positive = 3.0
    matching: Matching = "icp"
    variational: VariationalRule = field(default_factory=VariationalRule)
    least_cosine: float = 0.5
    sigma: Positive = 0.5
    surface_sigma: float | None = None
    share: Share = 1.0
    robust: Positive = 0.01
    alternations: Count = 3
    slip: float = 0.0
    appearance: AppearanceRule = field(default_factory=AppearanceRule)
    name: str = field(default="contour", init=False)

    def locate(
        self, view: View, seen: RenderedView, contour: ContourPoints, reach: float, colours: Float,
        scratch: dict[str, Any] | None = None,
    ) -> ContourEvidence:  # fmt: skip
        """Segment, match the silhouette's points to the evolved contour, and make the term of their rays.

        `reach` widens the capture range. A segmentation in `scratch`, of the same rendered body, is matched again: its
        shape prior has hardly moved.
        """
        scratch = {} if scratch is None else scratch
        contour = contour[contour.outer]
        width = max(1.0, reach * self.width * seen.px_per_m)
        found: Segmentation | None = scratch.get(self.name)
        if found is None or found.width != width:
            found = scratch[self.name] = self._segmented(view, seen, width)
        matches = [(p, d < 4.0 * width) for p, d in self._partners(contour, found)]
        where = np.concatenate([np.flatnonzero(matched) for _, matched in matches])
        partner = np.concatenate([p[matched] for p, matched in matches])
        term = self._term(view, seen, contour[where.astype(np.int32)], partner, reach, len(matches))
        displacement = _mean_along(contour.pixels, contour.normals, matches)
        contrast = _contrast(found.log_ratio, contour.pixels, contour.normals, seen.px_per_m)
        contrast = np.where(np.any([matched for _, matched in matches], axis=0), contrast, 0.0)
        focal, parts = float(view.camera.K[0, 0]), len(seen.posed.body.segment_names)
        agreement = part_agreement(contour, displacement, contrast, focal, parts)
        return ContourEvidence(
            term, len(contour), agreement, contour=contour, displacement=displacement, contrast=contrast
        )

    def _partners(self, contour: ContourPoints, found: Segmentation) -> list[tuple[Float, Float]]:
        """Partners (N, 2) px of the points and their distances (N,), of each way of matching."""
        out: list[tuple[Float, Float]] = []
        if self.matching != "variational":
            out.append(
                nearest_with_normal(contour.pixels, contour.normals, found.points, found.normals, self.least_cosine)
            )
        if found.flow is not None:
            out.append(displaced_partners(contour.pixels, contour.normals, found.flow, found.phi, self.least_cosine))
        return out

    def _segmented(self, view: View, seen: RenderedView, width: float) -> Segmentation:
        """Evolve the rendered body's outline in the image, and match the two shapes."""
        phi0 = signed_distance(seen.mask)
        phi = ratio = phi0
        for k in range(self.rounds):
            stretch = self.continuation ** (1.0 - k / (self.rounds - 1.0)) if self.rounds > 1 else 1.0
            wide = width * stretch
            band = max(4.0 * wide, 0.04 * seen.px_per_m)  # where the contour may go, or contrast is looked for
            ratio = self._log_ratio(view, seen, phi, (2.0 if k else 1.0) * band, stretch)
            phi = evolve(phi0, ratio, self.steps, self.tau * wide, self.nu, self.lam / wide, wide, self.clip)
        flow = None if self.matching == "icp" else displacement(phi0, phi, self.variational)
        return Segmentation(*zero_crossings(phi), np.clip(ratio, -self.clip, self.clip), width, phi, flow)

    def _log_ratio(self, view: View, seen: RenderedView, phi: Float32, band: float, stretch: float) -> Float32:
        """The ratio within `band` px of the contour; beyond it nobody asks, and it is 0 or right."""
        model = RegionModel(self.density or "local", stretch * self.rho, self.floor, self.prior_mass, self.parzen_sigma)
        inside, wanted = heaviside(phi, 0.7), np.abs(phi) <= band
        gap = self.gap * seen.px_per_m
        outside = np.float32(1.0) - (heaviside(phi + np.float32(gap), 0.7) if gap > 0.0 else inside)
        if self.statistics == "part":
            part = nearest_part(seen.part)
            return log_ratio_by_part(model, view.features, inside, part, seen.px_per_m, wanted, outside)
        return model.log_ratio(view.features, inside, outside, seen.px_per_m, wanted)

    def _term(
        self, view: View, seen: RenderedView, contour: ContourPoints, partner: Float, coarse: float, ways: int
    ) -> PointRayTerm:
        direction, moment = view.camera.rays(partner)
        px_per_m = view.camera.K[0, 0] * contour.inverse_depth
        weight = self.share / (ways * (self.sigma**2 + ((self.surface_sigma or 0.0) * px_per_m) ** 2))
        robust = coarse * self.robust * seen.px_per_m
        return PointRayTerm(contour.points, direction, moment, px_per_m, weight, robust)


def _mean_along(pixels: Float, normals: Float, matches: Sequence[tuple[Float, Bool]]) -> Float:
    """(N,) px outward to the mean of each point's partners; 0 where it has none."""
    steps = np.array([np.where(ok, np.sum((p - pixels) * normals, axis=1), 0.0) for p, ok in matches])
    return steps.sum(axis=0) / np.maximum(np.sum([ok for _, ok in matches], axis=0), 1)


@njit(cache=True, nogil=True)
def _contrast(log_ratio: Float32, pixels: Float, normals: Float, px_per_m: float) -> Float:
    """(N,) nats by which 3 cm of pixels inside each contour point look more like the body than 3 cm outside."""
    height, width = log_ratio.shape
    step, out = 0.01 * px_per_m, np.zeros(len(pixels))
    for n in range(len(pixels)):
        for k in (-3, -2, -1, 1, 2, 3):
            x = min(max(pixels[n, 0] + k * step * normals[n, 0], 0.0), width - 1.001)
            y = min(max(pixels[n, 1] + k * step * normals[n, 1], 0.0), height - 1.001)
            c, r = int(x), int(y)
            fx, fy = x - c, y - r
            top = (1.0 - fx) * log_ratio[r, c] + fx * log_ratio[r, c + 1]
            bottom = (1.0 - fx) * log_ratio[r + 1, c] + fx * log_ratio[r + 1, c + 1]
            out[n] += (-step if k > 0 else step) * ((1.0 - fy) * top + fy * bottom)
    return out
