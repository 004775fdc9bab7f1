"""Parts that a view does not show, though it should: there the contour found is something else's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap._typing import Bool, Float
from twistcap.body import Body
from twistcap.cues.evidence import ContourEvidence
from twistcap.terms import PhotometricTerm, PointNormalTerm, PointRayTerm, Term


@dataclass(frozen=True)
class HiddenRule:
    """When the say of a part in a view is taken from it, so that a pose prior can have it.

    On a part in sight nearly all contour points tell inside from outside; behind something hardly any do. But a leg
    that nothing shows may come to lie before the other one, whose outline it then takes for its own: what all views
    have lost must be seen again in all of them together, and what else of its limb they have lost with it.

    Attributes:
        contrast: nats by which a point must tell inside from outside.
        hidden, shown: shares of such points up to which a part has no say at all, and from which it has all of it.
        gone: share over all views up to which a part counts as hidden from all, until all of its limb that does so
            exceeds it again.
        clear: median share of the parts that are not gone, below which none is.
        least_points: contour points over all views below which no part counts as hidden from all.
        alone: whether the rule acts also where no prior has the say instead; then the prediction has it.
    """

    contrast: float = 3.0
    hidden: float = 0.6
    shown: float = 0.9
    gone: float = 0.25
    clear: float = 0.75
    least_points: int = 12
    alone: bool = False

    def trust(self, evidence: Sequence[ContourEvidence], gone: Bool) -> Float:
        """(S,) in [0, 1] how far each part is in sight in some views, those that are `gone` (S,) not at all.

        It is 1 where a part has no contour.
        """
        share, _ = self._shares(evidence, len(gone))
        return np.where(gone, 0.0, np.clip((share - self.hidden) / (self.shown - self.hidden), 0.0, 1.0))

    def now_gone(self, before: Bool, evidence: Sequence[ContourEvidence], body: Body) -> Bool:
        """(S,) which parts no view shows, by what `evidence` all views gave and which parts were gone before.

        Where even the others are seen badly, as in noise, that says nothing of any of them: then none is gone.
        """
        share, seen = self._shares(evidence, len(before))
        others = share[~before & (seen >= self.least_points)]
        if len(others) == 0 or np.median(others) < self.clear:
            return np.zeros_like(before)
        hangs = above(body)
        limb = (hangs | hangs.T) & before  # (S, S): of each part, those of its limb that were gone
        still = limb @ (share * seen) <= self.gone * (limb @ seen)
        return np.where(before, still, (share <= self.gone) & (seen >= self.least_points))

    def known(self, evidence: Sequence[ContourEvidence], gone: Bool, body: Body) -> Float:
        """(J,) in [0, 1] how far the images show each joint: the segment it moves, and all of its limb above that."""
        shown = np.min(np.where(above(body), self.trust(evidence, gone), 1.0), axis=1)
        return np.max(np.where(body.chain, shown[:, None], 0.0), axis=0)

    def concealed(self, evidence: Sequence[ContourEvidence], gone: Bool) -> float:
        """How much of its contour the part that all views together show least is lacking, in [0, 1]."""
        share, seen = self._shares(evidence, len(gone))
        lacking = np.where(seen >= self.least_points, np.maximum(1.0 - share / self.hidden, 0.0), 0.0)
        return float(np.max(np.where(gone, 1.0, lacking)))

    def _shares(self, evidence: Sequence[ContourEvidence], parts: int) -> tuple[Float, Float]:
        """(S,) shares of the contour points that tell inside from outside, and how many points there are."""
        seen, telling = np.zeros(parts), np.zeros(parts)
        for found in evidence:
            part, outer = found.contour.part, found.contour.outer
            seen += np.bincount(part[outer], minlength=parts)
            telling += np.bincount(part[outer & (found.contrast > self.contrast)], minlength=parts)
        return np.where(seen > 0, telling / np.maximum(seen, 1), 1.0), seen

    def yielded(self, terms: Sequence[Term], evidence: ContourEvidence, gone: Bool, back: Bool) -> list[Term]:
        """The terms of a view, less what they say of parts that it does not show.

        Parts that are just `back` (S,) have their whole say, so that they find their place again.
        """
        trust = np.where(back, 1.0, self.trust([evidence], gone))
        return list(terms) if np.all(trust == 1.0) else [_trusted(term, trust) for term in terms]


def above(body: Body) -> Bool:
    """(S, S) which segments each one hangs from: itself, and those above it up to the root, which is not among them."""
    chain = body.chain
    return np.all(chain <= chain[:, None], axis=2) & np.any(chain, axis=1)


def _trusted(term: Term, trust: Float) -> Term:
    if not isinstance(term, (PhotometricTerm, PointNormalTerm, PointRayTerm)):
        return term
    return replace(term, weight=term.weight * trust[term.points.part])
