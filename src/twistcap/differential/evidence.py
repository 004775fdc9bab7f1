"""What one view says at one level of the pyramid: surface points, their residuals and support maps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Body
from twistcap.camera.scaled import ROOT, ScaledView
from twistcap.cues.background import under_motion
from twistcap.cues.memory import Memory, level_pixels, sampled_channels
from twistcap.cues.view import Picture
from twistcap.differential.model import JOINTS, SPACING, DifferentialModel, exposure_block, posed_at, view_block
from twistcap.differential.support_maps import Neighbourhood, posterior, robust_scale
from twistcap.solve import Variables
from twistcap.terms import Place, Sums
from twistcap.terms.photometric import EXPOSURE, Samples
from twistcap.terms.scaled import normal_equations

_PLAIN_SIGMA = 0.02  # brightness; scale of the residuals where none is estimated
_FRACTION = 0.05  # of the pixels' information counts, since neighbours see the same
_REACH = 1.0  # px from a rim at which half of the pixels are the body's own
_OFF = 0.2  # residual of a point that has left the image
_BEHIND = (0.01, 0.03)  # brightness; least and largest scale of the layer behind


@dataclass(frozen=True)
class Evidence:
    """Points of one view at one level, as an energy of its motion, the joints and its exposure.

    Attributes:
        number, body: of the view, and the body in it.
        samples, which: N points, once for each channel (C), and their numbers (N,) in the memory.
        image, factor: (C, H, W) of the level, and its size against the finest.
        prior, support: (N,) of the support maps, before and after the last E step.
        behind: (N, C) residuals under the motion of the layer behind.
        near: where the points are.
        weight: (N, C) information, 1/brightness², of the last E step.
    """

    number: int
    body: Body
    samples: tuple[Samples, ...]
    which: Int
    image: Float32
    factor: float
    prior: Float
    behind: Float
    near: Neighbourhood
    support: Float
    weight: Float = field(default_factory=lambda: np.zeros((0, 1)))
    name: str = "brightness"

    @property
    def part(self) -> Int:
        """(N,) segments."""
        return self.samples[0].points.part

    def of(self, segments: Bool) -> Evidence:
        """What some segments (S,) have of it, for a look at their residuals."""
        own = np.flatnonzero(segments[self.part]).astype(np.int32)
        few = tuple(Samples(s.points[own], s.value[own], s.gradient[own]) for s in self.samples)
        return replace(self, samples=few, prior=self.prior[own])

    def residuals(self, x: Variables) -> Float:
        """(N, C); NaN off the image."""
        posed, P = posed_at(x, self.body), self._view(x).P
        pairs = zip(self.samples, self.image, self._exposures(x), strict=True)
        return np.stack([s.residuals(posed, P, image, lit) for s, image, lit in pairs], axis=1)

    def misfit(self, x: Variables) -> float:
        """Mean robust cost, by which starts are compared."""
        if len(self.prior) == 0:
            return 0.0
        cost = np.log1p((known(self.residuals(x)) / _PLAIN_SIGMA) ** 2).mean(axis=1)
        return float(np.mean(self.prior * cost))

    def energy(self, x: Variables) -> float:
        """``½ Σ w r²``."""
        return 0.5 * float(np.sum(self.weight * known(self.residuals(x)) ** 2))

    def add_to(self, sums: Sums, x: Variables) -> None:
        n = self.body.dof + EXPOSURE
        g, H, posed, view = np.zeros(n), np.zeros((n, n)), posed_at(x, self.body), self._view(x)
        for c, (s, image, lit) in enumerate(zip(self.samples, self.image, self._exposures(x), strict=True)):
            more_g, more_H = normal_equations(posed, view, s, image, lit, np.ascontiguousarray(self.weight[:, c]))
            own = slice(n if c == 0 else n - EXPOSURE)
            g[own] += more_g[own]
            H[own, own] += more_H[own, own]
        per = np.ones(n)
        per[1:3] = self.factor  # shifts are px of the finest level
        places = [
            Place(view_block(self.number), ROOT),
            Place(JOINTS, n - ROOT - EXPOSURE),
            Place(exposure_block(self.number), EXPOSURE),
        ]
        sums.add_quadratic(places, self.energy(x), per * g, per[:, None] * H * per)

    def expected(self, x: Variables, model: DifferentialModel) -> Evidence:
        """With the support and the weight of every point as an E step tells them."""
        r = self.residuals(x)
        there = np.isfinite(r).all(axis=1).astype(float)
        if model.config.support == "shape":
            support, sigma = there, np.full(r.shape, _PLAIN_SIGMA)
        else:
            scales = [robust_scale(c, self.part, len(self.body.segment_names), there * self.support) for c in r.T]
            sigma = np.stack([scale[self.part] for scale in scales], axis=1)
            if model.config.support == "em":
                support = posterior(r, self.behind, self.prior, sigma, self._sigma_behind(), self.near)
            else:
                support = there / (1.0 + np.mean((np.where(there[:, None] > 0, r, 0.0) / sigma) ** 2, axis=1))
        return replace(self, support=support, weight=support[:, None] * _FRACTION / sigma**2)

    def _view(self, x: Variables) -> ScaledView:
        view: ScaledView = x[view_block(self.number)]
        return view.scaled(self.factor)

    def _exposures(self, x: Variables) -> tuple[Float, ...]:
        """Of each channel: exposure changes grey alone."""
        return (x[exposure_block(self.number)].values, *[np.zeros(EXPOSURE)] * (len(self.samples) - 1))

    def _sigma_behind(self) -> Float:
        seen = np.isfinite(self.behind).all(axis=1)
        if not seen.any():
            return np.full(self.behind.shape[1], _BEHIND[0])
        return np.clip(1.48 * np.median(np.abs(self.behind[seen]), axis=0), *_BEHIND)


def known(residual: Float) -> Float:
    """Residuals with those off the image set to a large one."""
    return np.where(np.isfinite(residual), residual, _OFF)


def evidence(
    number: int, model: DifferentialModel, memory: Memory, level: int, picture: Picture, visible: Bool, motion: Float
) -> Evidence:
    """The remembered points that are `visible` (N,) at the present guess, thinned at coarse levels of the pyramid.

    The memory is that of the frame before, the picture that of the present one; `motion` (2, 3) is that of the layer
    behind, px of the finest level.
    """
    factor, (image, before) = 0.5**level, (p.level(level, model.config.colour) for p in (picture, memory.picture))
    which = _thinned(factor * memory.pixels / SPACING, visible)
    at = level_pixels(np.take(memory.pixels, which, axis=0), level)
    shrunk = np.c_[motion[:, :2], factor * motion[:, 2]]
    behind = sampled_channels(image, under_motion(at, shrunk))[0] - sampled_channels(before, at)[0]
    behind[memory.missed[which] > 0] = np.nan  # what was seen at its pixel was not the point's own
    prior = np.ones(len(which))
    if model.config.support == "em":
        shape = 0.95 / (1.0 + np.exp(-(factor * memory.inside[which] - _REACH) / 0.7))  # inside the projected shape
        prior = np.clip(0.5 * (shape + memory.trust[which]), 0.02, 0.98)
    samples = memory.samples(level, which)
    return Evidence(number, model.body, samples, which, image, factor, prior, behind, Neighbourhood.about(at), prior)


def _thinned(cells: Float, visible: Bool) -> Int:
    """The first visible point in each cell of a unit grid."""
    seen = np.flatnonzero(visible)
    at = np.rint(cells[seen]).astype(np.int64)
    _, first = np.unique(at[:, 0] * 100_000 + at[:, 1], return_index=True)
    return seen[first].astype(np.int32)
