"""A first pose is proved by its track: searches in several frames know nothing of one another, and must meet on it.

A wrong limb or a wrong facing that one frame allows is contradicted by another, or the track does not lead to what the
other frame's own search has found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from twistcap.adjust.unaided.hull import height_of, middle_of_sight, places, share_explained
from twistcap.adjust.unaided.scenery import Scenery
from twistcap.adjust.unaided.search import Candidate, Instant, UnaidedRule
from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.ranges import Checked, Count, Range, Share, Signed
from twistcap.search import Search
from twistcap.search.beside import BesideRule
from twistcap.search.lost import LostBody
from twistcap.search.placing import Stance
from twistcap.track import Tracker
from twistcap.track.model import Model

Read = Callable[[range], Iterable[Frame]]
"""Frames by their places in the recording."""

_AS_IT_IS = BesideRule(good=0.0, limb_poor=0.0)
_NEAR = 0.97  # of the best score of a probe, that a pose must have for a track to have met what the probe found
_ODD = 1.15  # times the body's height, from which on the calibration is blamed
_TOGETHER = 0.9  # share of what stands out that one person explains, from which on: up to 0.85 in swapped cameras
_APART = (
    "the cameras agree on no person: their names may be swapped, pictures mirrored or of another calibration,"
    " or nobody is seen whole"
)
_CLICKS = "click its joints with `twistcap init`, or give [first_pose] keypoints"


@dataclass(frozen=True)
class ProofRule(Checked):
    """In which frames a pose is looked for, and when it is believed.

    Attributes:
        search: in each of them.
        beside, pace: m about a place that was asked for in which a person is looked for, and m/s by which that grows.
        probes: s after the first frame, of the frames that are searched, as many as are needed, two at least.
        different, same: m between landmarks, the greatest, from which on two poses are different, and up to which they
            are the same.
        together: m, the same up to which two tracks have come together.
        met: probes that must have found a pose on the track, or one from which another track leads to it.
        standing: share of the best score that the track must have in the mean over the probes.
        clear: share by which its scores must exceed those of the next different poses, in the mean over the probes; in
            none may another be better. Where more probes than `met` have found it, that is enough.
        alone, each: that share, summed over the probes, and the least in any, from which on a track is believed that no
            other probe has met: nothing explains the images nearly as well.
        agreeing: fraction of the contour that must agree with the images along it.
        hopeless: standing below which a track is given up.
        settling: s after the first frame from where at the earliest the track comes back to it.
    """

    search: UnaidedRule = field(default_factory=UnaidedRule)
    beside: Annotated[float, Range(0.1, 50.0)] = 0.6
    pace: float = 1.5
    probes: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.25, 2.0)
    different: float = 0.2
    same: float = 0.15
    together: float = 0.05
    met: Count = 2
    standing: Share = 0.96
    clear: Share = 0.08
    alone: float = 0.4
    each: Signed = -0.03
    agreeing: Share = 0.6
    hopeless: Share = 0.75
    settling: float = 0.25


@dataclass(frozen=True)
class Probe:
    """One frame's search.

    Attributes:
        at: place of the frame in the recording.
        instant: the search in it.
        candidates: that it found, the best first.
    """

    at: int
    instant: Instant
    candidates: Sequence[Candidate]


class Track:
    """A body that is tracked both ways from one frame; it grows as frames are read.

    Attributes:
        start: place of that frame.
        poses: from the first frame on.
    """

    def __init__(self, model: Model, frames: Sequence[Frame], start: int, pose: Pose) -> None:
        back = Tracker(model)
        back.start(pose, -frames[start].time)
        before = [back.step(replace(frame, time=-frame.time)).pose for frame in frames[start::-1]]
        self.start, self.poses, self._tracker = start, before[:0:-1], Tracker(model)
        self._tracker.start(pose, frames[start].time)
        self.extend(frames)

    def extend(self, frames: Sequence[Frame]) -> None:
        """Go on through the frames that are new."""
        self.poses += [self._tracker.step(frame).pose for frame in frames[len(self.poses) :]]


@dataclass(frozen=True)
class Proof:
    """How a track stands among all that the probes have found.

    Attributes:
        track: itself.
        met: probes that have found a pose on it, or one from which a track leads to where it was begun.
        standing: its scores over the best ones, mean of the probes.
        margins: share of each probe by which its score exceeds that of the next different pose.
        agreement: of the contour with the images, least of the probes.
    """

    track: Track
    met: int
    standing: float
    margins: tuple[float, ...]
    agreement: float

    @property
    def first(self) -> Pose:
        """The pose of the first frame."""
        return self.track.poses[0]

    def holds(self, rule: ProofRule, probes: int) -> bool:
        """Whether it is believed, of so many probes; a single picture must do where there is no other."""
        least, margin = min(self.margins), float(np.mean(self.margins))
        if self.standing < rule.standing or self.agreement < rule.agreeing:
            return False
        if sum(self.margins) >= rule.alone and least >= rule.each:  # scores are nats: what the probes say of it adds up
            return True
        if self.met > rule.met:  # one search more than asked has come to it
            return least >= 0.0
        return least >= 0.0 and self.met >= min(rule.met, probes) and margin >= rule.clear


def proof_of(track: Track, probes: Sequence[Probe], others: Sequence[Track], rule: ProofRule) -> Proof:
    """How a track stands beside others."""
    standing, margin, met, agreement = list[float](), list[float](), 0, 1.0
    joined = {other.start for other in others if _join(track, other, probes, rule.together)}
    for probe in probes:
        own, instant = probe.instant.measured(track.poses[probe.at]), probe.instant
        tracked = [instant.measured(other.poses[probe.at]) for other in others if other.start not in joined]
        found = [(c.score, instant.apart(c.pose, own.pose)) for c in (*probe.candidates, *tracked)]
        best = max([own.score, 1e-9, *(score for score, _ in found)])
        rivals = found[1:] if probe.at in joined else found  # what was found first has led to this track
        rival = max((score for score, apart in rivals if apart > rule.different), default=0.0)
        standing.append(own.score / best)
        margin.append((own.score - rival) / best)
        good = _NEAR * max((c.score for c in probe.candidates), default=0.0)
        on_it = any(score >= good and apart <= rule.same for score, apart in found[: len(probe.candidates)])
        met += on_it or probe.at in joined
        agreement = min(agreement, own.agreement)
    return Proof(track, met, float(np.mean(standing)), tuple(margin), agreement)


def _as_begun(search: Search) -> Search:
    """The search, for a track whose first pose has been looked for by evidence: what its contour says adds nothing."""
    return replace(search, beside=_AS_IT_IS) if isinstance(search, LostBody) else search


def _join(one: Track, other: Track, probes: Sequence[Probe], near: float) -> bool:
    """Whether two tracks are together in a probe's frame: from there on they are one, wherever they were begun."""
    return any(p.instant.apart(one.poses[p.at], other.poses[p.at]) <= near for p in probes)


@dataclass(frozen=True)
class Unaided:
    """The search for the first pose of a recording.

    Attributes:
        rule: of it.
        model: of the tracker.
        scenery: of the cameras.
        read: frames by place.
        count, rate: number of frames, and frames per second.
        floor: its height, m.
        known: stances beside the bundled ones.
        asked: (3,) m, a place of the person in the first frame; None looks for whoever stands out most.
        calibration: of the cameras, for messages.
    """

    rule: ProofRule
    model: Model
    scenery: Scenery
    read: Read
    count: int
    rate: float
    floor: float = 0.0
    known: Sequence[Stance] = ()
    asked: Float | None = None
    calibration: str = "the calibration"

    def found(self) -> Proof:
        """The track that is proved, of as few probes as are needed. Raises InputError where none is."""
        frames, probes, tracks, best = list[Frame](), list[Probe](), list[Track](), None
        probed = self._places
        for at in probed:
            frames += self.read(range(len(frames), at + 1))
            for track in tracks:
                track.extend(frames)
            probes.append(self._probe(at, frames[at]))
            self._begin(tracks, probes[-1], frames)
            proofs = [proof_of(track, probes, tracks, self.rule) for track in tracks]
            proofs.sort(key=lambda p: -p.standing)
            best = proofs[0] if proofs else None
            if len(probes) >= min(2, len(probed)):
                for proof in proofs:
                    if proof.holds(self.rule, len(probed)):
                        return self._settled(proof, probes[0], frames)
            tracks = [p.track for p in proofs if p.standing >= self.rule.hopeless]
        raise InputError(self._refusal(best, probes))

    @property
    def _places(self) -> list[int]:
        """Of the frames that may be probed."""
        wanted = np.round(np.array(self.rule.probes) * self.rate).astype(int)
        return sorted({int(k) for k in wanted if k < self.count})

    def _probe(self, at: int, frame: Frame) -> Probe:
        rule, centre = self.rule.search, middle_of_sight(self.model.rig)
        if self.asked is not None:
            reach = min(rule.reach, self.rule.beside + self.rule.pace * at / self.rate)
            rule, centre = replace(rule, reach=reach), self.asked
        instant = Instant(rule, self.model, frame, self.scenery.evidence(frame.images, self.model.body))
        return Probe(at, instant, instant.candidates(centre[:2], self.floor, self.known))

    def _begin(self, tracks: list[Track], probe: Probe, frames: Sequence[Frame]) -> None:
        """A track from a probe's best pose, where no track has come there."""
        for c in probe.candidates[:1]:
            far = (probe.instant.apart(c.pose, t.poses[probe.at]) > self.rule.same for t in tracks)
            if all(far):
                tracks.append(self._track(frames, probe.at, c.pose))

    def _track(self, frames: Sequence[Frame], start: int, pose: Pose) -> Track:
        searches = tuple(map(_as_begun, self.model.searches))
        return Track(replace(self.model, searches=searches), frames, start, pose)

    def _settled(self, proof: Proof, probe: Probe, frames: list[Frame]) -> Proof:
        """With the first pose to which the track comes back from later frames, which show what one of them does not: a
        limb that a search has missed there.
        """
        end = min(self.count, 1 + round(self.rule.settling * self.rate))
        frames += self.read(range(len(frames), end))
        proof.track.extend(frames)
        back = self._track(frames, len(frames) - 1, proof.track.poses[-1])
        back.start = proof.track.start  # where it was found
        before, after = (probe.instant.measured(track.poses[0]) for track in (proof.track, back))
        return replace(proof, track=back) if after.score >= _NEAR * before.score else proof

    def _height(self, probes: Sequence[Probe]) -> float | None:
        """m of the person, without a body: of one who seems small the greatest, for people bend; else the median.

        None where the cameras do not agree on a person in most frames: such a height says nothing of the scale.
        """
        centre, reach = middle_of_sight(self.model.rig)[:2], self.rule.search.reach
        heights, shares = list[float](), list[float]()
        for evidence in (probe.instant.evidence for probe in probes):
            for place in places(evidence, centre, reach, self.floor, 1):
                heights.append(height_of(evidence, place, self.floor))
                shares.append(share_explained(evidence, place, heights[-1], self.floor))
        if not shares or np.median(shares) < _TOGETHER:
            return None
        agreed = [height for height, share in zip(heights, shares, strict=True) if share >= _TOGETHER]
        median = float(np.median(agreed))
        return median if median > float(np.ptp(self.model.body.vertices[:, 2])) else max(agreed)

    def _refusal(self, best: Proof | None, probes: Sequence[Probe]) -> str:
        if best is None:
            return f"[first_pose] auto: nobody stands out from the background in two cameras at once; {_CLICKS}."
        said = f"contour agreement {best.agreement:.2f}, margin {100 * np.mean(best.margins):.0f} %"
        own, height = float(np.ptp(self.model.body.vertices[:, 2])), self._height(probes)
        if not height:
            return f"[first_pose] auto is not clear ({said}): {_APART}; {_CLICKS}."
        ratio = height / own
        if 1.0 / _ODD < ratio < _ODD:
            return f"[first_pose] auto: the person's first pose is not clear ({said}); {_CLICKS}."
        larger = f"probably {ratio:.2f} times too large"
        if ratio < 1.0:
            larger = f"{1 / ratio:.2f} times too small if a whole person is seen"
        fact = f"in {self.calibration} the person is about {height:.2f} m tall, but [body] is {own:.2f} m"
        mend = "check its board, its unit and [body] stature"
        return f"[first_pose] auto is not clear ({said}): {fact}; its lengths are {larger}: {mend}."
