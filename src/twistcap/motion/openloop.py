"""Predictors from training motion: what they share.

A predictor is given the moments that were seen, and any later time: between the last of them and that time it runs
open-loop. What it predicted on the way is kept, so that a long gap costs no more than its frames.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from twistcap._typing import Float, Int
from twistcap.body import Body, Pose
from twistcap.errors import InputError
from twistcap.motion.bridging import bridged
from twistcap.motion.clip import interpolated_angles, interpolated_roots
from twistcap.motion.library import MotionLibrary, unwrapped
from twistcap.motion.matching import Match, Stretch
from twistcap.motion.spread import Spread, learnt
from twistcap.predict.history import Moment, covariance_about

_LONGEST = 10.0  # s of history that are looked at, at most


@dataclass(frozen=True)
class Expected:
    """What a predictor expects.

    Attributes:
        pose: the expected pose.
        covariance: (6 + J, 6 + J) of the step from it to the true pose; see CONVENTIONS.md.
        information: its inverse.
        match: where in the training motion it comes from; None where nothing matched.
    """

    pose: Pose
    covariance: Float
    information: Float
    match: Match | None


class MotionPredictor(Protocol):
    """Says where the body is at a time, from the moments before."""

    @property
    def memory_type(self) -> Any:
        """Type of the memory that `predict` gives."""
        ...

    def predict(self, history: Sequence[Moment], time: float, memory: Any = None) -> tuple[Expected, Any]:
        """The pose expected at `time`, s, and the memory with which a later time costs only its own frames.

        Args:
            history: at least one earlier moment that was seen, the latest last.
            time: s.
            memory: that of the prediction before; None for none.
        """
        ...


@dataclass(frozen=True)
class Stretched:
    """Poses of the library's coordinates, one frame apart: q (n, J) rad, roots (n, 4, 4); and where they come from."""

    q: Float
    roots: Float
    match: Match | None = None

    def __len__(self) -> int:
        return len(self.q)

    def then(self, more: Stretched) -> Stretched:
        """This one and what follows; the place is the later one's, the distance the larger.

        What follows a prediction matches where that was copied from, ever so well.
        """
        match = more.match
        if match is not None and self.match is not None:
            match = replace(match, distance=max(match.distance, self.match.distance))
        return Stretched(np.concatenate([self.q, more.q]), np.concatenate([self.roots, more.roots]), match)

    def since(self, start: int) -> Stretched:
        """From pose `start` on."""
        return Stretched(self.q[start:], self.roots[start:], self.match)

    def at(self, position: float) -> tuple[Float, Float]:
        """(J,) and (4, 4) between two poses."""
        where = np.array([position])
        return interpolated_angles(self.q, where)[0], interpolated_roots(self.roots, where)[0]


@dataclass(frozen=True)
class Run:
    """A prediction under way.

    Attributes:
        last: the last moment that was seen, from which it starts.
        turns: (J,) rad, whole turns between the library's angles and the body's.
        past: what was seen, one frame apart.
        ahead: the poses from the last seen one on.
    """

    last: Moment
    turns: Float
    past: Stretched
    ahead: Stretched


class OpenLoop(ABC):
    """A predictor that goes on frame by frame from the last poses.

    Args:
        library: training motion, at the frame rate of the recording.
        body: that is tracked; coordinates that the library lacks are held where they are.

    Raises:
        InputError: where body and library have no coordinate in common.
    """

    history: int  # frames that are looked at

    def __init__(self, library: MotionLibrary, body: Body) -> None:
        self.library, self.body = library, body
        shared = [name for name in library.names if name in body.coordinate_names]
        if not shared:
            raise InputError(
                f"motion library: it shares no coordinate with body {body.name!r}; it has {', '.join(library.names)}."
            )
        self._known = library.columns(shared)  # in the library, and
        self._theirs = np.array([body.coordinate(name) for name in shared], np.int32)  # in the body

    @property
    def memory_type(self) -> Any:
        """A prediction under way, or none."""
        return Run | None

    @abstractmethod
    def go_on(self, past: Stretched, count: int, barred: Sequence[Stretch] = ()) -> Stretched:
        """One to `count` poses that follow those of the past, which holds at least one.

        Args:
            past: poses of the library's coordinates, one frame apart.
            count: poses that are wanted; fewer may come, and never none.
            barred: stretches of the library that may not be matched.
        """

    def roll(self, past: Stretched, count: int, barred: Sequence[Stretch] = ()) -> Stretched:
        """`count` poses that follow those of the past, open-loop."""
        whole = past
        while len(whole) < len(past) + count:
            whole = whole.then(self.go_on(whole, len(past) + count - len(whole), barred))
        return whole.since(len(past))

    @cached_property
    def spread(self) -> Spread:
        """How far the truth strays from this predictor, learnt from the library itself at the first use."""
        return learnt(self.library, self.history, lambda q, roots, count, barred: self._trial(q, roots, count, barred))

    def _trial(self, q: Float, roots: Float, count: int, barred: Sequence[Stretch]) -> tuple[Float, Float, float]:
        found = self.roll(Stretched(q, roots), count, barred)
        return found.q, found.roots, self.unlikeness(found.match)

    def unlikeness(self, match: Match | None) -> float:
        """How badly poses match, in rad per pose; NaN where they match nothing that should be matched."""
        return 0.0

    def predict(self, history: Sequence[Moment], time: float, memory: Run | None = None) -> tuple[Expected, Run]:
        """The pose at `time`, with its covariance; see `MotionPredictor`.

        Moments that were not seen hold predictions: those after the last seen one say nothing, those before it fill
        the gap (`bridged`).

        Raises:
            InputError: for a history without a seen moment.
        """
        last = next((moment for moment in reversed(history) if moment.seen), None)
        if last is None:
            raise InputError("motion: a prediction needs at least one moment that was seen.")
        run = memory if memory is not None and memory.last.time == last.time else self._begun(last, bridged(history))
        frames, ahead = max(0.0, (time - last.time) * self.library.rate), run.ahead
        while len(ahead) - 1 < frames - 1e-6:
            whole = run.past.then(ahead.since(1))
            ahead = ahead.then(self.go_on(whole, max(1, int(np.ceil(frames)) - len(ahead) + 1)))
        run = replace(run, ahead=ahead)
        return self._expected(run, frames), run

    def _expected(self, run: Run, frames: float) -> Expected:
        known, root = run.ahead.at(min(frames, len(run.ahead) - 1.0))
        q = run.last.pose.q.copy()
        q[self._theirs] = (known - run.turns)[self._known]
        match = run.ahead.match
        turn, shift, joints = self.spread.variances(frames, float(np.nan_to_num(self.unlikeness(match))))
        variance = np.full(self.body.dof, self.spread.unknown(frames))
        variance[:3], variance[3:6], variance[6 + self._theirs] = turn, shift, joints[self._known]
        covariance, information = covariance_about(variance, root[:3, 3])
        return Expected(Pose(root, q), covariance, information, match)

    def _begun(self, last: Moment, history: Sequence[Moment]) -> Run:
        """The last moments, one frame apart; the library's coordinates that the body lacks are 0."""
        times = np.array([moment.time for moment in history])
        rate = self.library.rate
        begin = max(times[0], times[-1] - min(_LONGEST, (self.history - 1) / rate))
        wanted = times[-1] - np.arange(int((times[-1] - begin) * rate + 1e-3) + 1)[::-1] / rate
        positions = np.clip(np.interp(wanted, times, np.arange(len(times))), 0, len(times) - 1)
        # Time stamps are rounded: a pose almost at a moment is that moment's.
        positions = np.where(np.abs(positions - np.round(positions)) < 0.01, np.round(positions), positions)
        q = np.zeros((len(history), len(self.library.names)))
        q[:, self._known] = np.array([moment.pose.q for moment in history])[:, self._theirs]
        roots = np.array([moment.pose.root for moment in history])
        smooth = unwrapped(q)  # as the library's clips are
        past = Stretched(interpolated_angles(smooth, positions), interpolated_roots(roots, positions))
        return Run(last, smooth[-1] - q[-1], past, past.since(len(past) - 1))

    @property
    def compared(self) -> Int:
        """Columns of the library that are matched: those that the body has."""
        return self._known
