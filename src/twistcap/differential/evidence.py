"""What one view says at one level of the pyramid: surface points, their residuals and support maps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.camera import ScaledView
from twistcap.cues.memory import Memory, level_pixels, sampled_channels
from twistcap.cues.support_maps import Neighbourhood, posterior, robust_scale
from twistcap.cues.view import Picture
from twistcap.differential.background import under_motion
from twistcap.differential.settings import DifferentialConfig
from twistcap.differential.system import normal_equations
from twistcap.terms.photometric import EXPOSURE, Samples

_PLAIN_SIGMA = 0.02  # brightness; scale of the residuals where none is estimated
_OFF = 0.2  # residual of a point that has left the image
_BEHIND = (0.01, 0.03)  # brightness; least and largest scale of the layer behind


@dataclass
class Evidence:
    """Points of one view at one level; support and weights are those of the last E step.

    Attributes:
        samples: N points, once for each channel (C).
        which: (N,) their numbers in the memory.
        image: (C, H, W) of the level.
        factor: its size against the finest.
        prior: (N,) of the support maps.
        behind: (N, C) residuals under the motion of the layer behind.
        part: (N,) segments.
        near: where the points are.
        support: (N,).
        weight: (N, C) information, 1/brightness².
        sigma: median robust scale.
    """

    samples: tuple[Samples, ...]
    which: Int
    image: Float32
    factor: float
    prior: Float
    behind: Float
    part: Int
    near: Neighbourhood
    support: Float = field(default_factory=lambda: np.zeros(0))
    weight: Float = field(default_factory=lambda: np.zeros((0, 1)))
    sigma: float = np.nan

    def of(self, segments: Bool) -> Evidence:
        """What some segments (S,) have of it, for a look at their residuals."""
        own = np.flatnonzero(segments[self.part]).astype(np.int32)
        few = tuple(Samples(s.points[own], s.value[own], s.gradient[own]) for s in self.samples)
        return replace(self, samples=few, prior=self.prior[own])

    def residuals(self, posed: Posed, view: ScaledView, exposure: Float) -> Float:
        """(N, C) at a pose; NaN off the image. Exposure changes grey alone."""
        lit = (exposure, *[np.zeros(EXPOSURE)] * (len(self.samples) - 1))
        P = view.scaled(self.factor).P
        found = [s.residuals(posed, P, im, x) for s, im, x in zip(self.samples, self.image, lit, strict=True)]
        return np.stack(found, axis=1)

    def misfit(self, posed: Posed, view: ScaledView, exposure: Float) -> float:
        """Mean robust cost, by which starts are compared."""
        if len(self.prior) == 0:
            return 0.0
        cost = np.log1p((known(self.residuals(posed, view, exposure)) / _PLAIN_SIGMA) ** 2).mean(axis=1)
        return float(np.mean(self.prior * cost))

    def energy(self, posed: Posed, view: ScaledView, exposure: Float) -> float:
        """``½ Σ w r²``."""
        return 0.5 * float(np.sum(self.weight * known(self.residuals(posed, view, exposure)) ** 2))

    def equations(self, posed: Posed, view: ScaledView, exposure: Float) -> tuple[Float, Float]:
        """Gradient and matrix of the energy by (φ, θ̇, exposure), φ's shifts in px of the finest level."""
        n = posed.body.dof + EXPOSURE
        g, H, own = np.zeros(n), np.zeros((n, n)), view.scaled(self.factor)
        for c, (s, image) in enumerate(zip(self.samples, self.image, strict=True)):
            lit = exposure if c == 0 else np.zeros(EXPOSURE)
            weight = np.ascontiguousarray(self.weight[:, c])
            more_g, more_H = normal_equations(posed, own, s, image, lit, weight)
            if c > 0:
                more_g[-EXPOSURE:], more_H[-EXPOSURE:], more_H[:, -EXPOSURE:] = 0.0, 0.0, 0.0
            g += more_g
            H += more_H
        per = np.ones(n)
        per[1:3] = self.factor
        return per * g, per[:, None] * H * per

    def expect(self, posed: Posed, view: ScaledView, exposure: Float, config: DifferentialConfig) -> None:
        """The E step: support and weight of every point at a pose."""
        r = self.residuals(posed, view, exposure)
        there = np.isfinite(r).all(axis=1).astype(float)
        if config.support == "shape":
            self.support, sigma = there, np.full(r.shape, _PLAIN_SIGMA)
        else:
            weight = there * (self.support if len(self.support) else self.prior)
            S = len(posed.body.segment_names)
            sigma = np.stack(
                [robust_scale(r[:, c], self.part, S, weight)[self.part] for c in range(r.shape[1])], axis=1
            )
            if config.support == "em":
                self.support = posterior(r, self.behind, self.prior, sigma, self._sigma_behind(), self.near)
            else:
                self.support = there / (1.0 + np.mean((np.where(there[:, None] > 0, r, 0.0) / sigma) ** 2, axis=1))
        self.sigma = float(np.median(sigma[:, 0])) if len(sigma) else np.nan
        self.weight = self.support[:, None] * config.share / sigma**2

    def _sigma_behind(self) -> Float:
        seen = np.isfinite(self.behind).all(axis=1)
        if not seen.any():
            return np.full(self.behind.shape[1], _BEHIND[0])
        return np.clip(1.48 * np.median(np.abs(self.behind[seen]), axis=0), *_BEHIND)


def known(residual: Float) -> Float:
    """Residuals with those off the image set to a large one."""
    return np.where(np.isfinite(residual), residual, _OFF)


def evidence(
    memory: Memory, level: int, picture: Picture, visible: Bool, motion: Float, config: DifferentialConfig
) -> Evidence:
    """The remembered points that are `visible` (N,), thinned at coarse levels.

    Args:
        memory: of the frame before.
        level: of the pyramid.
        picture: of the present frame.
        visible: whether a point is seen at the present guess.
        motion: (2, 3) of the layer behind, px of the finest level.
        config: settings.
    """
    factor, (image, before) = 0.5**level, (p.level(level, config.colour) for p in (picture, memory.picture))
    which = _thinned(factor * memory.pixels / config.spacing, visible)
    at = level_pixels(np.take(memory.pixels, which, axis=0), level)
    shrunk = np.c_[motion[:, :2], factor * motion[:, 2]]
    behind = sampled_channels(image, under_motion(at, shrunk))[0] - sampled_channels(before, at)[0]
    behind[memory.missed[which] > 0] = np.nan  # what was seen at its pixel was not the point's own
    prior = np.ones(len(which))
    if config.support == "em":
        shape = _shape_prior(factor * memory.inside[which], config.reach_px)
        prior = np.clip(0.5 * (shape + memory.trust[which]), 0.02, 0.98)
    samples = memory.samples(level, which)
    return Evidence(samples, which, image, factor, prior, behind, samples[0].points.part, Neighbourhood.about(at))


def _thinned(cells: Float, visible: Bool) -> Int:
    """The first visible point in each cell of a unit grid."""
    seen = np.flatnonzero(visible)
    at = np.rint(cells[seen]).astype(np.int64)
    _, first = np.unique(at[:, 0] * 100_000 + at[:, 1], return_index=True)
    return seen[first].astype(np.int32)


def _shape_prior(inside: Float, reach: float) -> Float:
    """Share of the pixels so far inside the projected shape (px) that are the body's own."""
    return 0.95 / (1.0 + np.exp(-(inside - reach) / 0.7))
