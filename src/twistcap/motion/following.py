"""Prediction by following matches, the default: measured to be better than the paper's.

The k best matches of a long history are fitted in time and pace, adapted to the person (offset and range of each
joint), followed to their ends, and blended. A recurrence of the person's own past that is as good is followed instead.
For a comparison with the paper's see docs/reproduction/motion-prediction.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numba import njit

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.model import partners
from twistcap.errors import InputError
from twistcap.motion.library import PAPER_SCALES, MotionLibrary
from twistcap.motion.matching import Interval, Match, Matcher
from twistcap.motion.openloop import OpenLoop, PoseSequence
from twistcap.motion.paper import standard_step
from twistcap.ranges import Checked, Count, Range, Share

_ALIKE = 0.05  # rad per pose, of all joints together: smaller differences are no evidence
_WORSE = 2.5  # factor by which the mean distance of a longer history may be larger than that of a shorter one
_FITTED = 60  # frames of history to which a match is fitted
_SHARPNESS = 4.0  # how fast a match's weight falls with its distance, in units of the best one's
_STIFFNESS = 0.3  # rad², summed square deviation below which a joint's range is not adapted
_POSES, _POINTS = 64, 300  # over which leverage is averaged: poses, and points of the surface
_TRUST = 30.0  # frames of history that give an adaptation half its weight, for an angle of large leverage

OWN = -1
"""The clip of a match in the person's own past."""

LOOK_BACK = 120  # frames of the past that are searched
_SHORTEST = 12  # frames of a cycle, at least
_RATIO, _MARGIN = 3.0, 0.1  # in between, distances must exceed this multiple plus this margin (rad per pose)

_Matched = tuple[Match, int]
"""A match, its distance a mean over the poses (rad), and how many poses were matched."""


@dataclass(frozen=True)
class RecurrenceRule(Checked, where="recurrence"):
    """What counts as a recurrence: poses that are compared, and cycles that are blended, at most.

    A recurrence has the person's own pace and style: it is followed up to the distance of the library's best match
    times `lead`; 0 never follows one. Raises InputError for numbers out of range.
    """

    lead: float = 1.5
    poses: Annotated[int, Range(1, LOOK_BACK - 1)] = 15
    count: Count = 3


def recurrences(q: Float, rule: RecurrenceRule) -> list[Match]:
    """Earlier places in q (n, K) rad whose poses are like the last ones, as matches in clip 0, the best first.
    Distances are means over the poses, rad."""
    poses = q[max(0, len(q) - LOOK_BACK) :]
    last = len(poses) - rule.poses - 1  # the longest lag with neighbours on both sides
    if rule.lead <= 0 or last < _SHORTEST:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(poses, rule.poses, axis=0)[::-1]  # by lag
    apart = np.linalg.norm(windows - windows[0], axis=1).mean(axis=1)
    farthest = np.maximum.accumulate(apart)
    lags = np.arange(_SHORTEST, last + 1)
    returned = farthest[lags] >= _RATIO * apart[lags] + _MARGIN
    nearest = (apart[lags] <= apart[lags - 1]) & (apart[lags] <= apart[lags + 1])
    found = sorted(lags[returned & nearest], key=lambda lag: float(apart[lag]))
    return [Match(0, float(len(q) - 1 - lag), 1.0, float(apart[lag])) for lag in found[: rule.count]]


@dataclass(frozen=True)
class FollowRule(Checked):
    """How matches are found and followed.

    Attributes:
        poses: lengths of history that are matched; the longest with matches about as good as the shorter ones counts.
        count, apart: matches that are blended, at most, and frames between them.
        fading: factor per frame of the last pose's offset from the match.
        scales: time scales that are tried before the exact one is fitted.
        lever: m/rad, leverage at which an angle has weight 1/√2. Angles that move the body less have less weight, since
            images determine them worse.
        recurrence: when the person's own past is followed.

    Raises InputError for numbers out of range.
    """

    poses: tuple[int, ...] = (10, 20, 40)
    count: Count = 3
    apart: int = 20
    fading: Share = 0.9
    scales: tuple[float, ...] = PAPER_SCALES
    lever: float = 0.1
    recurrence: RecurrenceRule = field(default_factory=RecurrenceRule)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.poses) == 0 or min(self.poses) < 2 or self.count < 1 or not 0 <= self.fading < 1:
            raise InputError("motion prediction: take 2 poses or more, 1 match or more, and a fading in [0, 1).")


class FollowedMotion(OpenLoop):
    """Predicts by following the best matches; arguments and errors are those of `OpenLoop`."""

    def __init__(self, library: MotionLibrary, body: Body, rule: FollowRule | None = None) -> None:
        super().__init__(library, body)
        self.rule = rule or FollowRule()
        self.history = max(_FITTED, LOOK_BACK, *self.rule.poses)
        by_joint = _usual_leverage(body)[self._theirs]
        self._weights = by_joint / np.hypot(by_joint, self.rule.lever)  # of a deviation of each compared coordinate
        ahead = float(min(self.rule.poses))
        self._matcher = Matcher(library, self.compared, self._weights**2, self.rule.scales, ahead)

    def dissimilarity(self, match: Match | None) -> float:
        """Mean distance of the matched poses, rad."""
        return np.nan if match is None else match.distance

    def next_poses(self, past: PoseSequence, count: int, excluded: Sequence[Interval] = ()) -> PoseSequence:
        """Poses up to where the best match ends; see `OpenLoop.next_poses`."""
        past = past.since(max(0, len(past) - self.history))
        library, matches = self._sources(past, excluded)
        if not matches:
            return standard_step(past.since(max(0, len(past) - 5)))
        own = library is not self.library
        how = self.compared, self._weights, not own
        guides = [_Guide.fitted(library, past, match, poses, *how) for match, poses in matches]
        lasting = [guide.lasting(library) for guide in guides]
        best = matches[0][0].distance
        alike = [guide.match.distance <= 1.5 * best + _ALIKE for guide in guides]
        # Of matches that are about as good, those that last long enough are used.
        count = max(1, min(count, max(n for n, good in zip(lasting, alike, strict=True) if good)))
        used = [guide for guide, n in zip(guides, lasting, strict=True) if n >= count] or guides[:1]
        weights = [np.exp(-_SHARPNESS * (g.match.distance - best) / (best + _ALIKE)) for g in used]
        found = _blended([g.followed(library, past, count, self.rule.fading) for g in used], np.array(weights))
        return replace(found, match=replace(matches[0][0], clip=OWN)) if own else found

    def _sources(self, past: PoseSequence, excluded: Sequence[Interval]) -> tuple[MotionLibrary, list[_Matched]]:
        """Motion to follow, the library or the person's own, and its matches as those of `_matches`."""
        rule, matches = self.rule.recurrence, self._matches(past, excluded)
        own = recurrences(past.q[:, self.compared] * self._weights, rule)
        if not own or (matches and own[0].distance > rule.lead * matches[0][0].distance):
            return self.library, matches
        ends, q = np.array([0, len(past)], np.int32), past.q.astype(np.float32)
        mine = MotionLibrary(self.library.names, self.library.rate, ("own",), ends, q, past.roots)
        return mine, [(match, rule.poses) for match in own]

    def _matches(self, past: PoseSequence, excluded: Sequence[Interval]) -> list[_Matched]:
        """The best matches, their distances by pose."""
        out, bar = list[_Matched](), np.inf
        for poses in sorted(self.rule.poses):
            if poses > len(past):
                break
            query = past.q[-poses:][:, self.compared]
            found = self._matcher.k_best(query, self.rule.count, self.rule.apart, excluded)
            if found and found[0].distance / poses <= bar:
                out = [(replace(match, distance=match.distance / poses), poses) for match in found]
            bar = min(bar, _WORSE * out[0][0].distance + _ALIKE) if out else bar
        return out


def leverage(body: Body, poses: Float) -> Float:
    """(J,) root mean square motion of some of the vertices by each coordinate in poses (N, J), m/rad; the pelvis is
    fixed.

    It weighs angles when poses are compared: images determine a hip, which moves the whole leg, to a degree, and the
    forearm's rotation to ten or twenty. Kovar, Gleicher and Pighin, "Motion Graphs" (DOI 10.1145/566654.566605),
    section 3, likewise compare poses by points of the body. The vertices should lie about evenly on the surface.
    """
    every = slice(None, None, max(1, len(body.vertices) // _POINTS))
    surface = body.skin_segments[every], body.skin_weights[every], body.vertices[every]
    by_step = (Posed(body, Pose(np.eye(4), q)).point_jacobian(*surface)[:, :, 6:] for q in poses)
    return np.sqrt(np.mean([np.square(each).sum(axis=1).mean(axis=0) for each in by_step], axis=0))


def _usual_leverage(body: Body) -> Float:
    """(J,) leverage over poses from all over the joints' limits, the same for both sides of the body. Over those of a
    library it would change how one motion is matched, when another one is added.
    """
    low, high = np.clip(body.limits, -np.pi, np.pi).T
    squares = np.square(leverage(body, np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))))
    return np.sqrt(0.5 * (squares + squares[partners(body.coordinate_names)]))


@dataclass(frozen=True)
class _Guide:
    """A match fitted exactly in time (that of the last pose), and the person's differences from it.

    The joints are ``q ≈ gain · sample + offset``. `heading` (3, 3) turns about the vertical from the sample's world to
    ours, `path` is a complex factor of the horizontal displacements after that, and `lean` the rotation vector from the
    sample's root to ours, in the root's frame.
    """

    match: Match
    gain: Float
    offset: Float
    heading: Float
    path: complex
    lean: Float

    @staticmethod
    def fitted(
        library: MotionLibrary, past: PoseSequence, match: Match, poses: int, columns: Int, weights: Float,
        any_pace: bool,
    ) -> _Guide:  # fmt: skip
        """The guide of a match of the last `poses` poses, by the columns (K,), each deviation times its weight (K,).
        Without `any_pace` the scale of the match stays."""
        clip = library.q[library.starts[match.clip] : library.starts[match.clip + 1]]
        reached = min(len(past), _FITTED, int(match.position / match.step + 1e-6) + 1)
        query = np.ascontiguousarray(past.q[-max(poses, reached) :][:, columns]) * weights
        there = np.ascontiguousarray(clip[:, columns]) * weights
        position, step = placed(there, query, match.position, match.step, any_pace)
        match = Match(match.clip, position, 1.0 / step, match.distance)
        length = min(len(past), _FITTED, int(position / step + 1e-6) + 1)
        where = np.array(position - step * np.arange(length)[::-1], dtype=np.float64)
        evidence = np.zeros(len(library.names))  # frames, weighted for each angle
        evidence[columns] = length * weights**2
        kept = evidence / (evidence + _TRUST)
        gain, offset = adapted(past.q[-length:], library.angles(match.clip, where), _STIFFNESS, kept)
        return _Guide(match, gain, offset, *_aligned(past.roots[-length:], library.root_motions(match.clip, where)))

    def lasting(self, library: MotionLibrary) -> int:
        """Frames until the clip ends."""
        left = int(library.lengths[self.match.clip]) - 1 - self.match.position
        return int(left / self.match.step + 1e-6)

    def followed(self, library: MotionLibrary, past: PoseSequence, count: int, fading: float) -> PoseSequence:
        """The next `count` poses; the offset of the last pose fades."""
        frames = np.arange(count + 1)
        where = np.array(self.match.position + self.match.step * frames, dtype=np.float64)
        left = fading ** frames[:, None]
        q = self.gain * library.angles(self.match.clip, where) + self.offset
        q = q + left * (past.q[-1] - q[0])
        sample = library.root_motions(self.match.clip, where)
        turned = self.heading @ sample[:, :3, :3]
        rest = se3.log_rotation(turned[0].T @ past.roots[-1, :3, :3]) - self.lean
        turned = turned @ se3.exp_rotation(self.lean + left * rest)
        shift = (sample[:, :3, 3] - sample[0, :3, 3]) @ self.heading.T
        level = self.path * (shift[:, 0] + 1j * shift[:, 1])
        place = past.roots[-1, :3, 3] + np.stack([level.real, level.imag, shift[:, 2]], axis=1)
        return PoseSequence(q[1:], se3.transform(turned, place)[1:], self.match.after(count))


def adapted(query: Float, sample: Float, stiffness: float, kept: float | Float) -> tuple[Float, Float]:
    """Gain and offset (J,) from a sample (n, J) to a query (n, J), rad, by ridge regression towards 1 and 0. The ridge
    has a `stiffness`, rad²; of the differences from 1 and 0 the fraction `kept` is kept, one for all or (J,)."""
    of_query, of_sample = query.mean(axis=0), sample.mean(axis=0)
    a, b = sample - of_sample, query - of_query
    gain = np.clip(((a * b).sum(axis=0) + stiffness) / ((a * a).sum(axis=0) + stiffness), 0.3, 3.0)
    return 1.0 + kept * (gain - 1.0), kept * (of_query - gain * of_sample)


_STRIDE = 0.15  # m: shorter displacements hardly change the length and direction of the path


def _aligned(roots: Float, sample: Float) -> tuple[Float, complex, Float]:
    """Heading, path and lean of `_Guide` from (n, 4, 4) roots of the person and the sample, frame by frame."""
    between = (roots[:, :3, :3] @ np.swapaxes(sample[:, :3, :3], 1, 2)).sum(axis=0)
    angle = np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
    heading = se3.exp_rotation(np.array([0.0, 0.0, angle]))
    lean = se3.log_rotation(np.swapaxes(heading @ sample[:, :3, :3], 1, 2) @ roots[:, :3, :3]).mean(axis=0)
    ours, theirs = roots[-1, :2, 3] - roots[0, :2, 3], heading[:2, :2] @ (sample[-1, :2, 3] - sample[0, :2, 3])
    a, b = complex(*ours), complex(*theirs)
    path = (a * b.conjugate() + _STRIDE**2) / (abs(b) ** 2 + _STRIDE**2)
    return heading, path, lean


def _blended(predictions: Sequence[PoseSequence], weights: Float) -> PoseSequence:
    """The weighted mean of predictions; roots by the mean of their twists from the first one."""
    weights = weights / weights.sum()
    q = np.einsum("k,knj->nj", weights, np.array([p.q for p in predictions]))
    first = predictions[0].roots
    twists = [w * se3.log(se3.inverse(first) @ p.roots) for w, p in zip(weights, predictions, strict=True)]
    return PoseSequence(q, first @ se3.exp(np.sum(twists, axis=0)), predictions[0].match)


_FORGIVEN = 0.7  # fraction of a constant offset of the joints that does not count when a match is fitted in time
_GRID, _ROUNDS = 4, 4  # places to either side, and rounds of refinement
_REACH, _PACE = 1.0, 0.06  # poses, and poses per frame, within which place and pace are searched
_SPACING = 0.05  # half the distance of neighbouring scales; steps are 1/s, so that their distance grows with them


@njit(cache=True, nogil=True)
def misplaced(clip: np.ndarray, query: Float, position: float, step: float) -> float:
    """Sum of the norms of the differences of a query (m, K) from a clip (N, K), without most of their constant offset.
    Position and step are in poses; infinite where the query would leave the clip."""
    m, K = query.shape
    if position - (m - 1) * step < 0.0 or position > len(clip) - 1:
        return np.inf
    apart = np.empty((m, K))
    for v in range(m):
        p = position - (m - 1 - v) * step
        i = min(int(p), len(clip) - 2)
        for k in range(K):
            apart[v, k] = clip[i, k] + (p - i) * (clip[i + 1, k] - clip[i, k]) - query[v, k]
    total = 0.0
    offset = np.array([_FORGIVEN * apart[:, k].mean() for k in range(K)])
    for v in range(m):
        total += np.sqrt(np.sum((apart[v] - offset) ** 2))
    return total


@njit(cache=True, nogil=True)
def placed(clip: np.ndarray, query: Float, position: float, step: float, any_pace: bool = True) -> tuple[float, float]:
    """Position and, with `any_pace`, step near the given ones that fit a query (m, K) best, by ever finer grids."""
    reach, pace = _REACH, max(_PACE, _SPACING * step * step) if any_pace else 0.0
    best = misplaced(clip, query, position, step)
    for _ in range(_ROUNDS):
        middle, middle_step = position, step
        for a in range(-_GRID, _GRID + 1):
            for b in range(-_GRID, _GRID + 1):
                p, d = middle + reach * a / _GRID, middle_step + pace * b / _GRID
                value = misplaced(clip, query, p, d)
                if value < best:
                    best, position, step = value, p, d
        reach, pace = reach / 3.0, pace / 3.0
    return position, step


def misplaced_reference(clip: np.ndarray, query: Float, position: float, step: float) -> float:
    """Readable twin of `misplaced`."""
    places = position + np.arange(1 - len(query), 1) * step
    if places[0] < 0.0 or places[-1] > len(clip) - 1:
        return np.inf
    there = [np.interp(places, np.arange(len(clip)), column) for column in clip.T]
    apart = np.array(there).T - query
    return float(np.linalg.norm(apart - _FORGIVEN * apart.mean(axis=0), axis=1).sum())


def placed_reference(
    clip: np.ndarray, query: Float, position: float, step: float, any_pace: bool = True
) -> tuple[float, float]:
    """Readable twin of `placed`: the best of ever finer grids."""
    pace = max(_PACE, _SPACING * step * step) if any_pace else 0.0
    grid = np.linspace(-1.0, 1.0, 2 * _GRID + 1)
    for finer in 3.0 ** -np.arange(_ROUNDS):
        tried = [(position + _REACH * finer * a, step + pace * finer * b) for a in grid for b in grid]
        position, step = min([(position, step), *tried], key=lambda at: misplaced_reference(clip, query, *at))
    return position, step
