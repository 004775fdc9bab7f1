"""Where the last poses recur in the person's own past: a cyclic motion is foretold best by its own last cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap._typing import Float
from twistcap.errors import InputError
from twistcap.motion.matching import Match

OWN = -1
"""The clip of a match in the person's own past, where it is told beside those of a library."""


@dataclass(frozen=True)
class RecurrenceRule:
    """What counts as a recurrence.

    Attributes:
        lead: how much worse than the library's best match (factor on its distance) a recurrence may be and still be
            followed instead: it has the person's own pace and style. 0 never follows one.
        poses: that are compared.
        look_back: frames of the past that are searched.
        shortest: frames of a cycle.
        away: factor by which the motion must in between have been farther off than it is when it recurs; one that has
            hardly moved is always like itself.
        stir: rad per pose by which it must have been farther off besides.
        count: cycles that are blended, at most.
    """

    lead: float = 1.5
    poses: int = 15
    look_back: int = 120
    shortest: int = 12
    away: float = 3.0
    stir: float = 0.1
    count: int = 3

    def __post_init__(self) -> None:
        whole = min(self.poses, self.shortest, self.count) >= 1 and self.look_back > self.poses
        if not (whole and self.lead >= 0.0 and self.away >= 1.0 and self.stir >= 0.0):
            raise InputError(
                "recurrence: poses, shortest and count must be 1 or more, look_back more than poses, "
                "lead and stir not negative, away 1 or more."
            )


def recurrences(q: Float, rule: RecurrenceRule) -> list[Match]:
    """Where poses like the last ones of q (n, K) rad end in q itself, as clip 0; the most alike first.

    Distances are means over the poses, rad.
    """
    poses = q[max(0, len(q) - rule.look_back) :]
    last = len(poses) - rule.poses - 1  # the longest lag that is surrounded by others
    if rule.lead <= 0 or last < rule.shortest:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(poses, rule.poses, axis=0)[::-1]  # by lag
    apart = np.linalg.norm(windows - windows[0], axis=1).mean(axis=1)
    farthest = np.maximum.accumulate(apart)
    lags = np.arange(rule.shortest, last + 1)
    returned = farthest[lags] >= rule.away * apart[lags] + rule.stir
    nearest = (apart[lags] <= apart[lags - 1]) & (apart[lags] <= apart[lags + 1])
    found = sorted(lags[returned & nearest], key=lambda lag: float(apart[lag]))
    return [Match(0, float(len(q) - 1 - lag), 1.0, float(apart[lag])) for lag in found[: rule.count]]
