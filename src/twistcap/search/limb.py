"""A single limb is looked for where the rest of the body is right: in the whole pictures, by what has been learnt.

What compares two poses within one frame (`slipped`) goes by the background about the body in that frame, and by how
well a limb used to agree; a limb that has been wrong for a while, or from the start, it takes for right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose
from twistcap.body.limbs import limbs
from twistcap.body.model import partners
from twistcap.ranges import Checked, Count, Share
from twistcap.search.contradiction import Judged
from twistcap.search.draws import about, anywhere
from twistcap.search.evidence import Evidence
from twistcap.search.flag import lacking
from twistcap.search.recollection import Recollection

_LACKING, _LATE = 0, 4  # signs of a limb, see `flag.limb_signs`


@dataclass(frozen=True)
class LimbRule(Checked):
    """When and how a limb is looked for.

    Attributes:
        lacking: evidence that a limb lacks, over what is usual, from which on it is lost.
        late: fraction of its contour points of late that do not agree, from which on it is.
        gain, share: nats by which the pictures must favour it elsewhere, and the least fraction of what is usual.
        better: by how much less it must lack, or its contour points disagree.
        near: rad, standard deviations of the draws about the best, one round after the other.
        draws: poses of the limb in each round, and as many anywhere within its limits.
        kept: poses that the next round starts from.
        again, longest: frames until it is looked for again where it was not found, which double up to the longest.
    """

    lacking: float = 0.35
    late: Share = 0.6
    gain: float = 30.0
    share: Share = 0.25
    better: float = 0.15
    near: tuple[float, ...] = (0.5, 0.25, 0.125)
    draws: Count = 48
    kept: Count = 3
    again: Count = 2
    longest: Count = 16

    def lost(self, signs: Float, limbs: int) -> list[int]:
        """Limbs, the first of the groups, that seem to be lost by their signs (G, SIGNS)."""
        doubtful = (signs[:limbs, _LACKING] > self.lacking) | (signs[:limbs, _LATE] > self.late)
        return np.flatnonzero(doubtful).tolist()


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
    pose = now.fit.pose
    for i in lost:
        pose, most = _placed(rule, known, evidence, masks[i], rng, pose, most)
    usual = known.nats.sum(axis=0) @ groups[lost].any(axis=0)
    least = before + max(rule.gain, rule.share * float(usual))
    if most < least:
        return None
    fit = now.problem.align(pose, crop=True)
    if evidence.of(fit.pose) < least:
        return None
    other = Judged(now.problem, fit, known.check(fit.posed, fit.sights, now.problem))
    return (
        other if np.mean(_wrong(known, now, groups)[lost] - _wrong(known, other, groups)[lost]) > rule.better else None
    )


def _wrong(known: Recollection, now: Judged, groups: Bool) -> Float:
    """(G,) evidence that each group of segments lacks, or the fraction of contour points that do not agree."""
    points, agreeing = groups @ now.fit.agreement.points, groups @ now.fit.agreement.agreeing
    return np.maximum(lacking(groups, known, now.check)[0], 1.0 - agreeing / np.maximum(points, 1.0))


def _placed(
    rule: LimbRule, known: Recollection, evidence: Evidence, limb: Bool, rng: np.random.Generator,
    pose: Pose, most: float,
) -> tuple[Pose, float]:  # fmt: skip
    """The pose with one limb where the evidence is greatest, and its evidence."""
    body = evidence.body
    best = [(most, pose)]
    steps = [[*_shown(known, limb, body, pose), *anywhere(rng, limb, pose, body, rule.draws)]]
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
