"""A limb that goes astray for a few frames and comes back: it is looked for on the way between.

A fast arm is caught by an edge that looks like it, and is free again some frames later: no search has found it. Then
its way is known before and after. If the pictures between speak for the straight way rather than for where it was
tracked, it is tracked again from there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Bool
from twistcap.body import Pose
from twistcap.body.limbs import limbs
from twistcap.estimate import UNSEEN, Estimate
from twistcap.hindsight.passed import (
    Again,
    Passed,
    apart,
    begun,
    corrected,
    evidence_in,
    for_second_track,
    sums,
    with_cameras_of,
    with_coordinates,
    with_limbs,
)
from twistcap.predict.history import Moment
from twistcap.search.doubt import Doubt
from twistcap.search.evidence import Evidence
from twistcap.search.memory import LACKED, LostMemory
from twistcap.track import Model, State, step

_FRAMES = (1, 2, 3, 4, 6, 8, LACKED)  # that a limb may be astray; long stretches are looked at more seldom
_AWAY = 0.08  # m from the way between, in the middle
_GAIN, _SHARE = 20.0, 0.35  # nats by which pictures must favour it, and fraction of what is usual for the limb
_BLIND = (*UNSEEN, "failed")


@dataclass(frozen=True)
class Stretch:
    """Frames in which a limb may have been astray.

    Attributes:
        passed: the frames.
        limb: (J,) coordinates of the limb.
        expected: poses with the limb on its way between, one for each frame.
        parts: (S,) segments of the limb.
        needed: nats by which the pictures must favour them, and that they must show of the limb in each on average.
    """

    passed: Sequence[Passed]
    limb: Bool
    expected: Sequence[Pose]
    parts: Bool
    needed: float

    @property
    def middle(self) -> Stretch:
        """Its middle frame alone."""
        k = len(self.passed) // 2
        return replace(self, passed=self.passed[k : k + 1], expected=self.expected[k : k + 1])


@dataclass(frozen=True)
class _Pictures:
    """What the pictures of passed frames say, each asked once."""

    model: Model
    state: State
    asked: dict[int, tuple[Evidence, float]] = field(default_factory=dict[int, tuple[Evidence, float]])

    def favour(self, one: Passed, pose: Pose) -> float:
        """Nats by which they favour a pose to that which was tracked."""
        if one.frame.index not in self.asked:
            evidence = evidence_in(self.model, self.state, one)
            self.asked[one.frame.index] = evidence, evidence.of(one.estimate.pose)
        evidence, tracked = self.asked[one.frame.index]
        return evidence.of(pose) - tracked

    def gain(self, stretch: Stretch) -> float:
        """Nats by which they favour a stretch."""
        return sum(self.favour(*pair) for pair in zip(stretch.passed, stretch.expected, strict=True))

    def shown(self, stretch: Stretch) -> bool:
        """Whether they show the limb on its way: behind the body or out of all images it would gain as well."""
        pairs = zip(stretch.passed, stretch.expected, strict=True)
        nats = [self.asked[one.frame.index][0].by_part(pose)[0].sum(axis=0)[stretch.parts].sum() for one, pose in pairs]
        return bool(np.mean(nats) >= stretch.needed)


def looked_between(
    model: Model, state: State, passed: Sequence[Passed], estimate: Estimate
) -> tuple[State, list[Estimate]]:
    """The state after a frame, and better estimates of the last frames before it, the oldest first.

    Args:
        model: of the track.
        state: after the frame.
        passed: frames before it, the latest last.
        estimate: of the frame.
    """
    pictures = _Pictures(model, state)
    gains = [
        (pictures.gain(stretch), stretch) for stretch in _doubtful(model, state, passed, estimate)
        if pictures.gain(stretch.middle) > 0.0
    ]  # fmt: skip
    most, best = max(gains, key=lambda pair: pair[0], default=(0.0, None))
    if best is None or most < best.needed or not pictures.shown(best):
        return state, []
    way = max(_tracked_again(model, state, best, pictures), key=lambda way: sum(again.gain for again in way))
    if not way or sums(way)[-1] < best.needed:
        return state, []
    better = [again.estimate for again in way]
    return corrected(state, better), better


def _doubtful(model: Model, state: State, passed: Sequence[Passed], estimate: Estimate) -> Iterator[Stretch]:
    """Stretches that end before the present frame, in which evidence lacks of a limb that was off its way."""
    memory = next((m for m in state.searches.values() if isinstance(m, LostMemory)), None)
    if memory is None or memory.lacked is None or not memory.known.sure or estimate.status in _BLIND:
        return
    lacked, groups, own = memory.lacked, memory.groups, limbs(model.body)
    usual, latest = groups @ memory.known.nats.sum(axis=0), list(passed)[-LACKED - 1 :]
    for frames in (n for n in _FRAMES if estimate.index % ((n + 1) // 2) == 0):
        if len(latest) <= frames or any(one.estimate.status in _BLIND for one in latest[-frames - 1 :]):
            return
        lacks = lacked[-frames:].clip(min=0.0).sum(axis=0)
        before, between = latest[-frames - 1], latest[-frames:]
        for g in (g for g in range(len(own)) if lacks[g] >= _SHARE):
            expected = _on_the_way(before, between, estimate, own[g][6:])
            stretch = Stretch(between, own[g][6:], expected, groups[g], max(_GAIN, _SHARE * float(usual[g])))
            (tracked,), (way,) = stretch.middle.passed, stretch.middle.expected
            if apart(model, tracked.estimate.pose, way)[groups[g]].max() > _AWAY:
                yield stretch


def _on_the_way(before: Passed, between: Sequence[Passed], after: Estimate, limb: Bool) -> list[Pose]:
    """The poses between, with the coordinates (J,) of a limb as if they had moved evenly."""
    first, last, poses = before.estimate, after, list[Pose]()
    for one in between:
        share = (one.estimate.time - first.time) / (last.time - first.time)
        pose = one.estimate.pose
        poses.append(with_coordinates(pose, limb, Pose(pose.root, first.pose.q + share * (last.pose.q - first.pose.q))))
    return poses


def _tracked_again(
    model: Model, state: State, stretch: Stretch, pictures: _Pictures
) -> tuple[list[Again], list[Again]]:
    """The frames tracked from where the limb is expected, in two ways: the whole body, and the limb alone."""
    model = for_second_track(model)
    whole, alone = list[Again](), list[Again]()
    for one, expected in zip(stretch.passed, stretch.expected, strict=True):
        there = with_cameras_of(_expecting(model, state, expected, one.frame.time), one)
        _, found = step(there, one.seen, model)
        if found.status in _BLIND:
            return [], []
        found = replace(found, relit=one.estimate.relit)
        limb = with_limbs(model, one.estimate, found, stretch.limb, stretch.parts)
        whole.append(Again(found, pictures.favour(one, found.pose)))
        alone.append(Again(limb, pictures.favour(one, limb.pose)))
    return whole, alone


def _expecting(model: Model, state: State, pose: Pose, time: float) -> State:
    """The state before a frame in which the body is expected at a pose."""
    before, last = state.past.moments[-2:]  # a frame that is tracked again has some before it
    since = max(last.time - before.time, 1e-3)
    moments = (Moment(time - 2.0 * since, pose), Moment(time - since, pose))
    there = begun(model, state, replace(state.past, moments=moments, seen_time=time - since))
    searches = {
        name: replace(m, waiting=1, limb_waiting=1, doubt=Doubt(2)) if isinstance(m, LostMemory) else m
        for name, m in there.searches.items()
    }
    return replace(there, searches=searches)  # it has been found; nothing is searched for
