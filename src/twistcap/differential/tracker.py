"""The differential tracker: image gradients to twist and joint velocities, frame after frame.

Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998, DOI 10.1109/CVPR.1998.698581. Beyond
the paper: the brightness of surface points is remembered over frames (``update = 1`` remembers none), the
motion is predicted, and a wide prior on its change keeps what no pixel sees finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from twistcap._typing import AnyArray, Bool, Float, Float32, Int
from twistcap.body import Body
from twistcap.differential.background import STILL, dominant_motion, under_motion
from twistcap.differential.memory import Look, Memory, Retention, pyramid, remember, sampled
from twistcap.differential.render import render
from twistcap.differential.search import searched
from twistcap.differential.support import Neighbourhood, posterior, robust_scale
from twistcap.differential.system import EXPOSURE, Samples, normal_equations, residuals
from twistcap.differential.view import ROOT, State
from twistcap.errors import InputError

_GREY = np.array([0.299, 0.587, 0.114])
_PLAIN_SIGMA = 0.02  # brightness; scale of the residuals where none is estimated


@dataclass(frozen=True)
class DifferentialConfig:
    """Settings of the differential tracker.

    Attributes:
        levels: of the image pyramid, by factors of 2.
        iterations: Gauss-Newton steps at each level.
        spacing: px between surface points at the finest level.
        update: share of the new brightness a remembered point takes over in each frame; 1 remembers nothing.
        hidden: frames that points are remembered while something hides them.
        support: "em" for support maps by EM, "robust" for Cauchy weights, "shape" for the projected body as it is.
        behind: the layer behind stands "still", or moves as the "dominant" motion off the body.
        carry: share of the joints' last motion that is expected to go on; 0 expects everything to stay.
        exposure: whether each view's exposure may change from frame to frame.
        share: share of the pixels' information that counts, since neighbours see the same.
        turns: "planar" holds the view's turns out of the image.
        stray_deg, stray_turn_deg, stray_scale, stray_px: how far joints, and the views' turns, scales and places stray
            from the guess in a frame.
        search_deg: how far about the guess limbs are sought before the gradients have their say; 0 seeks none.
        reach_px: distance from a rim at which half of the pixels are the body's own, prior of the support maps.
    """

    levels: int = 4
    iterations: int = 6
    spacing: int = 2
    update: float = 0.2
    hidden: int = 30
    support: Literal["em", "robust", "shape"] = "em"
    behind: Literal["still", "dominant"] = "still"
    carry: float = 1.0
    exposure: bool = True
    share: float = 0.05
    turns: Literal["all", "planar"] = "all"
    stray_deg: float = 6.0
    stray_turn_deg: float = 3.0
    stray_scale: float = 0.01
    stray_px: float = 8.0
    search_deg: float = 0.0
    reach_px: float = 1.0

    def __post_init__(self) -> None:
        whole = self.levels >= 1 and self.iterations >= 1 and self.spacing >= 1
        if not whole or not 0.0 < self.update <= 1.0 or not 0.0 < self.share <= 1.0:
            raise InputError(
                "differential: levels, iterations and spacing must be 1 or more, "
                "update and share above 0 and at most 1."
            )
        if min(self.stray_deg, self.stray_turn_deg, self.stray_scale, self.stray_px) <= 0.0:
            raise InputError("differential: stray_deg, stray_turn_deg, stray_scale and stray_px must be positive.")


@dataclass(frozen=True)
class DifferentialEstimate:
    """The answer for one frame.

    Attributes:
        state: views and joint angles.
        support: (V,) mean support of the body's pixels in each view.
        sigma: (V,) median robust scale, brightness.
        energy: of the solution.
        covariance: (6 V + J, 6 V + J) of the state's step.
        exposure: (V, 2) change of gain and offset from the frame before.
    """

    state: State
    support: Float
    sigma: Float
    energy: float
    covariance: Float
    exposure: Float


@dataclass
class _Evidence:
    """What one view has at one level: points, their images and support."""

    samples: Samples
    which: Int
    image: Float32
    factor: float
    prior: Float
    behind: Float
    part: Int
    near: Neighbourhood
    weight: Float = field(default_factory=lambda: np.zeros(0))
    support: Float = field(default_factory=lambda: np.zeros(0))
    sigma: float = np.nan

    def of(self, segments: Bool) -> _Evidence:
        """What some segments (S,) have of it, for a look at their residuals."""
        own = np.flatnonzero(segments[self.part]).astype(np.int32)
        few = Samples(self.samples.points[own], self.samples.value[own], self.samples.gradient[own])
        return replace(self, samples=few, prior=self.prior[own])


class DifferentialTracker:
    """Follows a body from a known first state.

    Args:
        body: whose surface gives the depth.
        state: in the first images.
        images: of the first frame, one per view: grey (H, W) or RGB (H, W, 3), uint8 or in [0, 1].
        config: settings.

    Raises:
        InputError: for a wrong number of images or angles, or values that are not finite.
    """

    def __init__(
        self, body: Body, state: State, images: Sequence[AnyArray], config: DifferentialConfig | None = None
    ) -> None:
        self.body, self.config = body, config or DifferentialConfig()
        _check(body, state, images)
        self.state, self.velocity = state, np.zeros(ROOT * len(state.views) + len(state.q))
        self._memory = [self._remembered(v, pyramid(grey(image), self.config.levels)) for v, image in enumerate(images)]

    def step(self, images: Sequence[AnyArray]) -> DifferentialEstimate:
        """Follow the body into the next frame."""
        _check(self.body, self.state, images)
        pyramids = [pyramid(grey(image), self.config.levels) for image in images]
        before, guess = self.state, self._clipped(self.state.retract(self._expected_motion()))
        moved = [self._behind(memory, levels) for memory, levels in zip(self._memory, pyramids, strict=True)]
        state, exposure = guess, np.zeros((len(images), EXPOSURE))
        views: list[_Evidence] = []
        for level in reversed(range(self.config.levels)):
            views = [self._evidence(v, level, pyramids[v], state, moved[v]) for v in range(len(images))]
            if level == self.config.levels - 1 and self.config.carry > 0:
                state = self._better(views, [guess, before], exposure)
            if level == min(1, self.config.levels - 1) and self.config.search_deg > 0:
                state = self._sought(views, state, exposure)
            state, exposure, energy, H = self._settle(views, state, guess, exposure)
        self._remember(state, views, pyramids, exposure)
        self.velocity, self.state = state.minus(before), state
        D = len(self.velocity)
        return DifferentialEstimate(
            state, np.array([e.support.mean() for e in views]), np.array([e.sigma for e in views]),
            energy, np.linalg.inv(H)[:D, :D], exposure,
        )  # fmt: skip

    def _expected_motion(self) -> Float:
        """(6 V + J,) the last motion, that of the joints as far as it carries."""
        out = self.velocity.copy()
        out[ROOT * len(self.state.views) :] *= self.config.carry
        return out if self.config.carry > 0 else 0.0 * out

    def _clipped(self, state: State) -> State:
        return State(state.views, np.clip(state.q, *self.body.limits.T))

    def _behind(self, memory: Memory, levels: Sequence[Float32]) -> Float:
        if self.config.behind == "still":
            return STILL
        return dominant_motion(memory.pyramid[0], levels[0], memory.mask)

    def _evidence(self, v: int, level: int, levels: Sequence[Float32], state: State, motion: Float) -> _Evidence:
        """Points of a view that are seen at the present guess, thinned at coarse levels."""
        memory, factor = self._memory[v], 0.5**level
        seen = render(state.posed(self.body), state.views[v], _size(levels[0]))
        visible, *_ = seen.visible(memory.points, 0.03)
        which = _thinned(factor * memory.pixels / self.config.spacing, visible)
        samples, small = memory.at_level(level, which), levels[level]
        at = memory.level_pixels(level, which)
        was = sampled(memory.pyramid[level], at)[0]
        behind = sampled(small, under_motion(at, np.c_[motion[:, :2], factor * motion[:, 2]]))[0] - was
        behind[memory.missed[which] > 0] = np.nan  # what was seen at its pixel was not the point's own
        prior = np.ones(len(which))
        if self.config.support == "em":
            shape = _shape_prior(factor * memory.inside[which], self.config.reach_px)
            prior = np.clip(0.5 * (shape + memory.trust[which]), 0.02, 0.98)
        return _Evidence(samples, which, small, factor, prior, behind, _part(samples), _near(at))

    def _better(self, views: Sequence[_Evidence], starts: Sequence[State], exposure: Float) -> State:
        """The start whose residuals are smaller."""
        return min(starts, key=lambda start: sum(self._misfit(e, v, start, exposure) for v, e in enumerate(views)))

    def _sought(self, views: Sequence[_Evidence], state: State, exposure: Float) -> State:
        """The state with limbs where a coarse search puts them."""

        def misfit(trial: State, segments: Bool) -> float:
            return sum(self._misfit(e.of(segments), v, trial, exposure) for v, e in enumerate(views))

        return searched(self.body, state, misfit, np.deg2rad(self.config.search_deg), np.deg2rad(self.config.stray_deg))

    def _misfit(self, e: _Evidence, v: int, state: State, exposure: Float) -> float:
        if len(e.samples.value) == 0:
            return 0.0
        r = self._residuals(e, v, state, exposure)
        r = np.where(np.isfinite(r), r, 0.2)
        return float(np.mean(e.prior * np.log1p((r / _PLAIN_SIGMA) ** 2)))

    def _residuals(self, e: _Evidence, v: int, state: State, exposure: Float) -> Float:
        return residuals(state.posed(self.body), state.views[v].resized(e.factor), e.samples, e.image, exposure[v])

    def _settle(
        self, views: Sequence[_Evidence], state: State, guess: State, exposure: Float
    ) -> tuple[State, Float, float, Float]:
        """Gauss-Newton at one level; support maps are found anew before each step."""
        energy, H = np.inf, np.eye(1)
        for _ in range(self.config.iterations):
            for v, e in enumerate(views):
                self._support(e, self._residuals(e, v, state, exposure))
            g, H = self._sum(views, state, guess, exposure)
            energy = self._energy(views, state, guess, exposure)
            delta = -np.linalg.solve(H, g)
            size = float(np.abs(delta[ROOT * len(views) : len(delta) - EXPOSURE * len(views)]).max(initial=0.0))
            delta *= min(1.0, 0.35 / max(size, 1e-9))
            for _ in range(4):
                trial = self._clipped(state.retract(delta[: len(delta) - EXPOSURE * len(views)]))
                lit = exposure + delta[len(delta) - EXPOSURE * len(views) :].reshape(-1, EXPOSURE)
                trial_energy = self._energy(views, trial, guess, lit)
                if trial_energy < energy:
                    break
                delta *= 0.4
            else:
                break
            state, exposure = trial, lit
            if energy - trial_energy < 1e-3 * energy:
                break
        return state, exposure, energy, H

    def _support(self, e: _Evidence, r: Float) -> None:
        """The E step: support and weight of every point of a view."""
        S = len(self.body.segment_names)
        known = np.where(np.isfinite(r), 1.0, 0.0)
        if self.config.support == "shape":
            e.support, sigma = known, np.full(len(r), _PLAIN_SIGMA)
        else:
            weight = known * (e.support if len(e.support) else e.prior)
            sigma = robust_scale(r, e.part, S, weight)[e.part]
            if self.config.support == "em":
                sigma_behind = max(
                    0.01, 1.48 * float(np.nanmedian(np.abs(e.behind))) if np.isfinite(e.behind).any() else 0.01
                )
                e.support = posterior(r, e.behind, e.prior, sigma, min(sigma_behind, 0.03), e.near)
            else:
                e.support = known / (1.0 + np.where(known > 0, r, 0.0) ** 2 / sigma**2)
        e.sigma = float(np.median(sigma)) if len(sigma) else np.nan
        e.weight = e.support * self.config.share / sigma**2 / e.factor**2  # thinned points stand for as many pixels

    def _sum(self, views: Sequence[_Evidence], state: State, guess: State, exposure: Float) -> tuple[Float, Float]:
        """All views' systems in one, and the priors: by (views' motions, joints, exposures)."""
        J, V = len(state.q), len(views)
        n = ROOT * V + J + EXPOSURE * V
        g, H, posed = np.zeros(n), np.zeros((n, n)), state.posed(self.body)
        for v, e in enumerate(views):
            view = state.views[v].resized(e.factor)
            own_g, own_H = normal_equations(posed, view, e.samples, e.image, exposure[v], e.weight)
            per = np.ones(len(own_g))
            per[1:3] = e.factor  # the state's shifts are in px of the finest level
            own_g, own_H = per * own_g, per[:, None] * own_H * per
            rows = np.r_[
                ROOT * v : ROOT * v + ROOT, ROOT * V : ROOT * V + J, n - EXPOSURE * (V - v) : n - EXPOSURE * (V - v - 1)
            ]
            g[rows] += own_g
            H[np.ix_(rows, rows)] += own_H
        stiff, off = self._stiffness(V, J), np.concatenate([state.minus(guess), exposure.ravel()])
        g += stiff * off
        H[range(n), range(n)] += stiff
        held = self._held(state, g)
        g[held], H[held], H[:, held] = 0.0, 0.0, 0.0
        H[held, held] = 1.0
        return g, H

    def _held(self, state: State, g: Float) -> Bool:
        """Which unknowns stay: joints pressed against a limit, and turns out of the image where those are not wanted."""
        V, J = len(state.views), len(state.q)
        held = np.zeros(len(g), dtype=bool)
        lower, upper = self.body.limits.T
        push = g[ROOT * V : ROOT * V + J]
        held[ROOT * V : ROOT * V + J] = ((state.q <= lower) & (push > 0)) | ((state.q >= upper) & (push < 0))
        if self.config.turns == "planar":
            held[3 : ROOT * V : ROOT] = held[4 : ROOT * V : ROOT] = True
        if not self.config.exposure:
            held[ROOT * V + J :] = True
        return held

    def _stiffness(self, V: int, J: int) -> Float:
        c = self.config
        root = np.array([c.stray_scale, c.stray_px, c.stray_px, *[np.deg2rad(c.stray_turn_deg)] * 3])
        sigma = np.concatenate([np.tile(root, V), np.full(J, np.deg2rad(c.stray_deg)), np.tile([0.1, 0.05], V)])
        return 1.0 / sigma**2

    def _energy(self, views: Sequence[_Evidence], state: State, guess: State, exposure: Float) -> float:
        """Of the weighted residuals and the priors, the support maps as they are."""
        total = 0.0
        for v, e in enumerate(views):
            r = self._residuals(e, v, state, exposure)
            total += 0.5 * float(np.sum(e.weight * np.where(np.isfinite(r), r, 0.2) ** 2))
        off = np.concatenate([state.minus(guess), exposure.ravel()])
        return total + 0.5 * float(np.sum(self._stiffness(len(views), len(state.q)) * off**2))

    def _remember(
        self, state: State, views: Sequence[_Evidence], pyramids: Sequence[Sequence[Float32]], exposure: Float
    ) -> None:
        memories: list[Memory] = []
        for v, e in enumerate(views):
            old = self._memory[v]
            trust = old.trust.copy()
            trust[e.which] = 0.5 * (trust[e.which] + e.support)
            memories.append(remember(self._look(state, v, pyramids[v], exposure[v]), old, trust, self._retention))
        self._memory = memories

    def _look(self, state: State, v: int, levels: Sequence[Float32], exposure: Float) -> Look:
        posed = state.posed(self.body)
        return Look(posed, render(posed, state.views[v], _size(levels[0])), levels, exposure)

    @property
    def _retention(self) -> Retention:
        return Retention(self.config.spacing, self.config.update, self.config.hidden)

    def _remembered(self, v: int, levels: Sequence[Float32]) -> Memory:
        return remember(self._look(self.state, v, levels, np.zeros(EXPOSURE)), None, None, self._retention)


def _size(image: Float32) -> tuple[int, int]:
    return image.shape[1], image.shape[0]


def _thinned(cells: Float, visible: Bool) -> Int:
    """The first visible point in each cell of a unit grid."""
    seen = np.flatnonzero(visible)
    at = np.rint(cells[seen]).astype(np.int64)
    _, first = np.unique(at[:, 0] * 100_000 + at[:, 1], return_index=True)
    return seen[first].astype(np.int32)


def _near(at: Float) -> Neighbourhood:
    at = np.rint(at[:, ::-1]).T.astype(np.int32)
    low = at.min(axis=1, initial=0 if at.size == 0 else int(at.max()))
    rows, columns = at - low[:, None]
    size = (int(rows.max(initial=0)) + 1, int(columns.max(initial=0)) + 1)
    return Neighbourhood(rows, columns, size)


def _shape_prior(inside: Float, reach: float) -> Float:
    """Share of the pixels so far inside the projected shape (px) that are the body's own."""
    return 0.95 / (1.0 + np.exp(-(inside - reach) / 0.7))


def _part(samples: Samples) -> Int:
    best = np.argmax(samples.points.weights, axis=1)
    return np.take_along_axis(samples.points.segments, best[:, None], axis=1)[:, 0].astype(np.int32)


def grey(image: AnyArray) -> Float32:
    """(H, W) float32 in [0, 1] of a grey or RGB image, uint8 or in [0, 1]."""
    values = image.astype(np.float32) / (255.0 if image.dtype == np.uint8 else 1.0)
    return np.ascontiguousarray(values @ _GREY.astype(np.float32) if values.ndim == 3 else values, dtype=np.float32)


def _check(body: Body, state: State, images: Sequence[AnyArray]) -> None:
    if len(images) != len(state.views):
        raise InputError(f"differential: {len(images)} images for {len(state.views)} views; give one for each view.")
    if len(state.q) != len(body.coordinate_names):
        raise InputError(
            f"differential: {len(state.q)} angles for {len(body.coordinate_names)} coordinates of the body."
        )
    for image in images:
        if image.dtype != np.uint8 and not np.all(np.isfinite(image)):
            raise InputError("differential: an image holds a value that is not finite; repair or leave out the frame.")
    if not np.all(np.isfinite(state.q)):
        raise InputError("differential: an angle of the first state is not finite.")


def track(
    body: Body, state: State, frames: Sequence[Sequence[AnyArray]], config: DifferentialConfig | None = None
) -> list[DifferentialEstimate]:
    """Follow a body through frames of one image per view; `state` is that of the first, whose estimate is left out."""
    tracker = DifferentialTracker(body, state, frames[0], config)
    return [tracker.step(images) for images in frames[1:]]
