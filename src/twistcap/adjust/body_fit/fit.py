"""Fitting a body to recordings: track with the body there is, then solve for poses and shape together, and again."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from twistcap._typing import Bool
from twistcap.adjust.body_fit.build import Build, Stretches
from twistcap.adjust.body_fit.observe import Observed, observe, observe_masks
from twistcap.adjust.body_fit.problem import FitProblem, Freedom, Sculpted
from twistcap.adjust.body_fit.settings import FitRule
from twistcap.adjust.body_fit.symmetry import symmetric
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.settings import Settings
from twistcap.solve import minimise
from twistcap.track import Tracker
from twistcap.track import build as build_model

Tell = Callable[[str], None]


class Frames(Protocol):
    """Frames that can be read from the start as often as one likes."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Frame]: ...


@dataclass(frozen=True)
class Take:
    """One recording that the fit looks at.

    Attributes:
        rig: cameras of the images.
        name: for messages.
        frames: in order; they are read anew in every round.
        first_pose: of the first frame.
        config: of the tracker.
        masks: silhouettes (H, W) of some frames by number, one per camera or None, in the images' pixels; those frames
            are fitted to them, all others to the images.
    """

    rig: Rig
    frames: Frames
    first_pose: Pose
    config: Settings = field(default_factory=Settings)
    name: str = "the recording"
    masks: Mapping[int, Sequence[Bool | None]] = field(default_factory=dict[int, Sequence[Bool | None]])


@dataclass(frozen=True)
class Fitted:
    """What a fit gives.

    Attributes:
        body: the fitted one.
        first_poses: of each take, for its first frame.
        poses: of each take, frame number to pose, of the frames that the shape was fitted to.
        frames: of each take, by number, those that have a pose before or after.
        begun: the body from which the fit began.
        begun_poses: as it was tracked in those frames.
        factors: what the build tells: stature, lengths and girths against the body given, or a model's parameters.
        errors_px: root mean square distance to the edges found, before every step.
    """

    body: Body
    first_poses: tuple[Pose, ...]
    poses: tuple[dict[int, Pose], ...]
    frames: tuple[dict[int, Frame], ...]
    begun: Body
    begun_poses: tuple[dict[int, Pose], ...]
    factors: dict[str, float]
    errors_px: tuple[float, ...]


def fit_body(
    body: Body,
    takes: Sequence[Take],
    rule: FitRule | None = None,
    tell: Tell = lambda note: None,
    build: Build | None = None,
) -> Fitted:
    """The body that the contours in all views and frames of all takes ask for.

    Args:
        body: to begin with; its tree and binding stay.
        tell: is given a few words after each piece of work.
        build: what the body may become; by default its lengths, girths and cross-sections change.

    Raises:
        InputError: where there is no frame, or nothing of the body is seen.
    """
    rule = rule or FitRule()
    if not takes or any(not len(take.frames) for take in takes):
        raise InputError("body fit: there is no frame to fit the body to; give at least one recording with frames.")
    body = symmetric(body) if rule.mirrored else body
    build = build or Stretches(rule.stature, rule.length, rule.girth, rule.section, rule.knots)
    first_poses = tuple(take.first_pose for take in takes)
    first = moments = _tracked(body, first_poses, takes, rule, tell)
    x, errors = Sculpted(Freedom(body, build, rule, False), body, (), {}, np.zeros(0)), list[float]()
    for n in range(rule.rounds):
        moments = moments if n == 0 else _tracked(x.body, first_poses, takes, rule, tell)
        if n == 1:  # from here on every vertex is free
            x = replace(x, freedom=replace(x.freedom, offsets=True), offsets=np.zeros(len(body.vertices)))
        x = replace(x, poses=tuple(m.pose for m in moments))
        for _ in range(rule.steps):
            x, error = _shaped(x, takes, moments)
            errors.append(error)
            tell(f"{error:.2f} px to the edges")
        moments = [replace(m, pose=pose) for m, pose in zip(moments, x.poses, strict=True)]
        first_poses = _first_poses(first_poses, moments)
    told = build.told({name: amount for name, amount in x.amounts.items() if not name.startswith("joint ")})
    poses, begun = (tuple({m.frame.index: m.pose for m in of} for of in _by_take(some, len(takes)))
                    for some in (moments, first))  # fmt: skip
    frames = tuple({m.frame.index: m.frame for m in of} for of in _by_take([*first, *moments], len(takes)))
    return Fitted(x.body, first_poses, poses, frames, body, begun, told, tuple(errors))


@dataclass(frozen=True)
class _Moment:
    """A frame, and where the body is in it; `first` says if it is its take's."""

    take: int
    frame: Frame
    pose: Pose
    first: bool


def _by_take(moments: Sequence[_Moment], takes: int) -> list[list[_Moment]]:
    return [[m for m in moments if m.take == t] for t in range(takes)]


def _tracked(
    body: Body, first_poses: Sequence[Pose], takes: Sequence[Take], rule: FitRule, tell: Tell
) -> list[_Moment]:
    """Track every take with the body so far, and choose the frames for the shape."""
    out: list[_Moment] = []
    for t, take in enumerate(takes):
        total = len(take.frames)
        chosen = set(np.linspace(0, total - 1, min(rule.frames, total)).astype(int).tolist())
        tracker = Tracker(build_model(body, take.rig, take.config))
        tracker.start(first_poses[t])
        lost = 0
        for k, frame in enumerate(take.frames):
            found = tracker.step(frame)
            lost += found.lost
            if (k in chosen or frame.index in take.masks) and not found.lost and found.status != "no_images":
                out.append(_Moment(t, frame, found.pose, k == 0))
            tell(f"{take.name}, frame {frame.index}")
        if 2 * lost > total or all(m.take != t for m in out):
            raise InputError(
                f"body fit: {take.name} is lost in {lost} of {total} frames, and a body cannot be fitted to it;"
                " check its first pose and its cameras."
            )
    return out


def _observed(
    moments: Sequence[_Moment], posed: Sequence[Posed], takes: Sequence[Take], rule: FitRule
) -> list[list[Observed]]:
    """What each chosen frame shows: given silhouettes where there are some, else the edges in the images."""

    def one(moment: _Moment, at: Posed) -> list[Observed]:
        take = takes[moment.take]
        masks = take.masks.get(moment.frame.index)
        if masks is None:
            return observe(moment.frame.images, take.rig, at, rule.contours)
        return observe_masks(masks, take.rig, at, rule.contours)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        out = list(pool.map(one, moments, posed))
    if not any(len(view.distance) for views in out for view in views):
        raise InputError("body fit: nothing of the body is seen in any view; check the first pose.")
    return out


def _shaped(x: Sculpted, takes: Sequence[Take], moments: Sequence[_Moment]) -> tuple[Sculpted, float]:
    """A look at the chosen frames and a step of poses and shape; how far the edges were off before it, px."""
    rule = x.freedom.rule
    seen, tracked = _observed(moments, x.posed, takes, rule), [m.pose for m in moments]
    problem = FitProblem(seen, tracked, x.precision, rule)
    return minimise(problem, x, 1, 0.0).x, problem.error_px()


def _first_poses(before: Sequence[Pose], moments: Sequence[_Moment]) -> tuple[Pose, ...]:
    """The first frames' poses as they are now; where the first frame does not count, the pose that it had."""
    found = {m.take: m.pose for m in moments if m.first}
    return tuple(found.get(t, pose) for t, pose in enumerate(before))
