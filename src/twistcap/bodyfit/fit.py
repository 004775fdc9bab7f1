"""Fitting a body to recordings: track with the body there is, then solve for poses and shape together, and again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from twistcap._typing import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.bodyfit import fields as f
from twistcap.bodyfit.build import Build, Stretches
from twistcap.bodyfit.observe import Contours, Observed, observe, observe_masks
from twistcap.bodyfit.solve import Shape, reshaped, step
from twistcap.bodyfit.symmetry import symmetric
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.track import Tracker
from twistcap.track.settings import TrackerConfig

Tell = Callable[[str], None]


@dataclass(frozen=True)
class FitRule:
    """How a body is fitted. Factors are natural logarithms, lengths m.

    Attributes:
        mirrored: whether the fit begins with the mean of the body and its mirror image.
        rounds: how often the recording is tracked anew with the body so far.
        steps: Gauss-Newton steps in each round.
        frames: of each recording that the shape is fitted to, at most, evenly spread over those that are tracked.
        stature, length, girth: standard deviations of the log-factors of the whole body and of each kind of segment.
        section, knots: standard deviation of the factors of cross-sections, and how many there are along a segment.
        joint, joint_side: standard deviations of shifts of the joint centres, of both sides alike and of each alone.
        offset, reach: standard deviation of the offsets of the surface along its normals, and over what distance on
            the body they are alike.
        turn_deg: how far the surface of a segment may turn against its joint's axes, which no image tells.
        offset_bound: no vertex moves farther along its normal than this.
        pose_deg, pose_m: how far a pose may stray from the tracked one.
        robust: distance at which a contour point begins to lose its say.
        worth: all frames together count as so many frames of independent contour points: neighbours and frames of
            one person before one background err alike.
    """

    mirrored: bool = True
    rounds: int = 3
    steps: int = 4
    frames: int = 20
    stature: float = 0.02
    length: float = 0.01
    girth: float = 0.12
    section: float = 0.06
    knots: int = 5
    joint: float = 0.002
    joint_side: float = 0.001
    offset: float = 0.006
    reach: float = 0.10
    turn_deg: float = 0.1
    offset_bound: float = 0.03
    pose_deg: float = 3.0
    pose_m: float = 0.02
    robust: float = 0.012
    worth: float = 0.3
    contours: Contours = field(default_factory=Contours)


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
    config: TrackerConfig = field(default_factory=TrackerConfig)
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
    state = _State(body, tuple(take.first_pose for take in takes), (), {}, ())
    first = moments = _tracked(state, takes, rule, tell)
    for n in range(rule.rounds):
        moments = moments if n == 0 else _tracked(state, takes, rule, tell)
        state, moments = _shaped(state, body, build, takes, moments, rule, n > 0, tell)
    told = build.told({name: amount for name, amount in state.amounts.items() if not name.startswith("joint ")})
    poses, begun = (tuple({m.frame.index: m.pose for m in of} for of in _by_take(some, len(takes)))
                    for some in (moments, first))  # fmt: skip
    frames = tuple({m.frame.index: m.frame for m in of} for of in _by_take([*first, *moments], len(takes)))
    return Fitted(state.body, state.first_poses, poses, frames, body, begun, told, state.errors)


@dataclass(frozen=True)
class _State:
    """Body and first poses so far, the amounts by name, and errors. `offsets` (V,) are empty until there are any."""

    body: Body
    first_poses: tuple[Pose, ...]
    offsets: tuple[float, ...]
    amounts: dict[str, float]
    errors: tuple[float, ...]


@dataclass(frozen=True)
class _Moment:
    """A frame, and where the body is in it; `tracked` is where the tracker had it, `first` says if it is its take's."""

    take: int
    frame: Frame
    pose: Pose
    tracked: Pose
    first: bool


def _by_take(moments: Sequence[_Moment], takes: int) -> list[list[_Moment]]:
    return [[m for m in moments if m.take == t] for t in range(takes)]


def _tracked(state: _State, takes: Sequence[Take], rule: FitRule, tell: Tell) -> list[_Moment]:
    """Track every take with the body so far, and choose the frames for the shape."""
    out: list[_Moment] = []
    for t, take in enumerate(takes):
        total = len(take.frames)
        chosen = set(np.linspace(0, total - 1, min(rule.frames, total)).astype(int).tolist())
        tracker = Tracker(state.body, take.rig, take.config)
        tracker.start(state.first_poses[t])
        lost = 0
        for k, frame in enumerate(take.frames):
            found = tracker.step(frame)
            lost += found.lost
            if (k in chosen or frame.index in take.masks) and not found.lost and found.status != "no_images":
                out.append(_Moment(t, frame, found.pose, found.pose, k == 0))
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
    out: list[list[Observed]] = []
    for moment, at in zip(moments, posed, strict=True):
        take = takes[moment.take]
        masks = take.masks.get(moment.frame.index)
        if masks is None:
            out.append(observe(moment.frame.images, take.rig, at, rule.contours))
        else:
            out.append(observe_masks(masks, take.rig, at, rule.contours))
    if not any(len(view.distance) for views in out for view in views):
        raise InputError("body fit: nothing of the body is seen in any view; check the first pose.")
    return out


def _shaped(
    state: _State, given: Body, build: Build, takes: Sequence[Take], moments: list[_Moment], rule: FitRule,
    offsets: bool, tell: Tell,
) -> tuple[_State, list[_Moment]]:  # fmt: skip
    """Gauss-Newton steps on the poses of the chosen frames and the shape."""
    for _ in range(rule.steps):
        own = build.fields(state.body, state.amounts)
        shape = _shape(state.body, given, own, build.rigid, rule, offsets)
        names, K, M = shape.fields.names, len(own.names), len(shape.fields.names)
        amounts = np.array([state.amounts.get(name, 0.0) for name in names])
        if offsets:
            amounts = np.concatenate([amounts, state.offsets or np.zeros(len(given.vertices))])
        posed = [Posed(state.body, m.pose) for m in moments]
        seen = _observed(moments, posed, takes, rule)
        found = step(
            posed, shape, amounts, seen, [_pull(m, rule) for m in moments], rule.robust, rule.worth / len(moments)
        )
        change = found.shape.copy()
        if offsets:
            bounded = np.clip(amounts[M:] + change[M:], -rule.offset_bound, rule.offset_bound)
            change[M:] = bounded - amounts[M:]
        change[:K], built = build.moved(own, amounts[:K], change[:K])
        moved = reshaped(shape, np.concatenate([np.zeros(K), change[K:]]))
        body = f.deformed(state.body, *(a + b for a, b in zip(built, moved, strict=True)))
        total = amounts + change
        state = replace(
            state, body=body, amounts=dict(zip(names, total[:M].tolist(), strict=True)),
            offsets=tuple(total[M:].tolist()), errors=(*state.errors, found.error_px),
        )  # fmt: skip
        poses = [m.pose.retract(d).within(given.limits) for m, d in zip(moments, found.poses, strict=True)]
        moments = [replace(m, pose=p) for m, p in zip(moments, poses, strict=True)]
        tell(f"{found.error_px:.2f} px to the edges")
    return replace(state, first_poses=_first_poses(state, moments)), moments


def _first_poses(state: _State, moments: Sequence[_Moment]) -> tuple[Pose, ...]:
    """The first frames' poses as they are now; where the first frame does not count, the pose that it had."""
    found = {m.take: m.pose for m in moments if m.first}
    return tuple(found.get(t, pose) for t, pose in enumerate(state.first_poses))


def _shape(body: Body, given: Body, own: f.Fields, rigid: bool, rule: FitRule, offsets: bool) -> Shape:
    """The build's own fields, shifts of the joint centres, and offsets if asked for."""
    fields = own + f.joint_fields(body, rule.joint, rule.joint_side)
    M, V = len(fields.names), len(body.vertices) if offsets else 0
    directions = f.offset_directions(body)[:V]
    precision = np.zeros((M + V, M + V))
    precision[:M, :M] = fields.precision
    rotation = f.turns(given)
    turned = np.tensordot(rotation, fields.vertices, ([1, 2], [1, 2]))
    turned[:, : len(own.names)] *= rigid
    if offsets:
        precision[M:, M:] = f.offset_precision(given, rule.offset, rule.reach)
        turned = np.hstack([turned, np.einsum("tvi,vi->tv", rotation, directions)])
    return Shape(fields, directions, precision + turned.T @ turned / np.deg2rad(rule.turn_deg) ** 2)


def _pull(moment: _Moment, rule: FitRule) -> tuple[Float, Float]:
    """Gradient and precision of the pose about the tracked one."""
    sigma = np.full(len(moment.pose.q) + 6, np.deg2rad(rule.pose_deg))
    sigma[3:6] = rule.pose_m
    precision = sigma**-2.0
    return precision * moment.pose.minus(moment.tracked), np.diag(precision)
