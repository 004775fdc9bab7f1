"""What is found late was lost before: frames that have passed are tracked again, backward in time.

A limb that follows something wrong often shows no sign of it. When a search finds it elsewhere, the frames before were
wrong as well. From there the body is tracked backward until both tracks meet. The pictures say how far back the second
track is right: by the evidence of `search.evidence`, under all that the recording has taught by then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, chain
from typing import Annotated

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Pose, Posed
from twistcap.body.limbs import limbs
from twistcap.cues import Cue
from twistcap.cues.view import despeckled
from twistcap.differential.model import DifferentialModel
from twistcap.errors import InputError
from twistcap.estimate import UNSEEN, Estimate, Frame
from twistcap.predict.history import REMEMBERED, Moment
from twistcap.priors import Prior
from twistcap.ranges import Checked, Count, Range, Share
from twistcap.search.lost import LostBody, LostMemory
from twistcap.stages import stage
from twistcap.track import Model, State, Tracker, step
from twistcap.track.align import FrameProblem

_JUST = 3  # frames in which a track that a search has put elsewhere settles there


@dataclass(frozen=True)
class LookBack(Checked):
    """How far back frames are tracked again, and when that is believed.

    Attributes:
        frames: at most, of those that have passed.
        megabytes: of pictures at most, that are kept for it.
        met: m between two places of what was found, within which the two tracks are one.
        gain, share: nats by which the pictures must favour the second track in all its frames together, and the least
            fraction of what is usual for what was found in one frame.
        loss: fraction of what it gained that it may lose again farther back, but always as much as it must gain. One
            that loses more went away from the first one, where that was right: what it began from was found wrongly.
        near: m between the two tracks where the second one is left, within which it may lose any amount farther back:
            they come together there, and beyond it the second one is lost itself.
    """

    frames: Annotated[int, Range(1, REMEMBERED - 1)] = 60
    megabytes: Count = 500
    met: float = 0.03
    gain: float = 20.0
    share: Share = 0.25
    loss: Share = 0.25
    near: float = 0.1

    def lost(self, way: Sequence[Again], needed: float) -> bool:
        """Whether a track, the latest frame first, lost too much again."""
        sums = _sums(way)
        return max(sums) - sums[-1] > max(needed, self.loss * max(sums))

    def doubtful(self, way: Sequence[Again], needed: float) -> bool:
        """Whether it did so though it had not come near the first one."""
        return self.lost(way, needed) and way[int(np.argmax(_sums(way)))].apart > self.near


@dataclass(frozen=True)
class Passed:
    """A frame that has been tracked, and what is said of it by now."""

    frame: Frame
    estimate: Estimate

    @property
    def seen(self) -> Frame:
        """The frame without pictures that told nothing, in a time that runs backward."""
        missing = self.estimate.missing
        images = tuple(None if i in missing else image for i, image in enumerate(self.frame.images))
        return replace(self.frame, time=-self.frame.time, images=images)

    @property
    def size(self) -> int:
        """Bytes of its pictures."""
        return sum(image.nbytes for image in self.frame.images if image is not None)


@dataclass(frozen=True)
class Again:
    """What a track says of a passed frame that runs backward.

    Attributes:
        estimate: what it says.
        gain: nats by which the pictures favour it.
        apart: m between the first track's place of what was found and its own.
    """

    estimate: Estimate
    gain: float
    apart: float


class Hindsight:
    """A tracker that corrects its last estimates where it finds out later that they were wrong."""

    def __init__(self, tracker: Tracker, rule: LookBack = LookBack(), passed: Iterable[Passed] = ()) -> None:
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

    An estimate comes when nothing can correct it any more, some frames late. `Tracker` gives them at once.

    Raises:
        InputError: for cues or priors beside a model that has none, the differential one.
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


def looked_back(
    rule: LookBack, model: Model, before: State, state: State, passed: Sequence[Passed]
) -> tuple[State, list[Estimate]]:
    """The state after a frame, and better estimates of the last frames before it, the oldest first.

    Args:
        rule: when they are better.
        model: of the track.
        before, state: before and after the frame.
        passed: frames before it, the latest last.
    """
    found = _put_elsewhere(model, before, state)
    if not found.any():
        return state, []
    known, groups = _memory(state).known, _memory(state).groups
    needed = max(rule.gain, rule.share * float(known.nats.sum(axis=0) @ groups[found].sum(axis=0)))
    ways = [
        (max(_sums(way)), way) for way in _tracked_again(rule, model, state, passed, found, needed)
        if way and not rule.doubtful(way, needed)
    ]  # fmt: skip
    most, best = max(ways, key=lambda way: way[0], default=(0.0, []))
    if most < needed:
        return state, []
    better = [again.estimate for again in best[: int(np.argmax(_sums(best))) + 1]]
    moments = list(state.past.moments)
    for k, estimate in enumerate(better, 2):
        moments[-k] = Moment(moments[-k].time, estimate.pose)
    return state.with_past(replace(state.past, moments=tuple(moments))), better[::-1]


def _put_elsewhere(model: Model, before: State, after: State) -> Bool:
    """(G,) which limbs, and whether the rest of the body, a search has put elsewhere in the last frame."""
    search = next((s for s in model.searches if isinstance(s, LostBody)), None)
    if search is None or not before.past.started:
        return np.zeros(1, np.bool_)
    return search.put_elsewhere(before.searches[search.name], after.searches[search.name])


def _memory(state: State) -> LostMemory:
    return next(memory for memory in state.searches.values() if isinstance(memory, LostMemory))


def _sums(way: Sequence[Again]) -> list[float]:
    """Nats of so many frames together."""
    return list(accumulate(again.gain for again in way))


def _tracked_again(
    rule: LookBack, model: Model, state: State, passed: Sequence[Passed], found: Bool, needed: float
) -> tuple[list[Again], list[Again]]:
    """The frames before, the latest first, in two ways: with the whole body of the track that runs backward, and with
    nothing of it but the limbs that were found, if only limbs were. They end where the tracks meet, or where both lose
    what they had gained. There is none where only a search leads back to the first track: both jump there, and nothing
    says which of them is right.
    """
    memory, ways = _memory(state), (list[Again](), list[Again]())
    own, moved = memory.groups[found].any(axis=0), _joints(model, found)
    since = _JUST
    for one, estimate, put in _backward(model, state, passed):
        since = 0 if (put[-1] if found[-1] else (put & found).any()) else since + 1
        first, second = one.estimate.pose, estimate.pose
        apart = float(_apart(model, first, second)[own].max())
        if apart < rule.met:
            return ways if since >= _JUST else ([], [])
        poses = [second] if found[-1] else [second, Pose(first.root, np.where(moved, second.q, first.q))]
        evidence = memory.known.evidence(_problem(model, state, one))
        usual = evidence.of(first)
        for way, pose in zip(ways, poses, strict=False):
            way.append(Again(replace(estimate, pose=pose, time=one.frame.time), evidence.of(pose) - usual, apart))
        if all(rule.lost(way, needed) for way in ways if way):
            break
    return ways


def _joints(model: Model, found: Bool) -> Bool:
    """(J,) coordinates of the limbs that were found (G,)."""
    own = [limb[6:] for limb, put in zip(limbs(model.body), found[:-1], strict=True) if put]
    return np.any(own, axis=0) if own else np.zeros(model.body.dof - 6, np.bool_)


def _problem(model: Model, state: State, one: Passed) -> FrameProblem:
    """A passed frame, as it is judged by what is known now."""
    none = np.zeros_like(state.covariance)
    out = frozenset(state.left_out)
    frame = despeckled(one.seen, model.despeckle)
    return FrameProblem(model, state, frame, one.estimate.pose, none, none, {}, left_out=out)


def _apart(model: Model, one: Pose, other: Pose) -> Float:
    """(S,) m between the middles of each segment at two poses."""
    return np.linalg.norm(Posed(model.body, one).segment_middles - Posed(model.body, other).segment_middles, axis=1)


def _backward(model: Model, state: State, passed: Sequence[Passed]) -> Iterator[tuple[Passed, Estimate, Bool]]:
    """The frames before, the latest first, with what a track says that runs backward from the present pose; and (G,)
    what its searches have put elsewhere.
    """
    model = replace(model, predictors=tuple(p for p in model.predictors if p.name != "motion"))
    state = _turned(model, state)
    for one in reversed(passed):
        before = state
        state, estimate = step(state, one.seen, model)
        if estimate.status in (*UNSEEN, "failed"):
            return
        yield one, estimate, _put_elsewhere(model, before, state)


def _turned(model: Model, state: State) -> State:
    """The state from which a track runs backward: what the recording has taught stays, the last velocity is turned."""
    *_, before, last = (state.past.moments[-1], *state.past.moments)[-2:]
    between = last.time - before.time
    step_on = last.pose.minus(before.pose) if between > 0.0 else np.zeros(model.body.dof)
    then = Moment(-last.time - between, last.pose.retract(step_on))
    past = replace(state.past, moments=(then, Moment(-last.time, last.pose)), seen_time=-last.time)
    cues = {c.name: c.start(model.body, model.rig) for c in model.cues} | {"contour": state.cues["contour"]}
    predictors = {p.name: p.start(model.body, model.rig) for p in model.predictors}
    searches = {name: m.begun_anew() if isinstance(m, LostMemory) else m for name, m in state.searches.items()}
    support = np.ones_like(state.support)  # as at the start of any track
    return replace(state, past=past, support=support, cues=cues, predictors=predictors, searches=searches, prints=())
