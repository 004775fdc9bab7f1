"""Frames that have been tracked, and how they are judged by what is known now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Pose, Posed
from twistcap.cues.view import as_calibrated, despeckled
from twistcap.estimate import Estimate, Frame
from twistcap.predict.history import Moment, Past
from twistcap.search.evidence import Evidence
from twistcap.search.flag import flag_groups
from twistcap.search.memory import LostMemory
from twistcap.track import Model, State
from twistcap.track.align import FrameProblem


@dataclass(frozen=True)
class Passed:
    """A frame that has been tracked, and what is said of it by now."""

    frame: Frame
    estimate: Estimate

    @property
    def seen(self) -> Frame:
        """The frame without pictures that told nothing."""
        sources = self.estimate.sources or tuple(range(len(self.frame.images)))
        missing = {sources[camera] for camera in self.estimate.missing}
        images = tuple(None if i in missing else image for i, image in enumerate(self.frame.images))
        return replace(self.frame, images=images)

    @property
    def size(self) -> int:
        """Bytes of its pictures."""
        return sum(image.nbytes for image in self.frame.images if image is not None)


@dataclass(frozen=True)
class Again:
    """What a second track says of a passed frame.

    Attributes:
        estimate: what it says.
        gain: nats by which the pictures favour it.
    """

    estimate: Estimate
    gain: float


def sums(way: Sequence[Again]) -> list[float]:
    """Nats of so many frames together."""
    return list(accumulate(again.gain for again in way))


def lost_memory(state: State) -> LostMemory:
    """What the search for lost bodies knows."""
    return next(memory for memory in state.searches.values() if isinstance(memory, LostMemory))


def evidence_in(model: Model, state: State, one: Passed) -> Evidence:
    """What the pictures of a passed frame say of poses, by what is known now."""
    none = np.zeros_like(state.covariance)
    out = frozenset(state.left_out)
    frame = despeckled(as_calibrated(one.seen, one.estimate, model.rig))
    problem = FrameProblem(model, state, frame, one.estimate.pose, none, none, {}, left_out=out)
    return lost_memory(state).known.evidence(problem)


def with_cameras_of(state: State, one: Passed) -> State:
    """The state with the cameras as they stood, and were named, in a passed frame."""
    bumps = one.estimate.bumps
    still = np.zeros_like(state.bumps) if bumps is None else bumps
    return replace(state, bumps=still, sources=one.estimate.sources)


def apart(model: Model, one: Pose, other: Pose) -> Float:
    """(S,) m between the middles of each segment at two poses."""
    return np.linalg.norm(Posed(model.body, one).segment_middles - Posed(model.body, other).segment_middles, axis=1)


def with_coordinates(pose: Pose, which: Bool, other: Pose) -> Pose:
    """A pose with some coordinates (J,) of another."""
    return Pose(pose.root, np.where(which, other.q, pose.q))


def with_limbs(model: Model, first: Estimate, second: Estimate, coordinates: Bool, parts: Bool) -> Estimate:
    """What a second track says, with nothing of its pose but some coordinates (J,). All but their parts (S,) keep the
    flag of the first one; covariance and energies are the second one's.
    """
    found = replace(second, pose=with_coordinates(first.pose, coordinates, second.pose))
    if first.part_probability is None or second.part_probability is None:  # what is not seen is not found by a limb
        return replace(
            found, status=first.status, lost=first.lost, probability=first.probability, part_probability=None
        )
    by_part = np.where(parts, second.part_probability, first.part_probability)
    each = by_part[flag_groups(model.body).argmax(axis=1)]
    if np.isnan(each).all():
        return found
    probability = model.flag.whole(each[~np.isnan(each)])
    return replace(found, part_probability=by_part, probability=probability, lost=probability >= model.flag.lost)


def for_second_track(model: Model) -> Model:
    """The model by which passed frames are tracked: nobody's motion is known backward, and the flag is more careful."""
    predictors = tuple(p for p in model.predictors if p.name != "motion")
    return replace(model, predictors=predictors, flag=model.flag.in_hindsight)


def begun(model: Model, state: State, past: Past) -> State:
    """The state from which a second track begins: what the recording has taught stays."""
    cues = {c.name: c.start(model.body, model.rig) for c in model.cues} | {"contour": state.cues["contour"]}
    predictors = {p.name: p.start(model.body, model.rig) for p in model.predictors}
    searches = {name: m.begun_anew() if isinstance(m, LostMemory) else m for name, m in state.searches.items()}
    support = np.ones_like(state.support)  # as at the start of any track
    return replace(state, past=past, support=support, cues=cues, predictors=predictors, searches=searches, prints=())


def corrected(state: State, better: Sequence[Estimate]) -> State:
    """The state with better poses of the last frames before the present one, the oldest first."""
    moments = list(state.past.moments)
    for k, estimate in enumerate(reversed(better), 2):
        moments[-k] = Moment(moments[-k].time, estimate.pose)
    return state.with_past(replace(state.past, moments=tuple(moments)))
