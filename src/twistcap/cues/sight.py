"""What a frame's fit was made from: what each camera contributes, and the answer so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap._typing import Float, Int
from twistcap.body import Posed
from twistcap.cues.evidence import ContourEvidence
from twistcap.cues.view import View
from twistcap.render import ContourPoints, RenderedView
from twistcap.solve import Dense, Solution, Status
from twistcap.terms import Term


@dataclass(frozen=True)
class Sight:
    """What one camera contributes to one alternation."""

    camera_index: int
    view: View
    seen: RenderedView
    contour: ContourPoints


@dataclass(frozen=True)
class Fit:
    """State of a frame between alternations: the answer so far, and what it was made from.

    Attributes:
        result: the answer.
        sights: of each view.
        terms: of all views.
        found: the contour of each view.
        tallies: per view, how many contour points of each part agree (S,), and how many it has (S,).
        moved: m by which the last update moved the contour.
        strayed: m since the body was rendered.
    """

    result: Solution[Posed, Dense]
    sights: Sequence[Sight] = ()
    terms: Sequence[Term] = ()
    found: Sequence[ContourEvidence] = ()
    tallies: Sequence[tuple[Float, Int]] = ()
    moved: float = 0.0
    strayed: float = 0.0

    def judged(self, settled: float) -> Fit:
        """The fit with the status of the whole frame: it has converged if its last step moved less than `settled` m."""
        if self.result.status == "failed":
            return self
        status: Status = "converged" if self.moved < settled else "max_iterations"
        return replace(self, result=replace(self.result, status=status))


def contour_moved(sights: Sequence[Sight], posed: Posed) -> float:
    """How far the contour has moved on the body since it was measured, m: of all but the farthest fiftieth."""
    if not sights:
        return 0.0
    steps = np.concatenate([s.contour.moved_by(posed, s.view.camera.P) / s.seen.px_per_m for s in sights])
    k = int(0.98 * len(steps))
    return float(np.partition(steps, k)[k]) if len(steps) else 0.0
