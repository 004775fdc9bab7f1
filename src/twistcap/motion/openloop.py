"""The protocol and the base class of predictors from training motion.

A predictor gets the moments with images, and any later time: between the last of them and that time it runs open-loop.
It keeps the poses predicted so far, so that a long gap costs no more than its frames.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose
from twistcap.errors import InputError
from twistcap.motion.clip import interpolated_angles, interpolated_roots
from twistcap.motion.library import MotionLibrary, unwrapped
from twistcap.motion.matching import Interval, Match, PoseSequence
from twistcap.motion.spread import Spread, learned_spread
from twistcap.predict.history import Moment, constant_velocity, covariance_about

_LONGEST = 10.0  # s of history that are used, at most


@dataclass(frozen=True)
class Expected:
    """An expected pose, and its source in the training motion, None where nothing matched. `covariance` (6 + J, 6 + J)
    is that of the step to the true pose (CONVENTIONS.md), `information` its inverse."""

    pose: Pose
    covariance: Float
    information: Float
    match: Match | None


class MotionPredictor(Protocol):
    """Predicts the pose at a time from the moments before; `memory_type` is the type of the memory that it gives."""

    @property
    def memory_type(self) -> Any: ...

    def predict(self, history: Sequence[Moment], time: float, memory: Any = None) -> tuple[Expected, Any]:
        """The pose expected at `time`, s, and the memory for the next prediction, which is None before the first. The
        history holds at least one earlier moment with images, the latest last."""
        ...


@dataclass(frozen=True)
class Rollout:
    """An open-loop prediction, to be extended: poses with images (`past`), and those predicted from the last one on.

    `last` is the last moment with images; `turns` (J,) rad are whole turns between the library's angles and the body's.
    """

    last: Moment
    turns: Float
    past: PoseSequence
    ahead: PoseSequence


class OpenLoop(ABC):
    """A predictor that extends the last poses frame by frame.

    The library is at the frame rate of the recording; coordinates of the body that it lacks keep their values. Raises
    InputError where body and library have no coordinate in common.
    """

    history: int  # frames that are used

    def __init__(self, library: MotionLibrary, body: Body) -> None:
        self.library, self.body = library, body
        common = [name for name in library.names if name in body.coordinate_names]
        if not common:
            names = ", ".join(library.names)
            raise InputError(f"motion library: body {body.name!r} has none of its coordinates {names}.")
        self.compared = library.columns(common)
        """(K,) columns of the library that are matched: those that the body has."""
        self._theirs = np.array([body.coordinate(name) for name in common], np.int32)  # the same in the body

    @property
    def memory_type(self) -> Any:
        """A prediction to be extended, or none."""
        return Rollout | None

    @abstractmethod
    def next_poses(self, past: PoseSequence, count: int, excluded: Sequence[Interval] = ()) -> PoseSequence:
        """One to `count` poses that follow those of the past, which holds at least one. They are poses of the library's
        coordinates, one frame apart; the excluded intervals may not be matched."""

    def roll(self, past: PoseSequence, count: int, excluded: Sequence[Interval] = ()) -> PoseSequence:
        """`count` poses that follow those of the past, open-loop."""
        whole = past
        while len(whole) < len(past) + count:
            whole = whole.then(self.next_poses(whole, len(past) + count - len(whole), excluded))
        return whole.since(len(past))

    @cached_property
    def spread(self) -> Spread:
        """The predictor's standard deviations, learned from the library at the first use."""
        return learned_spread(self)

    def dissimilarity(self, match: Match | None) -> float:
        """Mean distance of the matched poses, rad per pose; NaN where a match is needed and there is none."""
        return 0.0

    def predict(
        self, history: Sequence[Moment], time: float, memory: Rollout | None = None
    ) -> tuple[Expected, Rollout]:
        """The pose at `time`, with its covariance; see `MotionPredictor`.

        Moments without images hold predictions: those after the last image are ignored, earlier ones fill gaps
        (`bridged`). A history without images is an InputError.
        """
        last = next((moment for moment in reversed(history) if moment.seen), None)
        if last is None:
            raise InputError("motion: a prediction needs at least one moment with images.")
        run = memory if memory is not None and memory.last.time == last.time else self._begun(last, bridged(history))
        frames, ahead = max(0.0, (time - last.time) * self.library.rate), run.ahead
        while len(ahead) - 1 < frames - 1e-6:
            whole = run.past.then(ahead.since(1))
            ahead = ahead.then(self.next_poses(whole, max(1, int(np.ceil(frames)) - len(ahead) + 1)))
        run = replace(run, ahead=ahead)
        return self._expected(run, frames), run

    def _expected(self, run: Rollout, frames: float) -> Expected:
        known, root = run.ahead.at(min(frames, len(run.ahead) - 1.0))
        q = run.last.pose.q.copy()
        q[self._theirs] = (known - run.turns)[self.compared]
        match = run.ahead.match
        turn, shift, joints = self.spread.variances(frames, float(np.nan_to_num(self.dissimilarity(match))))
        variance = np.full(self.body.dof, self.spread.unknown(frames))
        variance[:3], variance[3:6], variance[6 + self._theirs] = turn, shift, joints[self.compared]
        covariance, information = covariance_about(variance, root[:3, 3])
        return Expected(Pose(root, q), covariance, information, match)

    def _begun(self, last: Moment, history: Sequence[Moment]) -> Rollout:
        """A prediction without poses ahead; the library's coordinates that the body lacks are 0."""
        times = np.array([moment.time for moment in history])
        rate = self.library.rate
        begin = max(times[0], times[-1] - min(_LONGEST, (self.history - 1) / rate))
        wanted = times[-1] - np.arange(int((times[-1] - begin) * rate + 1e-3) + 1)[::-1] / rate
        positions = np.clip(np.interp(wanted, times, np.arange(len(times))), 0, len(times) - 1)
        # Time stamps are rounded: positions near a moment are moved to it.
        positions = np.where(np.abs(positions - np.round(positions)) < 0.01, np.round(positions), positions)
        q = np.zeros((len(history), len(self.library.names)))
        q[:, self.compared] = np.array([moment.pose.q for moment in history])[:, self._theirs]
        roots = np.array([moment.pose.root for moment in history])
        smooth = unwrapped(q)  # as the library's clips are
        past = PoseSequence(interpolated_angles(smooth, positions), interpolated_roots(roots, positions))
        return Rollout(last, smooth[-1] - q[-1], past, past.since(len(past) - 1))


def bridged(history: Sequence[Moment]) -> list[Moment]:
    """The moments from the first to the last with images, with corrected predictions between them.

    A straight line across a gap of half a cycle matches nothing in a library. A prediction has the right form but has
    drifted: its error at the end of the gap is spread over the gap, linear in time.
    """
    seen = np.flatnonzero([moment.seen for moment in history])
    out = list(history[seen[0] : seen[-1] + 1])
    for a, b in zip(seen[:-1] - seen[0], seen[1:] - seen[0], strict=True):
        if b - a > 1:
            out[a + 1 : b] = _corrected(out[a : b + 1])
    return out


def _corrected(moments: Sequence[Moment]) -> list[Moment]:
    """The predicted moments between a first and a last one with images."""
    first, *predicted, last = moments
    end = constant_velocity(moments[:-1], last.time)  # of the prediction
    turn = se3.log(se3.inverse(end.root) @ last.pose.root)
    joints = np.remainder(last.pose.q - end.q + np.pi, 2.0 * np.pi) - np.pi
    fractions = [(m.time - first.time) / (last.time - first.time) for m in predicted]
    return [
        replace(m, pose=Pose(m.pose.root @ se3.exp(f * turn), m.pose.q + f * joints))
        for m, f in zip(predicted, fractions, strict=True)
    ]
