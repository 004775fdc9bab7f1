"""The level-set contour cue: segment with the projected body as shape prior, match, and pull on the pixels' rays.

The coupled method of the chapter (Brox, Rosenhahn and Cremers, sections 11.2-11.3): the readable reference, and the
oracle that the direct cue is held against.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32
from twistcap.cues.evidence import ContourEvidence, Segmentation
from twistcap.cues.view import View
from twistcap.region.densities import blockwise_log_ratio, global_log_ratio, heaviside
from twistcap.region.levelset import evolve, nearest_with_normal, signed_distance, zero_crossings
from twistcap.render import ContourPoints, RenderedView
from twistcap.terms import PointRayTerm


@dataclass(frozen=True)
class LevelSetContour:
    """Settings of the level-set cue; lengths in metres are on the body.

    Attributes:
        density: "local" Gaussians (the default) or one "global" Gaussian per region.
        rho: window of the local densities, m.
        floor: least variance, brightness².
        prior_mass: share of a window at which global statistics weigh as much as local ones.
        rounds: how often densities are estimated anew from the evolved contour (EM).
        steps, tau: explicit evolution steps and their size.
        nu: weight of the contour's length.
        lam: weight λ of the shape prior.
        width: standard deviation of H', m.
        clip: largest log density ratio, nats.
        least_cosine: partners whose normals differ by more are no match.
        sigma: measurement noise of a contour point, px.
        share: share of the points' information that counts (they are correlated).
        robust: distance at which a match begins to lose its say, m.
        alternations: fine alternations of correspond and update in each frame.
        slip: share of its running mean below which a part's agreement calls for coarse alternations; a
            limb before the body has no outline here, and often agrees little.
    """

    density: Literal["local", "global"] = "local"
    rho: float = 0.04
    floor: float = 4e-4
    prior_mass: float = 0.02
    rounds: int = 1
    steps: int = 3
    tau: float = 2.4
    nu: float = 0.5
    lam: float = 0.05
    width: float = 0.015
    clip: float = 3.0
    least_cosine: float = 0.5
    sigma: float = 0.5
    share: float = 1.0
    robust: float = 0.01
    alternations: int = 3
    slip: float = 0.0

    def measure(
        self, view: View, seen: RenderedView, contour: ContourPoints, coarse: float, colours: Float,
        earlier: ContourEvidence | None = None,
    ) -> ContourEvidence:  # fmt: skip
        """Segment, match the silhouette's points to the evolved contour, and make the term of their rays.

        `coarse` ≥ 1 widens the capture range in early alternations. The segmentation of `earlier` evidence, of the same
        rendered body, is matched again: its shape prior has hardly moved.
        """
        contour = contour[contour.outer]
        width = max(1.0, coarse * self.width * seen.px_per_m)
        found = earlier.segmentation if earlier is not None else None
        if found is None or found.width != width:
            found = self._segmented(view, seen, width)
        partner, distance = nearest_with_normal(
            contour.pixels, contour.normals, found.points, found.normals, self.least_cosine
        )
        matched = distance < 4.0 * width
        term = self._term(view, seen, contour[matched], partner[matched], coarse)
        displacement = np.where(matched, np.sum((partner - contour.pixels) * contour.normals, axis=1), 0.0)
        contrast = np.where(matched, _contrast(found.log_ratio, contour.pixels, contour.normals, seen.px_per_m), 0.0)
        return ContourEvidence(term, contour, displacement, contrast, found)

    def _segmented(self, view: View, seen: RenderedView, width: float) -> Segmentation:
        """Evolve the rendered body's outline in the image."""
        phi0 = signed_distance(seen.mask)
        band = max(4.0 * width, 0.04 * seen.px_per_m)  # where the contour may go, or contrast is looked for
        phi, ratio = phi0, self._log_ratio(view, phi0, seen.px_per_m, band)
        for again in range(self.rounds):
            ratio = self._log_ratio(view, phi, seen.px_per_m, 2.0 * band) if again else ratio
            phi = evolve(phi0, ratio, self.steps, self.tau * width, self.nu, self.lam / width, width, self.clip)
        return Segmentation(*zero_crossings(phi), np.clip(ratio, -self.clip, self.clip), width)

    def _log_ratio(self, view: View, phi: Float32, px_per_m: float, band: float) -> Float32:
        """The ratio within `band` px of the contour; beyond it nobody asks, and it is 0 or right."""
        inside = heaviside(phi, 0.7)
        if self.density == "global":
            return global_log_ratio(view.features, inside, self.floor)
        wanted = np.abs(phi) <= band
        return blockwise_log_ratio(view.features, inside, self.rho * px_per_m, self.floor, self.prior_mass, wanted)

    def _term(
        self, view: View, seen: RenderedView, contour: ContourPoints, partner: Float, coarse: float
    ) -> PointRayTerm:
        direction, moment = view.camera.rays(partner)
        weight = np.full(len(contour), self.share / self.sigma**2)
        px_per_m = view.camera.K[0, 0] * contour.inverse_depth
        robust = coarse * self.robust * seen.px_per_m
        return PointRayTerm(contour.points, direction, moment, px_per_m, weight, robust)


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
