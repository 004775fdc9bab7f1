"""Which parts the images show, and whether they still support the pose: decided here, from all cues' agreement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body
from twistcap.body.limbs import segments_above
from twistcap.cues.observation import Agreement, Evidence, Measured, Visibility, total_agreement


@dataclass(frozen=True)
class OcclusionRule:
    """When a part counts as occluded, so that a pose prior or the prediction decides instead of what hides it.

    On a part in sight nearly all contour points tell inside from outside; behind something hardly any do. But a leg
    that nothing shows may come to lie before the other one, whose outline it then takes for its own: what all views
    have lost must be seen again in all of them together, and what else of its limb they have lost with it.

    Attributes:
        hidden, shown: fractions of telling points up to which a part has no information at all, and from which all.
        occluded: fraction over all views up to which a part counts as occluded, until all of its limb that does so
            exceeds it again.
        clear: median fraction of the parts that are not occluded, below which none is.
        least_points: contour points over all views below which no part counts as occluded.
    """

    hidden: float = 0.6
    shown: float = 0.9
    occluded: float = 0.25
    clear: float = 0.75
    least_points: int = 12

    def in_sight(self, agreement: Agreement, occluded: Bool) -> Float:
        """(S,) in [0, 1] how far each part is in sight, those that are `occluded` (S,) not at all.

        It is 1 where a part has no contour.
        """
        fraction = _telling(agreement)
        return np.where(occluded, 0.0, np.clip((fraction - self.hidden) / (self.shown - self.hidden), 0.0, 1.0))

    def now_occluded(self, before: Bool, agreement: Agreement, body: Body) -> Bool:
        """(S,) which parts no view shows, by what all views gave and which parts were occluded before.

        Where even the others are seen badly, as in noise, that says nothing of any of them: then none is occluded.
        """
        fraction, points = _telling(agreement), agreement.points
        others = fraction[~before & (points >= self.least_points)]
        if len(others) == 0 or np.median(others) < self.clear:
            return np.zeros_like(before)
        hangs = segments_above(body)
        limb = (hangs | hangs.T) & before  # (S, S): of each part, those of its limb that were occluded
        still = limb @ (fraction * points) <= self.occluded * (limb @ points)
        return np.where(before, still, (fraction <= self.occluded) & (points >= self.least_points))

    def known(self, agreement: Agreement, occluded: Bool, body: Body) -> Float:
        """(J,) in [0, 1] how far the images show each joint: the segment it moves, and all of its limb above that."""
        in_sight = self.in_sight(agreement, occluded)
        shown = np.min(np.where(segments_above(body), in_sight, 1.0), axis=1)
        return np.max(np.where(body.chain, shown[:, None], 0.0), axis=0)

    def concealed(self, agreement: Agreement, occluded: Bool) -> float:
        """How much of its contour the part that all views together show least is lacking, in [0, 1]."""
        fraction = _telling(agreement)
        lacking = np.where(agreement.points >= self.least_points, np.maximum(1.0 - fraction / self.hidden, 0.0), 0.0)
        return float(np.max(np.where(occluded, 1.0, lacking)))

    def masked(self, measured: Mapping[str, Evidence], visibility: Visibility, parts: int) -> Measured:
        """One view's evidence, less what it says of parts that it does not show.

        Parts that have just reappeared count in full, so that they find their place again.
        """
        by_part = self.in_sight(total_agreement([measured], parts), visibility.occluded)
        by_part = np.where(visibility.reappeared, 1.0, by_part)
        if np.all(by_part == 1.0):
            return measured
        return {name: evidence.masked(by_part) for name, evidence in measured.items()}

    def after(self, visibility: Visibility, measured: Sequence[Measured], body: Body) -> Visibility:
        """Which of the occluded parts are seen again; they may have been carried off their place meanwhile."""
        if not visibility.occluded.any():
            return visibility
        agreement = total_agreement(measured, len(body.segment_names))
        occluded = self.now_occluded(visibility.occluded, agreement, body)
        return Visibility(occluded, visibility.reappeared | (visibility.occluded & ~occluded))


def _telling(agreement: Agreement) -> Float:
    """(S,) fraction of the points that tell inside from outside; 1 of none."""
    return np.where(agreement.points > 0, agreement.telling / np.maximum(agreement.points, 1), 1.0)


@dataclass(frozen=True)
class SupportRule:
    """When a track counts as lost.

    A part whose points do not agree with the image is off the person; the body is lost while any part that is seen well
    enough is.

    Attributes:
        least_points: contour points over all views below which a part is not judged.
        least: fraction of agreeing points below which a part is lost.
        memory: weight of the past in the running mean of each part's fraction, per frame.
        chance: fraction of a body's points that agree in images of mere noise, or a little more.
        sure: fraction of a body's points from which the images are believed entirely.
    """

    least_points: int = 12
    least: float = 0.35
    memory: float = 0.8
    chance: float = 0.12
    sure: float = 0.5

    def trust(self, agreement: Agreement) -> float:
        """How far the images are believed, 0 … 1.

        It falls linearly from `sure` to `chance`: of the points that agree some do so by chance, and what all of them
        say is worth as much as the others.
        """
        fraction = float(agreement.agreeing.sum()) / max(int(agreement.points.sum()), 1)
        return float(np.clip((fraction - self.chance) / (self.sure - self.chance), 0.0, 1.0))

    def updated(self, support: Float, agreement: Agreement) -> Float:
        """(S,) running fraction of agreeing points; a part that is hardly seen keeps the support that it had."""
        judged, out = agreement.points >= self.least_points, support.copy()
        out[judged] *= self.memory
        out[judged] += (1.0 - self.memory) * agreement.agreeing[judged] / agreement.points[judged]
        return out

    def slipped(self, support: Float, agreement: Agreement, drop: float) -> bool:
        """Whether a part agrees with the images much less than it used to; `drop` 0 never says so."""
        points, agreeing = agreement.points, agreement.agreeing
        return bool(np.any((points >= self.least_points) & (agreeing < drop * support * points)))
