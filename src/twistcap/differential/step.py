"""The differential tracker: image gradients to twist and joint velocities, frame after frame.

Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998, DOI 10.1109/CVPR.1998.698581. Beyond
the paper: the brightness of surface points is remembered over frames (``update = 1`` remembers none), the
motion is predicted, and a wide prior on its change keeps what no pixel sees finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from twistcap import se3
from twistcap.arrays import AnyArray, Bool, Float
from twistcap.body import Body
from twistcap.cues.background import STILL, dominant_motion
from twistcap.cues.memory import Look, Memory, remember
from twistcap.cues.view import Picture
from twistcap.differential.evidence import Evidence, evidence
from twistcap.differential.model import DifferentialModel, exposure_block, posed_at, state_at, view_block, with_state
from twistcap.differential.search import searched
from twistcap.differential.state import ROOT, State, Track, world_pose
from twistcap.errors import InputError, check
from twistcap.estimate import Estimate, Frame
from twistcap.render import render
from twistcap.solve import BlockProblem, Dense, Variables, inverse, minimise
from twistcap.terms.photometric import EXPOSURE

_LOST = 0.25  # mean support of the body's pixels, in the view that has most, below which the images support no pose
_NEAR_LEVELS = 2  # of the image pyramid, about a state that is expected
_GAIN = 1e-3  # of the energy; a step that gains less is the last one of its level


@dataclass(frozen=True)
class Found:
    """The answer for one frame, after some accepted solver steps.

    `support` (V,) is the mean support of the body's pixels in each view, 0 without an image; the covariance
    (6 V + J, 6 V + J) that of the state's step, NaN where it could not be solved for; `exposure` (V, 2) the change of
    gain and offset from the frame before.
    """

    state: State
    support: Float
    energy: float
    covariance: Float
    exposure: Float
    steps: int = 0

    def world_covariance(self, model: DifferentialModel) -> Float:
        """(6 + J, 6 + J) of the pose in the world, by finite differences of the views' motions."""
        n, views, cameras = len(self.covariance), ROOT * len(self.state.views), list(model.rig)
        pose, G = world_pose(self.state, cameras), np.zeros((model.body.dof, n))
        G[ROOT:, views:] = np.eye(n - views)
        for k in range(views):
            by = np.zeros(n)
            by[k] = 1e-4
            there, back = (world_pose(self.state.retract(s), cameras) for s in (by, -by))
            G[:, k] = (there.minus(pose) - back.minus(pose)) / 2e-4
        return G @ self.covariance @ G.T


def step(track: Track, frame: Frame, model: DifferentialModel) -> tuple[Track, Estimate]:
    """Track one frame behind calibrated cameras; the pose in the first one is given. Raises InputError for images that
    do not fit, or a value that is not finite."""
    after, found = followed(track, frame.images, model)
    pose = world_pose(found.state, list(model.rig))
    if not track.started:
        return after, Estimate(
            frame.index, frame.time, pose, 1e-6 * np.eye(model.body.dof), brightness=frame.brightness
        )
    covariance, support = found.world_covariance(model), float(found.support.max())
    finite = bool(np.all(np.isfinite(pose.q)) and np.all(np.isfinite(covariance)))
    seen = any(image is not None for image in frame.images)
    status = "failed" if not finite else "converged" if seen else "no_images"
    return after, Estimate(
        frame.index, frame.time, pose, covariance, {"brightness": found.energy}, status, found.steps,
        lost=not finite or support < _LOST, support=support, predicted="constant_velocity",
        brightness=frame.brightness,
    )  # fmt: skip


def followed(
    track: Track, images: Sequence[AnyArray | None], model: DifferentialModel, expected: State | None = None
) -> tuple[Track, Found]:
    """Follow the body into the next frame; a track that has not started takes its first frame as its state says.

    Images are one per view, grey (H, W) or RGB (H, W, 3), uint8 or in [0, 1]; None for a view that dropped it. Without
    an `expected` state, such as an earlier pass found, the last motion goes on, and limbs are searched as the settings
    say; about one, the finest levels of the image pyramid are enough. Raises InputError for a wrong number of images or
    angles, or values that are not finite.
    """
    _check(model.body, track.state, images)
    track = replace(track, state=track.state.sized(images))
    pictures = tuple(None if image is None else Picture(image) for image in images)
    follow = _Follow(model, track, pictures, expected)
    return follow.next() if track.started else follow.first()


@dataclass(frozen=True)
class _Follow:
    """One frame of a track; see `followed`."""

    model: DifferentialModel
    track: Track
    pictures: tuple[Picture | None, ...]
    expected: State | None = None

    def first(self) -> tuple[Track, Found]:
        """The state is known, and remembered."""
        V, D = len(self.pictures), len(self.track.velocity)
        track = self._learned(self.model.variables(self.track.state), [], self.track.velocity)
        return track, Found(self.track.state, np.ones(V), 0.0, np.zeros((D, D)), np.zeros((V, EXPOSURE)))

    def next(self) -> tuple[Track, Found]:
        """Coarse to fine from where the body is expected."""
        model, before = self.model, self.track.state
        x = model.variables(self.expected or self._carried())
        priors, free = model.priors(x), self.expected is None
        coarsest = (model.rule.levels if free else min(_NEAR_LEVELS, model.rule.levels)) - 1
        motions = [self._behind(*pair) for pair in zip(self.track.memories, self.pictures, strict=True)]
        seen, steps, hessian, energy = list[Evidence](), 0, np.eye(x.dof), 0.0
        for level in range(coarsest, -1, -1):
            seen = self._evidence(x, level, motions)
            if free and level == coarsest and model.rule.carry > 0:
                x = min((x, with_state(x, before)), key=partial(misfit, seen))
            if free and level == min(1, coarsest) and model.config.search_deg > 0:
                x = self._searched(seen, x)
            for _ in range(model.rule.iterations):
                seen = [e.expected(x, model) for e in seen]
                found = minimise(BlockProblem([*seen, *priors]), x, steps=1, gain=_GAIN)
                assert isinstance(found.system, Dense)
                x, steps, hessian, energy = found.x, steps + found.steps, found.system.hessian, found.energy
                if found.status != "max_iterations":
                    break
        return self._learned(x, seen, state_at(x).minus(before)), self._found(x, seen, energy, hessian, steps)

    def _found(self, x: Variables, seen: Sequence[Evidence], energy: float, hessian: Float, steps: int) -> Found:
        V, D, known = len(self.pictures), len(self.track.velocity), inverse(hessian)
        covariance = np.full((D, D), np.nan) if known is None else known[:D, :D]
        support, exposure = np.zeros(V), np.array([x[exposure_block(v)].values for v in range(V)])
        for e in seen:
            support[e.number] = e.support.mean() if len(e.support) else 0.0
        return Found(state_at(x), support, energy, covariance, exposure, steps)

    def _carried(self) -> State:
        """Where the last motion leads, that of the joints as far as it carries."""
        carry, state = self.model.rule.carry, self.track.state
        motion = self.track.velocity * (carry > 0)
        motion[ROOT * len(state.views) :] *= carry
        return state.retract(motion)

    def _behind(self, memory: Memory | None, picture: Picture | None) -> Float:
        config = self.model.config
        if config.behind == "still" or picture is None or memory is None:
            return STILL
        before, after = (p.level(0, config.colour)[0] for p in (memory.picture, picture))
        return dominant_motion(before, after, memory.mask)

    def _evidence(self, x: Variables, level: int, motions: Sequence[Float]) -> list[Evidence]:
        """Of the views that have an image and remember one."""
        out, state = list[Evidence](), state_at(x)
        for v, (memory, picture) in enumerate(zip(self.track.memories, self.pictures, strict=True)):
            if memory is not None and picture is not None:
                visible, _ = render(posed_at(x, self.model.body), state.views[v]).visible(memory.points, 0.03)
                lit = memory.lit(self._light(v, memory, x))
                out.append(evidence(v, self.model, lit, level, picture, visible, motions[v]))
        return out

    def _in_camera(self, v: int, x: Variables) -> Float:
        """(S, 4, 4) the motions of the parts from their rest pose into the frame of a camera."""
        return (
            se3.transform(state_at(x).views[v].rotation, np.zeros(3)) @ posed_at(x, self.model.body).segment_transforms
        )

    def _light(self, v: int, memory: Memory, x: Variables) -> Float:
        """(N,) the light on what is remembered."""
        return self.track.lights[v].on(memory.normal, memory.points.part, self._in_camera(v, x))

    def _searched(self, seen: Sequence[Evidence], x: Variables) -> Variables:
        """With limbs where a coarse search puts them."""

        def cost(state: State, segments: Bool) -> float:
            return misfit([e.of(segments) for e in seen], with_state(x, state))

        reach, spread = np.deg2rad(self.model.config.search_deg), np.deg2rad(self.model.config.stray_deg)
        return with_state(x, searched(self.model.body, state_at(x), cost, reach, spread))

    def _learned(self, x: Variables, seen: Sequence[Evidence], velocity: Float) -> Track:
        """The track with what the frame shows: the points' brightness, and the light."""
        model, posed, memories = self.model, posed_at(x, self.model.body), list(self.track.memories)
        lights = list(self.track.lights)
        for e in seen:
            old = memories[e.number]
            assert old is not None
            trust = old.trust.copy()
            trust[e.which] = 0.5 * (trust[e.which] + e.support)
            memories[e.number] = replace(old, trust=trust) if model.rule.update < 1.0 else None
        for v, picture in enumerate(self.pictures):
            if picture is not None:
                old = memories[v]
                lit = None if old is None else old.lit(self._light(v, old, x))
                levels = picture.levels(model.rule.levels, model.config.colour)
                look = Look(picture, levels, render(posed, x[view_block(v)]), posed, x[exposure_block(v)].values)
                shown, transforms = remember(look, lit, model.retention), self._in_camera(v, x)
                normal, part = shown.normal, shown.points.part
                lights[v] = lights[v].learnt([(normal, part, shown.value[:, 0, 0])], transforms, 1)
                memories[v] = shown.lit(1.0 / lights[v].on(normal, part, transforms))
        return Track(state_at(x), velocity, tuple(memories), tuple(lights))


def misfit(seen: Sequence[Evidence], x: Variables) -> float:
    """Mean robust cost of all views."""
    return sum(e.misfit(x) for e in seen)


def _check(body: Body, state: State, images: Sequence[AnyArray | None]) -> None:
    if len(images) != len(state.views):
        raise InputError(f"differential: {len(images)} images for {len(state.views)} views; give one for each view.")
    if len(state.q) != (J := len(body.coordinate_names)):
        raise InputError(f"differential: {len(state.q)} angles for {J} coordinates of the body.")
    for image in images:
        if image is not None and image.dtype != np.uint8 and not np.all(np.isfinite(image)):
            raise InputError("differential: an image holds a value that is not finite; repair or leave out the frame.")
    check("differential", np.all(np.isfinite(state.q)), "an angle of the first state is not finite")


def track(model: DifferentialModel, state: State, frames: Sequence[Sequence[AnyArray]]) -> list[Found]:
    """Follow a body through frames of one image per view; `state` is that of the first, whose answer is left out."""
    out, so_far = list[Found](), Track.of(state)
    for images in frames:
        so_far, found = followed(so_far, images, model)
        out.append(found)
    return out[1:]
