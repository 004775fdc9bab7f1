"""Finding a body anywhere in the pictures: places first, then poses that the recording has shown, then the limbs.

Roughly by surface points alone, thousands of hypotheses; then the best by rendering them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numba import njit

from twistcap import se3
from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import branches
from twistcap.body.model import partners, unsided
from twistcap.ranges import Checked, Count, Range
from twistcap.search.evidence import Evidence
from twistcap.search.redrawn import RedrawnLimb

_UP = np.array([0.0, 0.0, 1.0])
_FLIP = np.diag([1.0, -1.0, 1.0])
_POINTS = 120  # of the surface, by which a hypothesis is judged roughly
_BODIES = 3  # that may be mistaken for each other
_NEAREST = 0.5  # m; what is nearer to a camera counts as from there, or its few points would outweigh the other views


@dataclass(frozen=True)
class Stance:
    """A pose wherever it is: root turn (3, 3), height of the root (m) and joint coordinates (J,)."""

    turn: Float
    height: float
    q: Float

    def facing(self, heading: Float) -> Pose:
        """It over the origin, turned by a heading (3, 3)."""
        return Pose(se3.transform(heading @ self.turn, self.height * _UP), self.q)

    def mirrored(self, body: Body) -> Stance:
        """Its mirror image, left for right: turns about x and z change sign in the middle of the body."""
        names = body.coordinate_names
        partner = partners(names)
        turned = np.array([unsided(name) == name for name in names]) & (np.abs(body.twists[:, 1]) < 0.7)
        return Stance(_FLIP @ self.turn @ _FLIP, self.height, np.where(turned, -self.q, self.q[partner]))


@dataclass(frozen=True)
class PlacingRule(Checked):
    """How widely and how finely a body is looked for.

    Attributes:
        grid: m between places.
        headings, turns: headings that are tried at each place, and at the best places.
        places, modes: that are kept.
        apart: m between places where two bodies may stand: the best hypothesis of each is kept.
        draws: poses of each branch of the body in each round about the best.
        near: rad, standard deviations of the rounds.
        seed: of the draws, which are the same in every run, and others in each frame.
    """

    grid: Annotated[float, Range(0.05)] = 0.22
    headings: Count = 8
    turns: Count = 16
    places: Count = 4
    modes: Count = 5
    apart: float = 0.4
    draws: Count = 24
    near: tuple[float, ...] = (0.5, 0.25)
    seed: int = 0


@dataclass(frozen=True)
class Hypothesis:
    """A pose and its evidence, nats."""

    pose: Pose
    nats: float


@dataclass(frozen=True)
class Placing:
    """The search in one frame.

    Attributes:
        evidence: of the frame's pictures.
        rule: how it is done.
    """

    evidence: Evidence
    rule: PlacingRule

    @property
    def body(self) -> Body:
        """That is looked for."""
        return self.evidence.body

    @cached_property
    def _sample(self) -> Int:
        """Vertices that stand for the surface, spread evenly over it."""
        return np.linspace(0, len(self.body.vertices) - 1, _POINTS).astype(np.int32)

    def rough(self, points: Float, offsets: Float, any_part: bool = False) -> Float:
        """(N,) evidence of a body's points (P, 3) at each of the offsets (N, 3), by the pixels that its
        surface covers: what is far away covers few. With `any_part`, any part may be anywhere on the body.
        """
        part = np.zeros(len(points), np.int32) if any_part else self.body.vertex_part[self._sample]
        out = np.zeros(len(offsets))
        for view in self.evidence.views:
            maps, area = view.any_part if any_part else view.maps, view.camera.K[0, 0] * view.camera.K[1, 1]
            nearest = max(view.nearest, _NEAREST)
            out += area * moved_evidence(maps, view.camera.P, points, part, offsets, nearest)
        return out

    def points(self, pose: Pose) -> Float:
        """(P, 3) of the surface, by which a pose is judged roughly."""
        return Posed(self.body, pose).vertices[self._sample]

    def places(self, stances: Sequence[Stance], centre: Float, reach: float) -> Float:
        """(P, 3) the best horizontal places within `reach` m of a centre (2,), the best first; their height is 0."""
        n = int(np.ceil(reach / self.rule.grid))
        steps = self.rule.grid * np.linspace(-n, n, 2 * n + 1)
        offsets = np.append(centre, 0.0) + _grid(steps)
        best = np.full(len(offsets), -np.inf)
        for stance in stances:
            for heading in headings(self.rule.headings):
                best = np.maximum(best, self.rough(self.points(stance.facing(heading)), offsets, any_part=True))
        chosen = list[int]()
        for k in np.argsort(-best):
            if all(np.hypot(*(offsets[k] - offsets[j])[:2]) > 1.5 * self.rule.grid for j in chosen):
                chosen.append(int(k))
            if len(chosen) == self.rule.places:
                break
        return offsets[chosen]

    def standing(self, stances: Sequence[Stance], places: Float) -> list[Hypothesis]:
        """The roughly best of all stances in all headings at some places (P, 3), moved to where each fits; and the best
        at each place.
        """
        about = _grid(self.rule.grid * np.linspace(-0.5, 0.5, 3))
        found = list[tuple[float, Pose, int]]()
        for stance in stances:
            for heading in headings(self.rule.turns):
                pose = stance.facing(heading)
                points = self.points(pose)
                for n, place in enumerate(places):
                    values = self.rough(points, place + about)
                    k = int(np.argmax(values))
                    root = se3.transform(pose.root[:3, :3], pose.root[:3, 3] + place + about[k])
                    found.append((float(values[k]), Pose(root, pose.q), n))
        found.sort(key=lambda item: -item[0])
        kept, modes = found[: 8 * self.rule.modes], self.rule.modes  # the first of each place
        for n in range(len(places)):
            kept += [item for item in found if item[2] == n][sum(item[2] == n for item in kept) : modes]
        return [self.hypothesis(pose) for _, pose, _ in kept]

    def hypothesis(self, pose: Pose) -> Hypothesis:
        """A pose with its evidence."""
        return Hypothesis(pose, self.evidence.of(pose))

    def distinct(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best, best first, each of which puts some part elsewhere than all before it, `modes` at most; and the
        best of other places.
        """
        kept, middles = list[Hypothesis](), list[Float]()
        ordered = sorted(hypotheses, key=lambda h: -h.nats)
        for h in ordered:
            here = Posed(self.body, h.pose).segment_middles
            if all(np.abs(here - there).max() > 0.12 for there in middles):
                kept.append(h)
                middles.append(here)
            if len(kept) == self.rule.modes:
                break
        return [*kept, *(h for h in self.apart(ordered)[:_BODIES] if all(h is not k for k in kept))]

    def apart(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Those, in their order, that stand elsewhere than all before them: they may be other bodies."""
        kept = list[Hypothesis]()
        for h in hypotheses:
            if all(away(h.pose, other.pose) > self.rule.apart for other in kept):
                kept.append(h)
        return kept

    def nearer(self, hypotheses: Sequence[Hypothesis], best: Hypothesis, seen: Pose) -> list[Hypothesis]:
        """Those that stand nearer than the best to where the body was seen. The best may be another body: one that is
        nearer to a camera covers more pixels, and so has more evidence.
        """
        return [h for h in hypotheses if away(h.pose, seen) < away(best.pose, seen) - self.rule.apart]

    def refined(self, h: Hypothesis, turn: int = 0) -> Hypothesis:
        """The best of draws about a hypothesis, one branch of the body after the other; other draws in each turn."""
        rng = np.random.default_rng((self.rule.seed, turn))
        for near in self.rule.near:
            for branch in branches(self.body):
                start = h.pose.within(self.body.limits)
                of = self.evidence.of if branch[0] else RedrawnLimb.at(self.evidence, start, branch).of
                for _ in range(self.rule.draws):
                    pose = h.pose.retract(self._step(rng, branch, near, h.pose)).within(self.body.limits)
                    value = of(pose)
                    if value > h.nats:
                        h = Hypothesis(pose, value)
        return h

    def _step(self, rng: np.random.Generator, branch: Bool, near: float, pose: Pose) -> Float:
        """(6 + J,) a draw of one branch; of the root about the body's own middle."""
        step = np.where(branch, near * rng.standard_normal(len(branch)), 0.0)
        if branch[0]:
            step[:6] *= 0.4
            step[3:6] = 0.5 * step[3:6] - np.cross(step[:3], pose.root[:3, 3])
        return step


def away(a: Pose, b: Pose) -> float:
    """m between the roots of two poses."""
    return float(np.linalg.norm(a.root[:3, 3] - b.root[:3, 3]))


def headings(count: int) -> Float:
    """(count, 3, 3) turns about the vertical, evenly spread."""
    return se3.exp_rotation(np.outer(2.0 * np.pi * np.arange(count) / count, _UP))


def _grid(steps: Float) -> Float:
    """(N·N, 3) horizontal offsets of a square grid."""
    x, y = np.meshgrid(steps, steps)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


@njit(cache=True, nogil=True)
def moved_evidence(maps: Float32, P: Float, points: Float, part: Int, offsets: Float, nearest: float) -> Float:
    """(N,) sum of the evidence (S, h, w) at the projections of points (M, 3) of parts (M,), moved by offsets (N, 3),
    each divided by the square of its depth, which counts as `nearest` (m) at least.
    """
    height, width = maps.shape[1:]
    out = np.zeros(len(offsets))
    base = points @ np.ascontiguousarray(P[:, :3].T)
    for n in range(len(offsets)):
        d = offsets[n]
        a = P[0, 0] * d[0] + P[0, 1] * d[1] + P[0, 2] * d[2] + P[0, 3]
        b = P[1, 0] * d[0] + P[1, 1] * d[1] + P[1, 2] * d[2] + P[1, 3]
        e = P[2, 0] * d[0] + P[2, 1] * d[1] + P[2, 2] * d[2] + P[2, 3]
        for m in range(len(points)):
            w = base[m, 2] + e
            if w <= 0.0:
                continue
            c = int((base[m, 0] + a) / w + 0.5)
            r = int((base[m, 1] + b) / w + 0.5)
            if 0 <= c < width and 0 <= r < height:
                out[n] += maps[part[m], r, c] / max(w, nearest) ** 2
    return out


@njit(cache=True, nogil=True)
def points_evidence(maps: Float32, P: Float, points: Float, part: Int) -> Float:
    """(M,) sum of the evidence (S, h, w) at the projections of M sets of points (M, N, 3) of parts (N,)."""
    height, width = maps.shape[1:]
    out = np.zeros(len(points))
    for m in range(len(points)):
        for n in range(points.shape[1]):
            x = points[m, n]
            w = P[2, 0] * x[0] + P[2, 1] * x[1] + P[2, 2] * x[2] + P[2, 3]
            if w <= 0.0:
                continue
            c = int((P[0, 0] * x[0] + P[0, 1] * x[1] + P[0, 2] * x[2] + P[0, 3]) / w + 0.5)
            r = int((P[1, 0] * x[0] + P[1, 1] * x[1] + P[1, 2] * x[2] + P[1, 3]) / w + 0.5)
            if 0 <= c < width and 0 <= r < height:
                out[m] += maps[part[n], r, c]
    return out


def points_evidence_reference(maps: Float32, P: Float, points: Float, part: Int) -> Float:
    """Readable twin of `points_evidence`."""
    return np.array([_at_pixels(maps, P, each, part)[0].sum() for each in points])


def moved_evidence_reference(
    maps: Float32, P: Float, points: Float, part: Int, offsets: Float, nearest: float
) -> Float:
    """Readable twin of `moved_evidence`."""
    nats, depth = _at_pixels(maps, P, points + offsets[:, None], part)
    return (nats / np.maximum(depth, nearest) ** 2).sum(axis=1)


def _at_pixels(maps: Float32, P: Float, points: Float, part: Int) -> tuple[Float, Float]:
    """(...) evidence at the projections of points (..., 3), 0 off the image, and their depth."""
    height, width = maps.shape[1:]
    x, y, w = np.moveaxis(points @ P[:, :3].T + P[:, 3], -1, 0)
    depth = np.where(w > 0.0, w, 1.0)
    c, r = (np.trunc(a / depth + 0.5).astype(int) for a in (x, y))
    inside = (w > 0.0) & (c >= 0) & (c < width) & (r >= 0) & (r < height)
    return np.where(inside, maps[part, np.where(inside, r, 0), np.where(inside, c, 0)], 0.0), depth
