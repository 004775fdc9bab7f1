"""How far the images still support the pose: from the contour evidence alone, without any truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap._typing import Float, Int
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
    """

    contrast: float = 3.0
    tolerance: float = 0.015
    least_points: int = 12
    least_share: float = 0.35
    memory: float = 0.8


def part_tally(evidence: ContourEvidence, focal: float, parts: int, rule: SupportRule) -> tuple[Float, Int]:
    """How many of each segment's silhouette points agree in one view (S,), and how many it has (S,).

    Args:
        evidence: of the view; `focal`: its focal length, px.
        parts: S, number of segments.
    """
    outer = evidence.contour.outer
    part = evidence.contour.part[outer]
    off_by = np.abs(evidence.displacement[outer]) / (focal * evidence.contour.inverse_depth[outer])
    agrees = (evidence.contrast[outer] > rule.contrast) & (off_by < rule.tolerance)
    good = np.bincount(part, weights=agrees, minlength=parts)
    return good.astype(np.float64), np.bincount(part, minlength=parts).astype(np.int32)
