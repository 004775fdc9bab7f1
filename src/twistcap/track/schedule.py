"""How often a frame's images are looked at, and how coarsely."""

from __future__ import annotations

from dataclasses import dataclass, replace

from twistcap.cues.observation import Level
from twistcap.ranges import Checked, Count, Positive


@dataclass(frozen=True)
class Schedule(Checked):
    """Fine where the prediction was good; where it was not, coarse until the body has settled, then fine again.

    Attributes:
        first: fine alternations in the first frame, which starts from a given pose.
        fine: fine alternations in every other frame.
        slip: fraction of its running mean below which a part's agreement calls for coarse alternations.
        coarse: factor on the cues' reach in coarse alternations.
        coarse_rounds: coarse alternations at most; one is enough where the prediction was good.
        surprise: m by which the first, fine alternation moves the contour where the prediction was not good enough.
        settled: m that the contour may still move in a coarse alternation that is the last one.
        render_after: m that the contour may have moved, all in all, before the body is rendered anew.
        contour_spacing: m on the body between contour samples.
    """

    first: Count = 10
    fine: int = 1
    slip: float = 0.7
    coarse: Positive = 3.0
    coarse_rounds: int = 5
    surprise: float = 0.0085
    settled: float = 0.006
    render_after: float = 0.008
    contour_spacing: float = 0.032

    @property
    def afresh(self) -> Schedule:
        """For a hypothesis: no more looks than any frame has."""
        return replace(self, first=self.fine + 1)

    @property
    def fine_level(self) -> Level:
        """Of fine alternations."""
        return Level()

    @property
    def coarse_level(self) -> Level:
        """Of coarse ones."""
        return Level(self.coarse, fine=False)
