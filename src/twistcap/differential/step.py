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
from twistcap.camera import ScaledView
from twistcap.cues.background import STILL, dominant_motion
from twistcap.cues.memory import Look, Memory, Retention, remember
from twistcap.cues.view import Picture
from twistcap.differential.evidence import JOINTS, Evidence, evidence, exposure_block, view_block
from twistcap.differential.model import DifferentialModel
from twistcap.differential.search import searched
from twistcap.differential.state import ROOT, State, Track
from twistcap.differential.world import world_pose
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.render import render
from twistcap.solve import BlockProblem, Variables, Vector, inverse, minimise
from twistcap.terms import BlockGaussian, BlockTerm
from twistcap.terms.photometric import EXPOSURE
from twistcap.terms.scaled import ViewGaussian

_DEEPER = 0.02  # m that a point may lie behind the rendered surface and still be remembered as seen
_LOST = 0.25  # mean support of the body's pixels, in the view that has most, below which the images support no pose
_LONGEST = 0.35  # rad; no joint turns farther in one step of the descent
_GAIN = 1e-3  # of the energy; a step that gains less is the last one of its level


@dataclass(frozen=True)
class Found:
    """The answer for one frame.

    Attributes:
        state: views and joint angles.
        support: (V,) mean support of the body's pixels in each view, 0 where there was no image.
        energy: of the solution.
        covariance: (6 V + J, 6 V + J) of the state's step; NaN where it could not be solved for.
        exposure: (V, 2) change of gain and offset from the frame before.
        steps: accepted solver steps.
    """

    state: State
    support: Float
    energy: float
    covariance: Float
    exposure: Float
    steps: int = 0

    def world_covariance(self, model: DifferentialModel) -> Float:
        """(6 + J, 6 + J) of the pose in the world, by finite differences of the views' motions."""
        n, views, cameras = len(self.covariance), ROOT * len(self.state.views), list(model.cameras)
        pose, G = world_pose(self.state, cameras), np.zeros((model.body.dof, n))
        G[ROOT:, views:] = np.eye(n - views)
        for k in range(views):
            by = np.zeros(n)
            by[k] = 1e-4
            there, back = (world_pose(self.state.retract(s), cameras) for s in (by, -by))
            G[:, k] = (there.minus(pose) - back.minus(pose)) / 2e-4
        return G @ self.covariance @ G.T


def step(track: Track, frame: Frame, model: DifferentialModel) -> tuple[Track, Estimate]:
    """Track one frame behind calibrated cameras; the pose in the first one is given.

    Raises:
        InputError: for images that do not fit, or a value that is not finite.
    """
    after, found = followed(track, frame.images, model)
    pose = world_pose(found.state, list(model.cameras))
    if not track.started:
        return after, Estimate(frame.index, frame.time, pose, 1e-6 * np.eye(model.body.dof))
    covariance, support = found.world_covariance(model), float(found.support.max())
    finite = bool(np.all(np.isfinite(pose.q)) and np.all(np.isfinite(covariance)))
    seen = any(image is not None for image in frame.images)
    status = "failed" if not finite else "converged" if seen else "no_images"
    return after, Estimate(
        frame.index, frame.time, pose, covariance, {"brightness": found.energy}, status, found.steps,
        lost=not finite or support < _LOST, support=support, predicted="constant_velocity",
    )  # fmt: skip


def followed(
    track: Track, images: Sequence[AnyArray | None], model: DifferentialModel, expected: State | None = None
) -> tuple[Track, Found]:
    """Follow the body into the next frame; a track that has not started takes its first frame as its state says.

    Args:
        track: so far.
        images: one per view, grey (H, W) or RGB (H, W, 3), uint8 or in [0, 1]; None for a view that dropped it.
        model: body and settings.
        expected: the state that is looked for about, such as an earlier pass over the sequence found; by default
            the last motion goes on, and limbs are searched where the settings ask for it.

    Raises:
        InputError: for a wrong number of images or angles, or values that are not finite.
    """
    _check(model.body, track.state, images)
    track = replace(track, state=track.state.sized(images))
    pictures = tuple(None if image is None else Picture(image) for image in images)
    follow = Follow(model, track, pictures, expected)
    return follow.next() if track.started else follow.first()


@dataclass(frozen=True)
class Follow:
    """One frame of a track; see `followed`."""

    model: DifferentialModel
    track: Track
    pictures: tuple[Picture | None, ...]
    expected: State | None = None

    def first(self) -> tuple[Track, Found]:
        """The state is known, and remembered."""
        state, V, D = self.track.state, len(self.pictures), len(self.track.velocity)
        exposure, nothing = np.zeros((V, EXPOSURE)), [None] * V
        track = replace(self.track, memories=self._remembered(state, nothing, exposure))
        return track, Found(state, np.ones(V), 0.0, np.zeros((D, D)), exposure)

    def next(self) -> tuple[Track, Found]:
        """Coarse to fine from where the body is expected."""
        rule, before, model = self.model.rule, self.track.state, self.model
        guess = self.expected or self._carried()
        x, priors, steps = self._variables(guess), self._priors(guess), 0
        motions = [self._behind(*pair) for pair in zip(self.track.memories, self.pictures, strict=True)]
        seen, problem, found = list[Evidence | None](), BlockProblem(priors), None
        for level in reversed(range(rule.levels)):
            seen = [self._evidence(v, level, state_at(x), motion) for v, motion in enumerate(motions)]
            if self.expected is None and level == rule.levels - 1 and rule.carry > 0:
                x = min((x, with_state(x, before)), key=lambda trial: misfit(seen, trial))
            if self.expected is None and level == min(1, rule.levels - 1) and model.config.search_deg > 0:
                x = self._searched(seen, x)
            for _ in range(rule.iterations):
                seen = [None if e is None else e.expected(x, model) for e in seen]
                problem = BlockProblem([*(e for e in seen if e is not None), *priors])
                found = minimise(problem, x, steps=1, gain=_GAIN)
                x, steps = found.x, steps + found.steps
                if found.status != "max_iterations":
                    break
        assert found is not None
        return self._ended(x, seen, sum(found.energies.values()), found.system.hessian, steps)

    def _ended(
        self, x: Variables, seen: Sequence[Evidence | None], energy: float, hessian: Float, steps: int
    ) -> tuple[Track, Found]:
        state, D = state_at(x), len(self.track.velocity)
        exposure = np.array([x[exposure_block(v)].values for v in range(len(seen))])
        known = inverse(hessian)
        covariance = np.full((D, D), np.nan) if known is None else known[:D, :D]
        support = np.array([0.0 if e is None or len(e.support) == 0 else e.support.mean() for e in seen])
        track = Track(state, state.minus(self.track.state), self._remembered(state, seen, exposure))
        return track, Found(state, support, energy, covariance, exposure, steps)

    def _carried(self) -> State:
        """Where the last motion leads, that of the joints as far as it carries."""
        carry, state = self.model.rule.carry, self.track.state
        motion = self.track.velocity * (carry > 0)
        motion[ROOT * len(state.views) :] *= carry
        return state.retract(motion)

    def _variables(self, state: State) -> Variables:
        """The views' motions, the joints inside their limits, and the views' exposures."""
        views = view_blocks(state)
        exposures = {exposure_block(v): Vector(np.zeros(EXPOSURE)) for v in range(len(views))}
        joints = Vector(np.clip(state.q, *self.model.body.limits.T), self.model.body.limits)
        blocks = {**views, JOINTS: joints, **exposures}
        free = tuple(blocks) if self.model.config.exposure else (*views, JOINTS)
        planar = np.array([False] * 3 + [True, True, False])
        fixed = dict.fromkeys(views, planar) if self.model.config.turns == "planar" else {}
        return Variables(blocks, free, {**dict.fromkeys(blocks, np.inf), JOINTS: _LONGEST}, fixed)

    def _priors(self, guess: State) -> list[BlockTerm]:
        """How far the state strays from the guess, and the views' exposures from those of the frame before."""
        q, lit = self._variables(guess)[JOINTS].values, np.array([self.model.rule.gain, self.model.rule.offset])
        out: list[BlockTerm] = [
            BlockGaussian(JOINTS, q, np.full(len(q), np.deg2rad(self.model.config.stray_deg)), JOINTS)
        ]
        for v, view in enumerate(guess.views):
            out.append(ViewGaussian(view_block(v), view, self.model.rule.view_sigma))
            out.append(BlockGaussian(exposure_block(v), np.zeros(EXPOSURE), lit, "exposure"))
        return out

    def _behind(self, memory: Memory | None, picture: Picture | None) -> Float:
        if self.model.config.behind == "still" or picture is None or memory is None:
            return STILL
        before, after = (p.level(0, self.model.config.colour)[0] for p in (memory.picture, picture))
        return dominant_motion(before, after, memory.mask)

    def _evidence(self, v: int, level: int, state: State, motion: Float) -> Evidence | None:
        memory, picture = self.track.memories[v], self.pictures[v]
        if memory is None or picture is None:
            return None
        visible, _ = render(state.posed(self.model.body), state.views[v]).visible(memory.points, 0.03)
        return evidence(v, self.model, memory, level, picture, visible, motion)

    def _searched(self, seen: Sequence[Evidence | None], x: Variables) -> Variables:
        """With limbs where a coarse search puts them."""

        def cost(state: State, segments: Bool) -> float:
            return misfit([None if e is None else e.of(segments) for e in seen], with_state(x, state))

        reach, spread = np.deg2rad(self.model.config.search_deg), np.deg2rad(self.model.config.stray_deg)
        return with_state(x, searched(self.model.body, state_at(x), cost, reach, spread))

    def _remembered(self, state: State, seen: Sequence[Evidence | None], exposure: Float) -> tuple[Memory | None, ...]:
        """The memories as the frame shows them."""
        out, posed, rule, retention = (
            list(self.track.memories),
            state.posed(self.model.body),
            self.model.rule,
            self._retention,
        )
        for v, (e, picture) in enumerate(zip(seen, self.pictures, strict=True)):
            old = out[v]
            if picture is None:
                continue
            if old is not None and e is not None:
                trust = old.trust.copy()
                trust[e.which] = 0.5 * (trust[e.which] + e.support)
                old = replace(old, trust=trust) if rule.update < 1.0 else None
            levels = picture.levels(rule.levels, self.model.config.colour)
            out[v] = remember(Look(picture, levels, render(posed, state.views[v]), posed, exposure[v]), old, retention)
        return tuple(out)

    @property
    def _retention(self) -> Retention:
        return Retention(
            self.model.rule.spacing, "middle", self.model.rule.update, _DEEPER, trust=0.5, least_trust=0.2, trusted_first=True,
            hidden=self.model.rule.hidden,
        )  # fmt: skip


def misfit(seen: Sequence[Evidence | None], x: Variables) -> float:
    """Mean robust cost of all views."""
    return sum(e.misfit(x) for e in seen if e is not None)


def view_blocks(state: State) -> dict[str, ScaledView]:
    """The views by the names of their blocks."""
    return {view_block(v): view for v, view in enumerate(state.views)}


def with_state(x: Variables, state: State) -> Variables:
    """The blocks at another state, exposures as they are."""
    return replace(x, blocks={**x.blocks, **view_blocks(state), JOINTS: replace(x[JOINTS], values=state.q)})


def state_at(x: Variables) -> State:
    """The blocks as a state."""
    views = (x[view_block(v)] for v in range(len(x.blocks)) if view_block(v) in x.blocks)
    return State(tuple(views), x[JOINTS].values)


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
    model: DifferentialModel, state: State, frames: Sequence[Sequence[AnyArray | None]],
    expected: Sequence[State] | None = None,
) -> list[Found]:  # fmt: skip
    """Follow a body through frames of one image per view; `state` is that of the first, whose answer is left out.

    Where states are `expected`, one per frame, each frame is looked at about its own.
    """
    about, out, so_far = [None] * len(frames) if expected is None else expected, list[Found](), Track.of(state)
    for images, near in zip(frames, about, strict=True):
        so_far, found = followed(so_far, images, model, near)
        out.append(found)
    return out[1:]
