"""The differential tracker: image gradients to twist and joint velocities, frame after frame.

Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998, DOI 10.1109/CVPR.1998.698581. Beyond
the paper: the brightness of surface points is remembered over frames (``update = 1`` remembers none), the
motion is predicted, and a wide prior on its change keeps what no pixel sees finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap._typing import AnyArray, Bool, Float
from twistcap.body import Body
from twistcap.cues.memory import Look, Memory, Retention, remember
from twistcap.cues.view import Picture
from twistcap.differential.background import STILL, dominant_motion
from twistcap.differential.evidence import Evidence, evidence
from twistcap.differential.search import searched
from twistcap.differential.settings import DifferentialConfig
from twistcap.differential.view import ROOT, State
from twistcap.errors import InputError
from twistcap.render import render
from twistcap.terms.photometric import EXPOSURE

_BEHIND = 0.02  # m that a point may lie behind the rendered surface and still be remembered as seen
_LONGEST = 0.35  # rad; no joint turns farther in one step of the descent


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
        state = state.sized(images)
        self.state, self.velocity = state, np.zeros(ROOT * len(state.views) + len(state.q))
        looks = [self._look(state, v, Picture(image), np.zeros(EXPOSURE)) for v, image in enumerate(images)]
        self._memory = [remember(look, None, self._retention) for look in looks]

    def step(self, images: Sequence[AnyArray | None], expected: State | None = None) -> DifferentialEstimate:
        """Follow the body into the next frame.

        Args:
            images: one per view; None stands for that of a view that dropped it.
            expected: the state that is looked for about, such as an earlier pass over the sequence found; by default
                the last motion goes on, and limbs are sought where the settings ask for it.
        """
        _check(self.body, self.state, images)
        pictures = [None if image is None else Picture(image) for image in images]
        before, guess = self.state, expected or self._clipped(self.state.retract(self._expected_motion()))
        moved = [self._behind(memory, picture) for memory, picture in zip(self._memory, pictures, strict=True)]
        problem = _Frame(self.body, self.config, guess)
        state, views = guess, list[Evidence]()
        for level in reversed(range(self.config.levels)):
            views = [self._evidence(v, level, picture, state, moved[v]) for v, picture in enumerate(pictures)]
            problem.views = views
            if expected is None and level == self.config.levels - 1 and self.config.carry > 0:
                state = min((guess, before), key=problem.misfit)
            if expected is None and level == min(1, self.config.levels - 1) and self.config.search_deg > 0:
                state = self._sought(problem, state)
            state = problem.settle(state)
        self._remember(state, views, pictures, problem.exposure)
        self.velocity, self.state = state.minus(before), state
        D = len(self.velocity)
        return DifferentialEstimate(
            state,
            np.array([e.support.mean() if len(e.support) else 0.0 for e in views]),
            np.array([e.sigma for e in views]),
            problem.energy(state, problem.exposure),
            np.asarray(np.linalg.inv(problem.matrix)[:D, :D], np.float64),
            problem.exposure,
        )

    def _expected_motion(self) -> Float:
        """(6 V + J,) the last motion, that of the joints as far as it carries."""
        out = self.velocity.copy()
        out[ROOT * len(self.state.views) :] *= self.config.carry
        return out if self.config.carry > 0 else 0.0 * out

    def _clipped(self, state: State) -> State:
        return State(state.views, np.clip(state.q, *self.body.limits.T))

    def _behind(self, memory: Memory, picture: Picture | None) -> Float:
        if self.config.behind == "still" or picture is None:
            return STILL
        before, after = (p.level(0, self.config.colour)[0] for p in (memory.picture, picture))
        return dominant_motion(before, after, memory.mask)

    def _evidence(self, v: int, level: int, picture: Picture | None, state: State, motion: Float) -> Evidence:
        memory = self._memory[v]
        if picture is None:
            return evidence(memory, level, memory.picture, np.zeros(len(memory.trust), np.bool_), motion, self.config)
        visible, _ = render(state.posed(self.body), state.views[v]).visible(memory.points, 0.03)
        return evidence(memory, level, picture, visible, motion, self.config)

    def _sought(self, problem: _Frame, state: State) -> State:
        """The state with limbs where a coarse search puts them."""
        reach, spread = np.deg2rad(self.config.search_deg), np.deg2rad(self.config.stray_deg)
        return searched(self.body, state, problem.misfit_of, reach, spread)

    def _remember(
        self, state: State, views: Sequence[Evidence], pictures: Sequence[Picture | None], exposure: Float
    ) -> None:
        memories: list[Memory] = []
        for v, e in enumerate(views):
            old, picture = self._memory[v], pictures[v]
            if picture is None:
                memories.append(old)
                continue
            trust = old.trust.copy()
            trust[e.which] = 0.5 * (trust[e.which] + e.support)
            kept = replace(old, trust=trust) if self.config.update < 1.0 else None
            memories.append(remember(self._look(state, v, picture, exposure[v]), kept, self._retention))
        self._memory = memories

    def _look(self, state: State, v: int, picture: Picture, exposure: Float) -> Look:
        posed, levels = state.posed(self.body), picture.levels(self.config.levels, self.config.colour)
        return Look(picture, levels, render(posed, state.views[v]), posed, exposure)

    @property
    def _retention(self) -> Retention:
        return Retention(
            self.config.spacing, "middle", self.config.update, _BEHIND, trust=0.5, least_trust=0.2, trusted_first=True,
            hidden=self.config.hidden,
        )  # fmt: skip


class _Frame:
    """The least-squares problem of one frame: all views' evidence in one system, and the priors.

    Unknowns are the views' motions, the joints' and the views' exposures, (6 V + J + 2 V).
    """

    def __init__(self, body: Body, config: DifferentialConfig, guess: State) -> None:
        self.body, self.config, self.guess = body, config, guess
        self.views: list[Evidence] = []
        self.exposure = np.zeros((len(guess.views), EXPOSURE))
        self.matrix = np.eye(1)
        V, J = len(guess.views), len(guess.q)
        self._motions = ROOT * V + J
        root = np.array([config.stray_scale, *[config.stray_px] * 2, *[np.deg2rad(config.stray_turn_deg)] * 3])
        sigma = np.concatenate([np.tile(root, V), np.full(J, np.deg2rad(config.stray_deg)), np.tile([0.1, 0.05], V)])
        self._stiffness = 1.0 / sigma**2

    def misfit(self, state: State) -> float:
        """Mean robust cost of a state."""
        return self.misfit_of(state, np.ones(len(self.body.segment_names), dtype=np.bool_))

    def misfit_of(self, state: State, segments: Bool) -> float:
        """The same on the pixels of some segments (S,)."""
        posed = state.posed(self.body)
        pairs = zip(self.views, state.views, self.exposure, strict=True)
        return sum(e.of(segments).misfit(posed, view, lit) for e, view, lit in pairs)

    def settle(self, state: State) -> State:
        """Gauss-Newton at one level; support maps are found anew before each step."""
        for _ in range(self.config.iterations):
            posed = state.posed(self.body)
            for e, view, lit in zip(self.views, state.views, self.exposure, strict=True):
                e.expect(posed, view, lit, self.config)
            g, self.matrix = self._sum(state)
            energy = self.energy(state, self.exposure)
            found = self._lowered(state, np.asarray(-np.linalg.solve(self.matrix, g), np.float64), energy)
            if found is None:
                break
            state, self.exposure, lower = found
            if energy - lower < 1e-3 * energy:
                break
        return state

    def _lowered(self, state: State, delta: Float, energy: float) -> tuple[State, Float, float] | None:
        """State, exposure and energy after the step or a part of it that lowers the energy; None if none does."""
        turn = float(np.abs(delta[ROOT * len(self.views) : self._motions]).max(initial=0.0))
        delta = delta * min(1.0, _LONGEST / max(turn, 1e-9))
        for _ in range(4):
            trial = state.retract(delta[: self._motions])
            trial = State(trial.views, np.clip(trial.q, *self.body.limits.T))
            lit = self.exposure + delta[self._motions :].reshape(-1, EXPOSURE)
            lower = self.energy(trial, lit)
            if lower < energy:
                return trial, lit, lower
            delta = 0.4 * delta
        return None

    def energy(self, state: State, exposure: Float) -> float:
        """Of the weighted residuals and the priors, the support maps as they are."""
        posed = state.posed(self.body)
        total = sum(e.energy(posed, v, lit) for e, v, lit in zip(self.views, state.views, exposure, strict=True))
        return total + 0.5 * float(np.sum(self._stiffness * self._off(state, exposure) ** 2))

    def _off(self, state: State, exposure: Float) -> Float:
        return np.concatenate([state.minus(self.guess), exposure.ravel()])

    def _sum(self, state: State) -> tuple[Float, Float]:
        """All views' systems in one, and the priors."""
        V, n, posed = len(self.views), len(self._stiffness), state.posed(self.body)
        g, H = np.zeros(n), np.zeros((n, n))
        for v, (e, view, lit) in enumerate(zip(self.views, state.views, self.exposure, strict=True)):
            own, exposure = ROOT * v, self._motions + EXPOSURE * v
            rows = np.r_[own : own + ROOT, ROOT * V : self._motions, exposure : exposure + EXPOSURE]
            more_g, more_H = e.equations(posed, view, lit)
            g[rows] += more_g
            H[np.ix_(rows, rows)] += more_H
        g += self._stiffness * self._off(state, self.exposure)
        H[range(n), range(n)] += self._stiffness
        held = self._held(state, g)
        g[held], H[held], H[:, held] = 0.0, 0.0, 0.0
        H[held, held] = 1.0
        return g, H

    def _held(self, state: State, g: Float) -> Bool:
        """Which unknowns stay: joints pressed against a limit; turns out of the image where those are not wanted."""
        first = ROOT * len(state.views)
        held = np.zeros(len(g), dtype=np.bool_)
        lower, upper = self.body.limits.T
        push = g[first : self._motions]
        held[first : self._motions] = ((state.q <= lower) & (push > 0)) | ((state.q >= upper) & (push < 0))
        if self.config.turns == "planar":
            held[3:first:ROOT] = held[4:first:ROOT] = True
        if not self.config.exposure:
            held[self._motions :] = True
        return held


def _check(body: Body, state: State, images: Sequence[AnyArray | None]) -> None:
    if len(images) != len(state.views):
        raise InputError(f"differential: {len(images)} images for {len(state.views)} views; give one for each view.")
    if len(state.q) != len(body.coordinate_names):
        raise InputError(
            f"differential: {len(state.q)} angles for {len(body.coordinate_names)} coordinates of the body."
        )
    for image in images:
        if image is not None and image.dtype != np.uint8 and not np.all(np.isfinite(image)):
            raise InputError("differential: an image holds a value that is not finite; repair or leave out the frame.")
    if not np.all(np.isfinite(state.q)):
        raise InputError("differential: an angle of the first state is not finite.")


def track(
    body: Body, state: State, frames: Sequence[Sequence[AnyArray]], config: DifferentialConfig | None = None,
    expected: Sequence[State] | None = None,
) -> list[DifferentialEstimate]:  # fmt: skip
    """Follow a body through frames of one image per view; `state` is that of the first, whose estimate is left out.

    Where states are `expected`, one per frame, each frame is looked at about its own; see `DifferentialTracker.step`.
    """
    tracker = DifferentialTracker(body, state, frames[0], config)
    about = [None] * len(frames) if expected is None else expected
    return [tracker.step(images, e) for images, e in zip(frames[1:], about[1:], strict=True)]
