"""Which parts the images show: decided here, from all cues' agreement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body
from twistcap.body.limbs import segments_above
from twistcap.cues.observation import Agreement, Evidence, Measured, Visibility, total_agreement
from twistcap.ranges import Checked, Count, Share


@dataclass(frozen=True)
class OcclusionRule(Checked):
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

    hidden: Share = 0.6
    shown: Share = 0.9
    occluded: Share = 0.25
    clear: Share = 0.75
    least_points: Count = 12

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
