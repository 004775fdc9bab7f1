"""What a contour cue hands back for one view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from twistcap._typing import Float
from twistcap.cues.view import View
from twistcap.render import ContourPoints, RenderedView
from twistcap.terms import Term


@dataclass(frozen=True)
class ContourEvidence:
    """A term for the solve, and what it was made from.

    Attributes:
        term: pulls the contour points to where the image has them.
        contour: N points that were looked at.
        displacement: (N,) px outward to where the contour was found.
        contrast: (N,) nats by which the image tells inside from outside there; 0 where it says nothing.
    """

    term: Term
    contour: ContourPoints
    displacement: Float
    contrast: Float


class ContourCue(Protocol):
    """A method that finds the body's contour in an image near where the body was rendered."""

    def measure(
        self, view: View, seen: RenderedView, contour: ContourPoints, coarse: float, colours: Float
    ) -> ContourEvidence:
        """Evidence of one view; `coarse` ≥ 1 widens the capture range in early alternations.

        `colours` (S, 1 + 2C) is what `Appearance.of` remembers of each part.
        """
        ...
