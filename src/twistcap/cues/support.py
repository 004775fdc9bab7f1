"""Whether the images still support the pose, from all cues' agreement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float
from twistcap.cues.observation import Agreement
from twistcap.ranges import Checked, Count, Share


@dataclass(frozen=True)
class SupportRule(Checked):
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

    least_points: Count = 12
    least: Share = 0.35
    memory: Share = 0.8
    chance: Share = 0.12
    sure: Share = 0.5

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
