"""Refinement of a whole track: look, sum, solve for all frames and the body's shape, and look again.

What Bregler and Malik do to a tracked sequence (CVPR 1998, section 2.5, DOI 10.1109/CVPR.1998.698581), with contours,
perspective and joint centres beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from twistcap._typing import Bool, Float
from twistcap.adjust.first_pose import girth_groups
from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.refine.look import Eyes, Look
from twistcap.refine.motion import add_accelerations
from twistcap.refine.settings import RefineConfig
from twistcap.refine.shape import Shape
from twistcap.settings import TrackerConfig
from twistcap.solve import Marginals

_LEAST_FRAMES = 3
_MOST = 0.1  # of a log-length, or m of a joint centre, in one step: beyond it no linearisation holds


class Tell(Protocol):
    """Is told how far the work is."""

    def __call__(self, note: str, done: int = 0, total: int | None = None) -> None: ...


@dataclass(frozen=True)
class Refined:
    """A refined track.

    Attributes:
        body: with the refined lengths, girths and joint centres.
        estimates: one for each given; their covariances count what is not known of the shape.
        lengths, girths: factor of each group of segments against the body given.
        length_sigmas, girth_sigmas: standard deviations of the factors' logarithms.
        joint_shifts, joint_sigmas: (3,) m in the rest pose and standard deviations, by the segment below the joint.
        moved: m that the landmarks moved in each round, mean over all frames.
        shape: what a refinement of another track with this body goes on from.
    """

    body: Body
    estimates: tuple[Estimate, ...]
    lengths: Mapping[str, float]
    length_sigmas: Mapping[str, float]
    girths: Mapping[str, float]
    girth_sigmas: Mapping[str, float]
    joint_shifts: Mapping[str, Float]
    joint_sigmas: Mapping[str, Float]
    moved: tuple[float, ...]
    shape: Shape


def refine(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], config: RefineConfig | None = None,
    tracker: TrackerConfig | None = None, tell: Tell | None = None, shape: Shape | None = None,
) -> Refined:  # fmt: skip
    """Refine the poses of all frames, segment lengths, girths and joint centres together.

    A limb that the wrong body has lost is not found again by refining. Track once more with the refined body, and give
    those estimates here with the `shape` found: what is known of the shape beforehand stays that about the first body.

    Args:
        frames: those of the estimates, in order; they are gone through once in every round, and never kept.
        body, rig: that were tracked with; of the body, where a `shape` is given, its coordinates alone are looked at.
        estimates: of the track, one per frame.
        config: settings of the refinement.
        tracker: settings of the cues and of the claimed covariance.
        tell: is told how far it is.
        shape: to begin with, that of an earlier refinement; that of `body` by default.

    Raises:
        InputError: for fewer than three frames, frames that are not those of the estimates, poses that are not
            finite, or images that leave a number open.
    """
    config, tracker = config or RefineConfig(), tracker or TrackerConfig()
    _check(body, estimates)
    eyes = Eyes(rig.pinhole(), config, tracker, len(body.segment_names))
    shape, now = shape or Shape.of(body, girth_groups(body), config), tuple(estimates)
    moved: list[float] = []
    while True:
        look = _looked(eyes, frames, shape, now, len(moved), tell)
        step = look.system.step(config.damping)
        marginals = look.system.marginals(config.damping)
        assert step is not None  # the marginals would not be known
        poses, shared = look.system.unstacked(step)
        before, shape = shape, shape.stepped(np.clip(shared, -_MOST, _MOST))
        earlier, now = now, _stepped(now, poses, marginals, look, tracker)
        moved.append(_mean_move(before.body, earlier, shape.body, now))
        settled = not look.coarse and moved[-1] < config.settled
        if settled or len(moved) >= config.rounds:
            return _answer(shape, now, marginals, tracker, moved, settled)


def _check(body: Body, estimates: Sequence[Estimate]) -> None:
    if len(estimates) < _LEAST_FRAMES:
        raise InputError(f"refine: {len(estimates)} frames are given; it takes at least {_LEAST_FRAMES}.")
    for e in estimates:
        if len(e.pose.q) != len(body.coordinate_names):
            raise InputError(f"refine: frame {e.index} has {len(e.pose.q)} joint coordinates; give the body tracked.")
        if not (np.all(np.isfinite(e.pose.root)) and np.all(np.isfinite(e.pose.q))):
            raise InputError(f"refine: the pose of frame {e.index} is not finite; leave the frame out with --frames.")


def _looked(
    eyes: Eyes, frames: Iterable[Frame], shape: Shape, estimates: Sequence[Estimate], done: int, tell: Tell | None
) -> Look:
    """The equations of the round after `done` others: images, motion, and what is known of the shape beforehand."""
    config, rounds = eyes.config, eyes.config.rounds
    look = eyes.look(shape, [e.pose for e in estimates], coarse=done < config.coarse_rounds)
    bridged = _bridged(estimates, config.bridge) if done == 0 else np.zeros(len(estimates), dtype=np.bool_)
    count = 0
    for count, frame in enumerate(frames, 1):
        if count > len(estimates) or frame.index != estimates[count - 1].index:
            count = 0
            break
        look.add(frame, trusted=not bridged[count - 1])
        if tell is not None:
            tell(f"round {done + 1} of at most {rounds}", done * len(estimates) + count, rounds * len(estimates))
    if count != len(estimates):
        raise InputError("refine: the frames are not those of the estimates; give the frames that were tracked.")
    eyes.learn(look)
    add_accelerations(look.system, [e.pose for e in estimates], [e.time for e in estimates], config.noise)
    # Images are counted at their own noise, of which the claimed one is a multiple; so must the prior be.
    gradient, information = shape.prior(config.hinge)
    look.system.shared_pull += eyes.tracker.inflation**2 * gradient
    look.system.corner += eyes.tracker.inflation**2 * information
    return look


def _bridged(estimates: Sequence[Estimate], longest: float) -> Bool:
    """(F,) which frames are lost in spans shorter than so many seconds, with others at both ends."""
    out = np.zeros(len(estimates), dtype=np.bool_)
    kept = [t for t, e in enumerate(estimates) if not e.lost]
    for before, after in pairwise(kept):
        if estimates[after].time - estimates[before].time <= longest:
            out[before + 1 : after] = True
    return out


def _stepped(
    estimates: Sequence[Estimate], poses: Float, marginals: Marginals, look: Look, tracker: TrackerConfig
) -> tuple[Estimate, ...]:
    """The estimates after a step, which for a pose is no longer than half a radian in any joint."""
    shorter = np.maximum(1.0, 2.0 * np.abs(poses[:, 6:]).max(axis=1, initial=0.0))
    steps, covariances = poses / shorter[:, None], tracker.inflation**2 * marginals.poses
    moved = [
        replace(e, pose=e.pose.retract(steps[t]), covariance=covariances[t], energies=look.energies[t])
        for t, e in enumerate(estimates)
    ]
    if look.eyes.contour is None:
        return tuple(moved)  # without contours the tracker's own judgement stands
    least = tracker.support.least_share
    judged = zip(moved, look.support(), strict=True)
    return tuple(
        e if e.status == "no_images" else replace(e, support=float(s), lost=bool(s < least)) for e, s in judged
    )


def _mean_move(before: Body, earlier: Sequence[Estimate], after: Body, later: Sequence[Estimate]) -> float:
    """Mean distance (m) by which the landmarks, or where there are none the segments, moved."""
    places = [[Posed(body, e.pose) for e in es] for body, es in ((before, earlier), (after, later))]
    old, new = (np.stack([p.landmarks if len(p.landmarks) else p.segment_middles for p in ps]) for ps in places)
    return float(np.linalg.norm(new - old, axis=2).mean())


def _answer(
    shape: Shape, estimates: Sequence[Estimate], marginals: Marginals, tracker: TrackerConfig, moved: Sequence[float],
    settled: bool,
) -> Refined:  # fmt: skip
    lengths, girths, joints = shape.parts(shape.total)
    sigmas = shape.parts(tracker.inflation * np.sqrt(np.diagonal(marginals.shared)))
    status = "converged" if settled else "max_iterations"
    out = tuple(
        replace(e, iterations=len(moved), status=status if e.status != "no_images" else e.status) for e in estimates
    )
    girth, joint = (_exp(girths), sigmas[1]), (joints, sigmas[2])
    return Refined(shape.body, out, _exp(lengths), sigmas[0], *girth, *joint, tuple(moved), shape)


def _exp(logs: Mapping[str, float]) -> dict[str, float]:
    return {name: float(np.exp(value)) for name, value in logs.items()}
