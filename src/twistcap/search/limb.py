"""A single limb is looked for where the rest of the body is right: in the whole pictures, by what has been learnt.

A contour pulls a limb from a hand's breadth away, and an arm in a somersault goes farther than that between two frames.
So poses of that limb alone are drawn, anywhere within its joints' limits and about the best, and judged by the pixels
that they cover (annealed search of one branch of the body: Deutscher and Reid, IJCV 2005,
doi:10.1023/B:VISI.0000043757.18370.9c).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.kinematics import points_at
from twistcap.body.limbs import limb_parts, limbs
from twistcap.body.model import partners
from twistcap.camera.projection import projected
from twistcap.ranges import Checked, Count, Share
from twistcap.search.draws import about, anywhere
from twistcap.search.evidence import Evidence
from twistcap.search.flag import DISAGREEING, FEWEST, IN_VIEW, LACKING, LATE, SILENT, UNSEEN, hidden, lacking
from twistcap.search.placing import points_evidence
from twistcap.search.recollection import Check, Judged, Recollection, fitted_at
from twistcap.search.redrawn import RedrawnLimb, drawn

_POINTS = 40  # of a limb's surface, by which its places are judged roughly
_ROOT = 6  # coordinates of the root, which come first
_LITTLE = 100.0  # nats; of a limb whose usual evidence is less, little is known
_WORST = 0.25  # nats that one pixel may say against a place in blurred pictures


@dataclass(frozen=True)
class LimbRule(Checked):
    """When and how a limb is looked for.

    Attributes:
        lacking: evidence that a limb lacks, over what is usual, from which on it is lost.
        in_view: the same of late in the camera in which most lacks; one frame says little.
        late: fraction of its contour points of late that do not agree, over what is usual, from which on it is.
        slipped: fraction of its contour points that do not agree now, over what is usual, from which on it is looked at
            at once, though it is not lost yet.
        unseen: how much less of it is seen of late than usually, from which on it may be elsewhere, in full view.
        gain, share: nats by which the pictures must favour it elsewhere, and the least fraction of what is usual.
        less, plenty: by how much less it must lack, or its contour points disagree; or the evidence that it must gain,
            as a fraction of what is usual: the contour of a limb in the background's colours says little anywhere.
            But it may not disagree more, by `less`: the limb of somebody else may be there.
        clear: the least sum of that and of the evidence that it gains, as a fraction of what is usual.
        many: poses of the limb anywhere within its limits that are judged roughly.
        climbing, tries: how many are kept of the roughly best, in sharp and in blurred pictures, and places that are
            tried about each in each round.
        climb, blurs: rad, standard deviations of those, and m over which pixels are averaged, in each round.
        near: rad, the same of the draws about the best of them.
        draws: poses that are drawn in each round.
        kept: poses that the next round starts from.
        again, longest: frames until it is looked for again where it was not found, which double up to the longest.
        bare: evidence of the body that nothing covers in a camera, over what is usual, as a fraction of that of the
            least limb, from which on all limbs are looked at: one of them may belong there.
        every: frames between such looks, which seldom find one.
        few, worth: of such a limb, how many of the roughly best poses are drawn; and the fraction of what is usual that
            one of them must gain for it to be looked for at all.
    """

    lacking: float = 0.35
    in_view: float = 0.55
    late: Share = 0.4
    slipped: Share = 0.2
    unseen: Share = 0.5
    gain: float = 20.0
    share: Share = 0.25
    less: float = 0.05
    plenty: Share = 0.6
    clear: float = 0.4
    many: Count = 150
    climbing: Count = 12
    tries: Count = 8
    climb: tuple[float, ...] = (0.7, 0.5, 0.3, 0.15)
    blurs: tuple[float, ...] = (0.2, 0.2, 0.1, 0.05)
    near: tuple[float, ...] = (0.5, 0.25, 0.125)
    draws: Count = 48
    kept: Count = 3
    again: Count = 2
    longest: Count = 4
    bare: Share = 0.25
    every: Count = 6
    few: Count = 12
    worth: Share = 0.1

    def lost(self, signs: Float, lately: Float) -> list[int]:
        """Limbs that seem to be lost, by their signs (G, SIGNS) now and lately; the last group is no limb."""
        doubtful = (signs[:-1, LACKING] > self.lacking) | (signs[:-1, LATE] > self.late)
        return np.flatnonzero(doubtful | (lately[:-1, IN_VIEW] > self.in_view)).tolist()

    def slipping(self, signs: Float) -> list[int]:
        """Limbs whose contour suddenly no longer agrees with the images, by their signs (G, SIGNS) now."""
        return np.flatnonzero(signs[:-1, DISAGREEING] + signs[:-1, SILENT] > self.slipped).tolist()

    def due(self, known: Recollection, check: Check, groups: Bool, frames: int) -> list[int]:
        """Limbs that are looked at though nothing speaks against them: all where the body's colours lie bare, if it is
        time for that.
        """
        if frames % self.every:
            return []
        bare = (check.uncovered - known.uncovered).sum(axis=1).max()
        least = (known.nats.sum(axis=0) @ groups[:-1].T).min(initial=np.inf)
        return list(range(len(groups) - 1)) if bare > self.bare * max(float(least), _LITTLE) else []

    def hidden(self, lately: Float) -> list[int]:
        """Limbs of which little has been seen of late."""
        return np.flatnonzero(lately[:-1, UNSEEN] > self.unseen).tolist()

    def believed(self, gained: float, less: float) -> bool:
        """Whether limbs are where they were found, by the evidence that they gain and by how much less they lack there,
        or their contours disagree.
        """
        agrees = less > self.less or (gained > self.plenty and less > -self.less)
        return agrees and gained + less > self.clear


def taught(known: Recollection, body: Body, groups: Bool) -> Bool:
    """(G,) groups of segments (G, S) of which, or of the other side's, it is known how they usually look."""
    pixels = known.pixels.sum(axis=0)
    return groups @ (pixels + pixels[partners(body.segment_names)]) > 0.0


def regained(
    rule: LimbRule, known: Recollection, now: Judged, groups: Bool, asked: list[int], seed: int, sure: bool
) -> tuple[Judged, list[int]] | None:
    """The frame fitted with limbs elsewhere, and which; None where the pictures do not show them clearly.

    Args:
        groups: (G, S) the segments of each limb and of the rest of the body.
        asked: that are looked for.
        seed: of the draws.
        sure: whether they are surely lost; else they are looked for only where a look is worth it.
    """
    evidence = known.evidence(now.problem)
    if not evidence.views:
        return None
    rng, masks = np.random.default_rng(seed), limbs(now.problem.body)
    pose, found, usual = now.fit.pose, list[int](), known.nats_in(evidence) @ groups.T
    before = most = evidence.of(pose)
    for i in asked:
        worth = 0.0 if sure else max(rule.gain, rule.worth * float(usual[i]))
        other, nats = placed(rule, known.angles, evidence, masks[i], rng, pose, most, worth)
        if nats >= most + rule.gain:  # the fit will add to that
            pose, most, found = other, nats, [*found, i]
    if not found:
        return None
    fit = now.problem.align(pose)
    gain = evidence.of(fit.pose) - before
    if gain < max(rule.gain, rule.share * float(usual[found].sum())):
        return None
    other = fitted_at(known, now.problem, fit)
    telling = np.min([groups @ of.fit.agreement.points for of in (now, other)], axis=0) >= FEWEST
    less = np.mean(_wrong(known, now, groups, telling)[found] - _wrong(known, other, groups, telling)[found])
    gained = gain / max(float(usual[found].sum()), _LITTLE)
    return (other, found) if rule.believed(gained, float(less)) else None


def _wrong(known: Recollection, now: Judged, groups: Bool, telling: Bool) -> Float:
    """(G,) the greatest of what tells that a group of segments is wrong: the evidence that it lacks, how much of it is
    hidden and, where its contour is telling (G,), the fraction of contour points that do not agree.
    """
    points, agreeing = groups @ now.fit.agreement.points, groups @ now.fit.agreement.agreeing
    silent = np.where(telling, 1.0 - agreeing / np.maximum(points, 1.0), 0.0)
    return np.max([lacking(groups, known, now.check)[0], silent, hidden(groups, known, now.check)], axis=0)


def placed(
    rule: LimbRule, angles: Iterable[Float], evidence: Evidence, limb: Bool, rng: np.random.Generator,
    pose: Pose, most: float, worth: float = 0.0,
) -> tuple[Pose, float]:  # fmt: skip
    """The pose with one limb where the evidence is greatest, and its evidence.

    Among the places tried are those of some joint angles (J,), and of the other side's. It is looked for only if one of
    the roughly best few places gains `worth` nats.
    """
    body, roughly = evidence.body, _Roughly.of(evidence, pose, limb)
    redrawn = RedrawnLimb.at(evidence, pose.within(body.limits), limb)
    steps = np.array([*_shown(angles, limb, body, pose), *anywhere(rng, limb, pose, body, rule.many)])
    steps = _climbed(rule, rng, roughly, limb, steps)
    few = (redrawn.of(pose.retract(step).within(body.limits)) for step in steps[: rule.few])
    if worth > 0.0 and max(few) < most + worth:
        return pose, most
    return _settled(rule, redrawn, limb, rng, pose, most, steps)


def _settled(
    rule: LimbRule, redrawn: RedrawnLimb, limb: Bool, rng: np.random.Generator, pose: Pose, most: float, steps: Float
) -> tuple[Pose, float]:
    """The best of a pose, of steps from it, and of draws about the best ones; and its evidence."""
    limits, best = redrawn.body.limits, [(most, pose)]
    rounds = [steps]
    for sd in (*rule.near, None):
        poses = [start.retract(step) for (_, start), each in zip(best, rounds, strict=True) for step in each]
        tried = [(redrawn.of(p), p) for p in (p.within(limits) for p in poses)]
        best = sorted([*best, *tried], key=lambda item: -item[0])[: rule.kept]
        if sd is not None:
            rounds = [about(rng, limb, sd, rule.draws // len(best)) for _ in best]
    return best[0][1], best[0][0]


def _climbed(rule: LimbRule, rng: np.random.Generator, roughly: _Roughly, limb: Bool, steps: Float) -> Float:
    """The roughly best of steps (N, 6 + J); and as many that are best in blurred pictures, each moved to where it is
    better still. They take turns, the best first.
    """
    sharp, coarse = (
        steps[np.argsort(-level.gains(steps))[: rule.climbing]] for level in (roughly, roughly.blurred(rule.blurs[0]))
    )
    steps = coarse
    for sd, blur in zip(rule.climb, rule.blurs, strict=True):
        level = roughly.blurred(blur)
        moves = about(rng, limb, sd, rule.tries * len(steps)).reshape(len(steps), rule.tries, -1)
        tried = np.concatenate([steps[:, None], steps[:, None] + moves], axis=1)
        gains = level.gains(tried.reshape(-1, tried.shape[2])).reshape(tried.shape[:2])
        steps = tried[np.arange(len(steps)), gains.argmax(axis=1)]
    return np.stack([sharp, steps], axis=1).reshape(-1, steps.shape[1])


def _shown(angles: Iterable[Float], limb: Bool, body: Body, pose: Pose) -> list[Float]:
    """Steps (6 + J,) to a limb of some joint angles (J,), and to the mirror images of the one of the other side."""
    other = partners(body.coordinate_names)
    both = [a for q in angles for a in (q, q[other])]
    return [np.where(limb, Pose(pose.root, q).minus(pose), 0.0) for q in both]


@dataclass(frozen=True)
class _Roughly:
    """What a body gains by a limb, by points of its surface and without drawing it.

    Attributes:
        base: (4, 4) what the limb hangs on, at the pose.
        joints, q: (K,) coordinates of the limb, and their values.
        limits, twists, parent: of those coordinates; −1 is the base.
        points: segments' coordinates (P, k), weights (P, k), places at rest (P, 3) and part (P,) of surface points.
        views: (3, 4) projection and (parts, h, w) nats by which each pixel favours each part of the limb over what it
            shows without it. Where that is the body, it is no less than 0: the limb may be behind.
        px_per_m: of each view, at the body.
    """

    base: Float
    joints: Int
    q: Float
    limits: Float
    twists: Float
    parent: Int
    points: tuple[Int, Float, Float, Int]
    views: list[tuple[Float, Float32]]
    px_per_m: list[float]

    @staticmethod
    def of(evidence: Evidence, pose: Pose, limb: Bool) -> _Roughly:
        """Of a limb of a body at a pose."""
        body, posed = evidence.body, Posed(evidence.body, pose)
        joints, own = np.flatnonzero(limb).astype(np.int32) - _ROOT, limb_parts(body, limb)
        within = np.full(len(body.twists) + 1, -1, np.int32)  # the last is that of the root
        within[joints] = np.arange(len(joints))
        above = body.parent[joints[0]]
        base = posed.joint_transforms[above] if above >= 0 else pose.root
        vertices = np.flatnonzero(own[body.vertex_part])
        some = vertices[:: max(1, len(vertices) // _POINTS)]
        points = within[body.segment_joint][body.skin_segments[some]], body.skin_weights[some], body.vertices[some]
        views, px_per_m = _freed(evidence, posed, own)
        return _Roughly(
            base, joints, pose.q[joints], body.limits[joints], body.twists[joints], within[body.parent[joints]],
            (*points, (np.cumsum(own) - 1)[body.vertex_part[some]]), views, px_per_m,
        )  # fmt: skip

    def blurred(self, size: float) -> _Roughly:
        """The same where each pixel says what it and those about it, `size` m wide, say together, and where none says
        much against a part: most of a limb that is a little off is beside it.
        """
        views = list[tuple[Float, Float32]]()
        for (P, maps), px in zip(self.views, self.px_per_m, strict=True):
            width = max(1, round(size * px))
            views.append((P, np.array([cv2.blur(m, (width, width)) for m in np.maximum(maps, -_WORST)])))
        return replace(self, views=views)

    def gains(self, steps: Float) -> Float:
        """(N,) nats at its points, at steps (N, 6 + J) of the limb's joints."""
        q = np.clip(self.q + steps[:, _ROOT + self.joints], *self.limits.T)
        joints, weights, local, part = self.points
        points = points_at(self.base, self.twists, self.parent, q, joints, weights, local)
        return np.sum([points_evidence(maps, P, points, part) for P, maps in self.views], axis=0)


def _freed(evidence: Evidence, posed: Posed, own: Bool) -> tuple[list[tuple[Float, Float32]], list[float]]:
    """Each view without a limb's parts (S,), see `_Roughly`, and its pixels per m at the body."""
    body, views, px_per_m = evidence.body, list[tuple[Float, Float32]](), list[float]()
    for view in evidence.views:
        pixels, nearness = projected(view.camera, posed.vertices)
        px_per_m.append(max(view.camera.px_per_m(nearness), 1.0))
        part, _ = drawn(body, ~own[body.face_part], pixels, nearness, view.camera.size)
        here = np.take_along_axis(view.maps, np.maximum(part, 0)[None], axis=0)[0]
        views.append((view.camera.P, np.where(part >= 0, np.maximum(view.maps[own] - here, 0.0), view.maps[own])))
    return views, px_per_m
