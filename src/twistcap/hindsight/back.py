"""What is found late was lost before: frames that have passed are tracked again, backward in time.

A limb that follows something wrong often shows no sign of it. When a search finds it elsewhere, the frames before were
wrong as well. From there the body is tracked backward until both tracks meet. The pictures say how far back the second
track is right: by the evidence of `search.evidence`, under all that the recording has taught by then.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from twistcap.arrays import Bool
from twistcap.body.limbs import limbs
from twistcap.estimate import UNSEEN, Estimate, Frame
from twistcap.hindsight.passed import (
    Again,
    Passed,
    apart,
    begun,
    corrected,
    evidence_in,
    for_second_track,
    lost_memory,
    sums,
    with_cameras_of,
    with_limbs,
)
from twistcap.predict.history import REMEMBERED, Moment
from twistcap.ranges import Checked, Count, Range, Share
from twistcap.search.lost import LostBody
from twistcap.track import Model, State, step

_End = Literal["met", "beside", "led back"]  # of a second track; a search led it back to the first one
_JUST = 3  # frames in which a track that a search has put elsewhere settles there


@dataclass(frozen=True)
class LookBack(Checked):
    """How far back frames are tracked again, and when that is believed.

    Attributes:
        frames: at most, of those that have passed.
        megabytes: of pictures at most, that are kept for it.
        met: m between two places of what was found, within which the two tracks are one.
        gain: nats by which the pictures must favour the second track, in all its frames together, where it meets the
            first one by itself. Then that one alone jumps.
        share: the same where they do not meet, as a fraction of what is usual in one frame for what was found.
        plenty: and where a search leads the second track back to the first one. Then both jump; limbs that were found
            must gain it all the way without the rest of the body, too. Else it may be that of somebody else.
        loss: fraction of what it gained that it may lose again farther back, but always as much as it must gain. One
            that loses more went away from the first one, where that was right: what it began from was found wrongly.
    """

    frames: Annotated[int, Range(1, REMEMBERED - 1)] = 60
    megabytes: Count = 500
    met: float = 0.03
    gain: float = 20.0
    share: Share = 0.25
    plenty: Annotated[float, Range(0.0, 100.0)] = 1.0
    loss: Share = 0.25

    def lost(self, way: Sequence[Again], needed: float) -> bool:
        """Whether a track, the latest frame first, lost too much again."""
        nats = sums(way)
        return max(nats) - nats[-1] > max(needed, self.loss * max(nats))


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
    known, groups = lost_memory(state).known, lost_memory(state).groups
    usual = float(known.nats.sum(axis=0) @ groups[found].sum(axis=0))
    tolerated = max(rule.gain, rule.share * usual)
    ways, end = _tracked_again(rule, model, state, passed, found, tolerated)
    nats = [-np.inf if rule.lost(way, tolerated) else max(sums(way)) for way in ways if way]
    needed = max(rule.gain, {"met": 0.0, "beside": rule.share, "led back": rule.plenty}[end] * usual)
    alone = next((way for way in reversed(ways) if way), [])
    if max(nats, default=-np.inf) < needed or (end == "led back" and sums(alone)[-1] < needed):
        return state, []
    best = ways[int(np.argmax(nats))]
    better = [again.estimate for again in best[: int(np.argmax(sums(best))) + 1]]
    return corrected(state, better[::-1]), better[::-1]


def looked_again(
    rule: LookBack, model: Model, before: State, state: State, frame: Frame, estimate: Estimate
) -> tuple[State, Estimate]:  # fmt: skip
    """The frame in which something was found, tracked once more after the corrected ones before it, where the pictures
    favour that. A search puts a limb in its place, but may leave it turned about its long axis; backward, its joints
    came right. The states are those before the frame, and after it and the correction.
    """
    past = replace(before.past, moments=state.past.moments[:-1])
    again, second = step(begun(model, before, past), frame, model)
    if second.status in (*UNSEEN, "failed"):
        return state, estimate
    evidence = evidence_in(model, state, Passed(frame, estimate))
    better = evidence.of(second.pose) >= evidence.of(estimate.pose) + rule.gain
    return (again, second) if better else (state, estimate)


def _put_elsewhere(model: Model, before: State, after: State) -> Bool:
    """(G,) which limbs, and whether the rest of the body, a search has put elsewhere in the last frame."""
    search = next((s for s in model.searches if isinstance(s, LostBody)), None)
    if search is None or not before.past.started:
        return np.zeros(1, np.bool_)
    return search.put_elsewhere(before.searches[search.name], after.searches[search.name])


def _tracked_again(
    rule: LookBack, model: Model, state: State, passed: Sequence[Passed], found: Bool, tolerated: float
) -> tuple[tuple[list[Again], list[Again]], _End]:
    """The frames before, the latest first, in two ways: with the whole body of the track that runs backward, and with
    nothing of it but the limbs that were found, if only limbs were. They end where the tracks meet, or where both lose
    what they had gained, but for what is `tolerated`.
    """
    memory, ways = lost_memory(state), (list[Again](), list[Again]())
    own, moved = np.asarray(memory.groups[found].any(axis=0), np.bool_), _joints(model, found)
    since = _JUST
    for one, estimate, put in _backward(model, state, passed):
        since = 0 if (put[-1] if found[-1] else (put & found).any()) else since + 1
        first, second = one.estimate.pose, estimate.pose
        if apart(model, first, second)[own].max() < rule.met:
            return ways, "met" if since >= _JUST else "led back"
        estimate = replace(estimate, time=one.frame.time, relit=one.estimate.relit)
        each = [estimate] if found[-1] else [estimate, with_limbs(model, one.estimate, estimate, moved, own)]
        evidence = evidence_in(model, state, one)
        usual = evidence.of(first)
        for way, again in zip(ways, each, strict=False):
            way.append(Again(again, evidence.of(again.pose) - usual))
        if all(rule.lost(way, tolerated) for way in ways if way):
            break
    return ways, "beside"


def _joints(model: Model, found: Bool) -> Bool:
    """(J,) coordinates of the limbs that were found (G,)."""
    own = [limb[6:] for limb, put in zip(limbs(model.body), found[:-1], strict=True) if put]
    return np.any(own, axis=0) if own else np.zeros(model.body.dof - 6, np.bool_)


def _backward(model: Model, state: State, passed: Sequence[Passed]) -> Iterator[tuple[Passed, Estimate, Bool]]:
    """The frames before, the latest first, with what a track says that runs backward from the present pose; and (G,)
    what its searches have put elsewhere.
    """
    model = for_second_track(model)
    state = _turned(model, state)
    for one in reversed(passed):
        before = state
        there = with_cameras_of(state, one)
        state, estimate = step(there, replace(one.seen, time=-one.frame.time), model)
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
    return begun(model, state, past)
