"""A single limb is looked for where the rest of the body is right: in the whole pictures, by what has been learnt.

What compares two poses within one frame (`slipped`) goes by the background about the body in that frame, and by how
well a limb used to agree; a limb that has been wrong for a while, or from the start, it takes for right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.kinematics import skin_points
from twistcap.body.limbs import limb_parts, limbs
from twistcap.body.model import partners
from twistcap.ranges import Checked, Count, Share
from twistcap.render import render
from twistcap.search.contradiction import Judged
from twistcap.search.draws import about, anywhere
from twistcap.search.evidence import Evidence
from twistcap.search.flag import lacking
from twistcap.search.placing import moved_evidence
from twistcap.search.recollection import Recollection

_POINTS = 40  # of a limb's surface, by which its places are judged roughly
_LACKING, _IN_VIEW, _LATE = 0, 1, 4  # signs of a limb, see `flag.limb_signs`


@dataclass(frozen=True)
class LimbRule(Checked):
    """When and how a limb is looked for.

    Attributes:
        lacking: evidence that a limb lacks, over what is usual, from which on it is lost.
        in_view: the same of late in the camera in which most lacks; one frame says little.
        late: fraction of its contour points of late that do not agree, from which on it is.
        gain, share: nats by which the pictures must favour it elsewhere, and the least fraction of what is usual.
        less: by how much less it must lack, or its contour points disagree.
        clear: the least sum of that and of the evidence that it gains, as a fraction of what is usual.
        near: rad, standard deviations of the draws about the best, one round after the other.
        many: poses of the limb anywhere within its limits, of which the roughly best are drawn.
        draws: poses that are drawn in each round.
        kept: poses that the next round starts from.
        again, longest: frames until it is looked for again where it was not found, which double up to the longest.
    """

    lacking: float = 0.35
    in_view: float = 0.55
    late: Share = 0.6
    gain: float = 30.0
    share: Share = 0.25
    less: float = 0.05
    clear: float = 0.4
    near: tuple[float, ...] = (0.5, 0.25, 0.125)
    many: Count = 600
    draws: Count = 48
    kept: Count = 3
    again: Count = 2
    longest: Count = 16

    def lost(self, signs: Float, lately: Float) -> list[int]:
        """Limbs that seem to be lost, by their signs (G, SIGNS) now and lately; the last group is no limb."""
        doubtful = (signs[:-1, _LACKING] > self.lacking) | (signs[:-1, _LATE] > self.late)
        return np.flatnonzero(doubtful | (lately[:-1, _IN_VIEW] > self.in_view)).tolist()


def regained(
    rule: LimbRule, known: Recollection, now: Judged, groups: Bool, lost: list[int], seed: int
) -> Judged | None:
    """The frame fitted with lost limbs elsewhere; None where the pictures do not show them clearly.

    Args:
        groups: (G, S) the segments of each limb and of the rest of the body.
        lost: limbs that are looked for.
        seed: of the draws.
    """
    evidence = known.evidence(now.problem)
    if not evidence.views:
        return None
    rng, masks = np.random.default_rng(seed), limbs(now.problem.body)
    before = most = evidence.of(now.fit.pose)
    pose, found, usual = now.fit.pose, list[int](), known.nats.sum(axis=0) @ groups.T
    for i in lost:
        other, nats = placed(rule, known, evidence, masks[i], rng, pose, most)
        if nats >= most + max(rule.gain, rule.share * float(usual[i])):
            pose, most, found = other, nats, [*found, i]
    if not found:
        return None
    fit = now.problem.align(pose, crop=True)
    gain = evidence.of(fit.pose) - before
    if gain < max(rule.gain, rule.share * float(usual[found].sum())):
        return None
    other = Judged(now.problem, fit, known.check(fit.posed, fit.sights, now.problem))
    less = np.mean(_wrong(known, now, groups)[found] - _wrong(known, other, groups)[found])
    clear = gain / max(float(usual[found].sum()), 1.0) + less
    return other if less > rule.less and clear > rule.clear else None


def _wrong(known: Recollection, now: Judged, groups: Bool) -> Float:
    """(G,) evidence that each group of segments lacks, or the fraction of contour points that do not agree."""
    points, agreeing = groups @ now.fit.agreement.points, groups @ now.fit.agreement.agreeing
    return np.maximum(lacking(groups, known, now.check)[0], 1.0 - agreeing / np.maximum(points, 1.0))


def placed(
    rule: LimbRule, known: Recollection, evidence: Evidence, limb: Bool, rng: np.random.Generator,
    pose: Pose, most: float,
) -> tuple[Pose, float]:  # fmt: skip
    """The pose with one limb where the evidence is greatest, and its evidence."""
    body = evidence.body
    best = [(most, pose)]
    drawn = anywhere(rng, limb, pose, body, rule.many)
    roughly = _Roughly.of(evidence, pose, limb)
    order = np.argsort([-roughly.gain(pose.retract(step).within(body.limits)) for step in drawn])
    steps = [[*_shown(known, limb, body, pose), *drawn[order[: rule.draws]]]]
    for sd in (*rule.near, None):
        poses = [start.retract(step) for (_, start), each in zip(best, steps, strict=True) for step in each]
        tried = [(evidence.of(p), p) for p in (p.within(body.limits) for p in poses)]
        best = sorted([*best, *tried], key=lambda item: -item[0])[: rule.kept]
        if sd is not None:
            steps = [about(rng, limb, sd, rule.draws // len(best)) for _ in best]
    return best[0][1], best[0][0]


def _shown(known: Recollection, limb: Bool, body: Body, pose: Pose) -> list[Float]:
    """Steps (6 + J,) to where the limb has been, and to the mirror images of where the one of the other side has."""
    other = partners(body.coordinate_names)
    angles = [a for q in known.angles for a in (q, q[other])]
    return [np.where(limb, Pose(pose.root, q).minus(pose), 0.0) for q in angles]


@dataclass(frozen=True)
class _Roughly:
    """What a limb would gain by being elsewhere, by points of its surface and without drawing it.

    Attributes:
        body: whose limb it is.
        points: (P,) its vertices that are asked.
        views: (3, 4) projection and (S, h, w) nats by which each pixel favours each part over what is there now. Where
            the body covers it, that is no less than 0: the limb may be behind.
    """

    body: Body
    points: Int
    views: list[tuple[Float, Float32]]

    @staticmethod
    def of(evidence: Evidence, pose: Pose, limb: Bool) -> _Roughly:
        """Of a limb of a body at a pose."""
        body = evidence.body
        own = limb_parts(body, limb)
        vertices = np.flatnonzero(own[body.vertex_part])
        views = list[tuple[Float, Float32]]()
        for view in evidence.views:
            part = render(Posed(body, pose), view.camera).part
            others = (part >= 0) & ~own[part]
            here = np.take_along_axis(view.maps, np.maximum(part, 0)[None], axis=0)[0]
            views.append((view.camera.P, np.where(others, np.maximum(view.maps - here, 0.0), view.maps)))
        return _Roughly(body, vertices[:: max(1, len(vertices) // _POINTS)].astype(np.int32), views)

    def gain(self, pose: Pose) -> float:
        """Nats at its points, at a pose."""
        body, posed, nowhere = self.body, Posed(self.body, pose), np.zeros((1, 3))
        points = skin_points(
            posed.segment_transforms, body.skin_segments[self.points], body.skin_weights[self.points],
            body.vertices[self.points],
        )  # fmt: skip
        part = body.vertex_part[self.points]
        return sum(float(moved_evidence(maps, P, points, part, nowhere)[0]) for P, maps in self.views)
