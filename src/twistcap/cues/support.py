"""How far the images still support the pose: from the contour evidence alone, without any truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import AnyArray, Bool, Float, Int
from twistcap.cues.evidence import ContourEvidence


@dataclass(frozen=True)
class SupportRule:
    """When a track counts as lost.

    A contour point agrees where the image tells inside from outside and puts the boundary near the body's own. A part
    whose points do not agree is off the person; the body is lost while any part that is seen well enough is.

    Attributes:
        contrast: nats a point must have to agree.
        tolerance: m (on the body) that the boundary may lie off.
        least_points: contour points over all views below which a part is not judged.
        least_share: share of agreeing points below which a part is lost.
        memory: weight of the past in the running mean of each part's share, per frame.
        chance: share of a body's points that agree in images of mere noise, or a little more: such images show nothing.
        sure: share of a body's points from which the images are believed entirely.
    """

    contrast: float = 3.0
    tolerance: float = 0.015
    least_points: int = 12
    least_share: float = 0.35
    memory: float = 0.8
    chance: float = 0.12
    sure: float = 0.5

    def trust(self, tallies: Sequence[tuple[Float, Int]]) -> float:
        """Share of what the images say that is believed, 0 … 1, by the tallies of all views.

        It falls linearly from `sure` to `chance`: of the points that agree some do so by chance, and what all of them
        tell is worth as much as the others.
        """
        points = sum(int(seen.sum()) for _, seen in tallies)
        share = sum(float(good.sum()) for good, _ in tallies) / max(points, 1)
        return float(np.clip((share - self.chance) / (self.sure - self.chance), 0.0, 1.0))


def part_tally(evidence: ContourEvidence, focal: float, parts: int, rule: SupportRule) -> tuple[Float, Int]:
    """How many of each segment's silhouette points agree in one view (S,), and how many it has (S,).

    Args:
        evidence: of the view; `focal`: its focal length, px.
        parts: S, number of segments.
    """
    contour = evidence.contour
    return tally(
        contour.part, contour.outer, contour.inverse_depth, evidence.displacement, evidence.contrast, parts,
        rule.contrast, rule.tolerance * focal,
    )  # fmt: skip


def summed(tallies: Sequence[tuple[Float, Int]], parts: int) -> tuple[Float, Float]:
    """The tallies of all views together, of S parts."""
    good, seen = np.zeros(parts), np.zeros(parts)
    for agreeing, points in tallies:
        good, seen = good + agreeing, seen + points
    return good, seen


@njit(cache=True, nogil=True)
def tally(
    part: Int, outer: Bool, inverse_depth: Float, displacement: Float, contrast: Float, parts: int,
    least_contrast: float, tolerance: float,
) -> tuple[Float, Int]:  # fmt: skip
    """`part_tally` of a view's points (N,); the tolerance is in px at 1 m from the camera."""
    good, seen = np.zeros(parts), np.zeros(parts, dtype=np.int32)
    for n in range(len(part)):
        if outer[n]:
            seen[part[n]] += 1
            if contrast[n] > least_contrast and abs(displacement[n]) < tolerance * inverse_depth[n]:
                good[part[n]] += 1.0
    return good, seen


def tally_reference(
    part: Int, outer: Bool, inverse_depth: Float, displacement: Float, contrast: Float, parts: int,
    least_contrast: float, tolerance: float,
) -> tuple[AnyArray, AnyArray]:  # fmt: skip
    """Readable twin of `tally`."""
    agrees = outer & (contrast > least_contrast) & (np.abs(displacement) < tolerance * inverse_depth)
    return np.bincount(part[agrees], minlength=parts), np.bincount(part[outer], minlength=parts)
