"""Frames that have passed are corrected by what is found out later; what is known of them in the end.

`back` tracks them again from what a search has found, and that frame once more after them; `between` from where a limb
was before and after it went astray. `returned` doubts a limb that more cameras show elsewhere in the frames that one
alone saw.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

from twistcap.body import Pose
from twistcap.cues import Cue
from twistcap.differential.model import DifferentialModel
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.hindsight.back import LookBack, looked_again, looked_back
from twistcap.hindsight.between import looked_between
from twistcap.hindsight.passed import Again, Passed
from twistcap.hindsight.returned import doubted
from twistcap.priors import Prior
from twistcap.stages import stage
from twistcap.track import Model, Tracker

__all__ = ["Again", "Hindsight", "LookBack", "Passed", "looked_back", "looked_between", "tracked"]

_RULE = LookBack()


class Hindsight:
    """A tracker that corrects its last estimates where it finds out later that they were wrong."""

    def __init__(self, tracker: Tracker, rule: LookBack = _RULE, passed: Iterable[Passed] = ()) -> None:
        """Go on with a tracker that has been started; `passed` are its last frames, where there were any."""
        self.tracker, self.rule, self._passed, self._bytes = tracker, rule, deque[Passed](), 0
        for one in passed:
            self._keep(one)

    def step(self, frame: Frame) -> tuple[list[Estimate], Estimate]:
        """Track one frame: the last estimates that are corrected by it, the oldest first, and its own."""
        tracker, before = self.tracker, self.tracker.state
        estimate = tracker.step(frame)
        if not isinstance(tracker.model, Model):
            return [], estimate
        with stage("look back"):
            tracker.state, corrected = looked_back(self.rule, tracker.model, before, tracker.state, self._passed)
            if corrected:
                tracker.state, estimate = looked_again(self.rule, tracker.model, before, tracker.state, frame, estimate)
            else:
                tracker.state, corrected = looked_between(tracker.model, tracker.state, self._passed, estimate)
            corrected = corrected or doubted(tracker.model, before, tracker.state, self._passed, estimate)
        for k, better in enumerate(reversed(corrected), 1):
            self._passed[-k] = replace(self._passed[-k], estimate=better)
        self._keep(Passed(frame, estimate))
        return corrected, estimate

    def through(self, frames: Iterable[Frame]) -> Iterator[Estimate]:
        """What is known of each frame in the end; it comes when nothing can correct it any more."""
        waiting = deque[Estimate]()
        for frame in frames:
            corrected, estimate = self.step(frame)
            for k in range(1, 1 + min(len(corrected), len(waiting))):  # not those that had passed before
                waiting[-k] = corrected[-k]
            waiting.append(estimate)
            while len(waiting) > len(self._passed):
                yield waiting.popleft()
        yield from waiting

    def _keep(self, one: Passed) -> None:
        self._passed.append(one)
        self._bytes += one.size
        while len(self._passed) > self.rule.frames or (self._bytes > 1e6 * self.rule.megabytes and self._passed):
            self._bytes -= self._passed.popleft().size


def tracked(
    frames: Iterable[Frame], model: Model | DifferentialModel, first_pose: Pose, *,
    cues: Sequence[Cue] = (), priors: Sequence[Prior] = (),
) -> Iterator[Estimate]:  # fmt: skip
    """Track a body through a recording, one estimate for each frame; with cues and priors beside the model's.

    An estimate comes when nothing can correct it any more, some frames late. `Tracker` gives them at once. Raises
    InputError for cues or priors beside a model that has none, the differential one.
    """
    if cues or priors:
        if isinstance(model, DifferentialModel):
            raise InputError("tracked: the differential tracker takes neither cues nor priors; leave them out.")
        model = replace(model, cues=(*model.cues, *cues), priors=(*model.priors, *priors))
    return _through(frames, Tracker(model), first_pose)


def _through(frames: Iterable[Frame], tracker: Tracker, first_pose: Pose) -> Iterator[Estimate]:
    rest = iter(frames)
    for first in rest:
        tracker.start(first_pose, first.time)
        yield from Hindsight(tracker).through(chain([first], rest))
