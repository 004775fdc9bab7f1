"""What a contour cue hands back for one view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from twistcap._typing import Float, Float32
from twistcap.cues.view import View
from twistcap.region.matching import Displacement
from twistcap.render import ContourPoints, RenderedView
from twistcap.terms import Term


@dataclass(frozen=True)
class Segmentation:
    """An evolved outline in one view.

    Attributes:
        points, normals: (M, 2) px on it, and its outward unit normals.
        log_ratio: (H, W) log density ratio inside to outside that drove it.
        width: px, standard deviation of the band in which it was driven.
        phi: (H, W) the level set itself, positive inside.
        flow: displacements from the rendered body's outline to it, where they were asked for.
    """

    points: Float
    normals: Float
    log_ratio: Float32
    width: float
    phi: Float32
    flow: Displacement | None = None


@dataclass(frozen=True)
class ContourEvidence:
    """A term for the solve, and what it was made from.

    Attributes:
        term: pulls the contour points to where the image has them.
        contour: N points that were looked at.
        displacement: (N,) px outward to where the contour was found.
        contrast: (N,) nats by which the image tells inside from outside there; 0 where it says nothing.
        segmentation: of the level set.
    """

    term: Term
    contour: ContourPoints
    displacement: Float
    contrast: Float
    segmentation: Segmentation | None = None


class ContourCue(Protocol):
    """A method that finds the body's contour in an image near where the body was rendered."""

    @property
    def alternations(self) -> int:
        """Fine alternations of correspond and update in each frame."""
        ...

    @property
    def slip(self) -> float:
        """Share of its running mean below which a part's agreement calls for coarse alternations."""
        ...

    def measure(
        self, view: View, seen: RenderedView, contour: ContourPoints, coarse: float, colours: Float,
        earlier: ContourEvidence | None = None,
    ) -> ContourEvidence:  # fmt: skip
        """Evidence of one view; `coarse` ≥ 1 widens the capture range in early alternations.

        `colours` (S, 1 + 2C) is what `Appearance.of` remembers of each part; `earlier` what was found before with the
        same rendered body, if anything.
        """
        ...
