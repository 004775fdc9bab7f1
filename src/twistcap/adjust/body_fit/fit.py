"""Fitting a body to recordings: in each round track with the body so far, then solve for poses and shape together."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from twistcap.adjust.body_fit.fields import Build, Stretches
from twistcap.adjust.body_fit.observe import Observed, observe, observe_masks
from twistcap.adjust.body_fit.problem import FitProblem, Freedom, Sculpted
from twistcap.adjust.body_fit.symmetry import symmetric
from twistcap.arrays import Bool
from twistcap.body import Body, Pose, Posed
from twistcap.build import build as build_model
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.ranges import Checked, Count
from twistcap.settings import Settings
from twistcap.solve import minimise
from twistcap.track import Tracker

Report = Callable[[str], None]


class Frames(Protocol):
    """Frames that can be read from the start any number of times."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Frame]: ...


@dataclass(frozen=True)
class FitRule(Checked, where="body fit"):
    """How much work a fit takes.

    In each of the `rounds` the recording is tracked with the body so far; Gauss-Newton `steps` follow. Of each
    recording the shape is fitted to `frames` frames at most, evenly spread.
    """

    rounds: Count = 3
    steps: Count = 4
    frames: Count = 20


@dataclass(frozen=True)
class Take:
    """One recording of the fit: frames in order, read in every round, and the pose of the first.

    `config` is that of the tracker. Frames that have `masks` by number, (H, W) for each camera or None in the images'
    pixels, are fitted to these silhouettes, all others to the images.
    """

    rig: Rig
    frames: Frames
    first_pose: Pose
    config: Settings = field(default_factory=Settings)
    name: str = "the recording"
    masks: Mapping[int, Sequence[Bool | None]] = field(default_factory=dict[int, Sequence[Bool | None]])


@dataclass(frozen=True)
class Fitted:
    """A fitted body.

    Attributes:
        first_poses: of each take, for its first frame.
        poses: of each take, frame number to pose, of the frames that the shape was fitted to.
        frames: of each take, by number, those with a pose before or after.
        begun, begun_poses: the body at the start of the fit, as tracked in those frames.
        factors: stature, lengths and girths against the body given, or a model's parameters.
    """

    body: Body
    first_poses: tuple[Pose, ...]
    poses: tuple[dict[int, Pose], ...]
    frames: tuple[dict[int, Frame], ...]
    begun: Body
    begun_poses: tuple[dict[int, Pose], ...]
    factors: dict[str, float]


def fit_body(
    body: Body, takes: Sequence[Take], rule: FitRule | None = None, report: Report = lambda note: None,
    build: Build | None = None,
) -> Fitted:  # fmt: skip
    """Fit a body to the contours in all views and frames of all takes.

    The fit starts from the mean of the body and its mirror image; tree and binding stay. `report` is called after each
    piece of work, `build` are the body's free parameters, by default lengths, girths and cross-sections. Raises
    InputError where there is no frame, a take is lost, or nothing of the body is seen.
    """
    rule = rule or FitRule()
    if not takes or any(not len(take.frames) for take in takes):
        raise InputError("body fit: there is no frame to fit the body to; give at least one recording with frames.")
    body, build = symmetric(body), build or Stretches()
    first_poses = tuple(take.first_pose for take in takes)
    first = moments = _tracked(body, first_poses, takes, rule, report)
    x = Sculpted(Freedom(body, build, False), body, (), {}, np.zeros(0))
    for n in range(rule.rounds):
        moments = moments if n == 0 else _tracked(x.body, first_poses, takes, rule, report)
        if n == 1:  # from here on every vertex is free
            x = replace(x, freedom=replace(x.freedom, offsets=True), offsets=np.zeros(len(body.vertices)))
        x = replace(x, poses=tuple(m.pose for m in moments))
        for _ in range(rule.steps):
            x, error = _shaped(x, takes, moments)
            report(f"{error:.2f} px to the edges")
        moments = [replace(m, pose=pose) for m, pose in zip(moments, x.poses, strict=True)]
        known = {m.take: m.pose for m in moments if m.first}  # a first frame that was not chosen keeps its pose
        first_poses = tuple(known.get(t, pose) for t, pose in enumerate(first_poses))
    factors = build.summary({name: amount for name, amount in x.amounts.items() if not name.startswith("joint ")})
    poses, begun = (tuple({m.frame.index: m.pose for m in of} for of in _by_take(some, len(takes)))
                    for some in (moments, first))  # fmt: skip
    frames = tuple({m.frame.index: m.frame for m in of} for of in _by_take([*first, *moments], len(takes)))
    return Fitted(x.body, first_poses, poses, frames, body, begun, factors)


@dataclass(frozen=True)
class _Moment:
    """A frame and its pose; `first` says whether it is the first of its take."""

    take: int
    frame: Frame
    pose: Pose
    first: bool


def _by_take(moments: Sequence[_Moment], takes: int) -> list[list[_Moment]]:
    return [[m for m in moments if m.take == t] for t in range(takes)]


def _tracked(
    body: Body, first_poses: Sequence[Pose], takes: Sequence[Take], rule: FitRule, report: Report
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
            estimate = tracker.step(frame)
            lost += estimate.lost
            if (k in chosen or frame.index in take.masks) and estimate.seen and not estimate.lost:
                out.append(_Moment(t, frame.sorted_by(estimate.sources), estimate.pose, k == 0))
            report(f"{take.name}, frame {frame.index}")
        if 2 * lost > total or all(m.take != t for m in out):
            mend = "a body cannot be fitted to it; check its first pose and its cameras"
            raise InputError(f"body fit: {take.name} is lost in {lost} of {total} frames, and {mend}.")
    return out


def _observed(moments: Sequence[_Moment], posed: Sequence[Posed], takes: Sequence[Take]) -> list[list[Observed]]:
    """Contours of each chosen frame: against given silhouettes where there are any, else in the images."""

    def one(moment: _Moment, at: Posed) -> list[Observed]:
        take = takes[moment.take]
        masks, images = take.masks.get(moment.frame.index), moment.frame.images
        if masks is None:
            return observe(images, take.rig, at)
        return observe_masks([masks[s] for s in moment.frame.sources] or masks, take.rig, at)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        out = list(pool.map(one, moments, posed))
    if not any(len(view.distance) for views in out for view in views):
        raise InputError("body fit: nothing of the body is seen in any view; check the first pose.")
    return out


def _shaped(x: Sculpted, takes: Sequence[Take], moments: Sequence[_Moment]) -> tuple[Sculpted, float]:
    """The variables after a step of poses and shape, and the distance to the edges before it, px."""
    seen, tracked = _observed(moments, x.posed, takes), [m.pose for m in moments]
    problem = FitProblem(seen, tracked, x.precision)
    return minimise(problem, x, 1, 0.0).x, problem.error_px()
