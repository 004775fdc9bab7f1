"""Recurrences of the last poses in the person's own past: a cyclic motion is predicted best by its own last cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float
from twistcap.errors import InputError
from twistcap.motion.matching import Match
from twistcap.ranges import Checked, Count

OWN = -1
"""The clip of a match in the person's own past."""

LOOK_BACK = 120  # frames of the past that are searched
_SHORTEST = 12  # frames of a cycle, at least
_RATIO, _MARGIN = 3.0, 0.1  # in between, distances must exceed this multiple plus this margin (rad per pose)


@dataclass(frozen=True)
class RecurrenceRule(Checked):
    """What counts as a recurrence.

    Attributes:
        lead: factor on the distance of the library's best match up to which a recurrence is followed instead, since it
            has the person's own pace and style. 0 never follows one.
        poses: that are compared.
        count: cycles that are blended, at most.

    Raises:
        InputError: for numbers out of range.
    """

    lead: float = 1.5
    poses: int = 15
    count: Count = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (1 <= self.poses < LOOK_BACK and self.count >= 1 and self.lead >= 0.0):
            raise InputError(f"recurrence: poses must be 1 to {LOOK_BACK - 1}, count 1 or more, and lead not negative.")


def recurrences(q: Float, rule: RecurrenceRule) -> list[Match]:
    """Earlier places in q (n, K) rad whose poses are like the last ones, as matches in clip 0, the best first.

    Distances are means over the poses, rad.
    """
    poses = q[max(0, len(q) - LOOK_BACK) :]
    last = len(poses) - rule.poses - 1  # the longest lag with neighbours on both sides
    if rule.lead <= 0 or last < _SHORTEST:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(poses, rule.poses, axis=0)[::-1]  # by lag
    apart = np.linalg.norm(windows - windows[0], axis=1).mean(axis=1)
    farthest = np.maximum.accumulate(apart)
    lags = np.arange(_SHORTEST, last + 1)
    returned = farthest[lags] >= _RATIO * apart[lags] + _MARGIN
    nearest = (apart[lags] <= apart[lags - 1]) & (apart[lags] <= apart[lags + 1])
    found = sorted(lags[returned & nearest], key=lambda lag: float(apart[lag]))
    return [Match(0, float(len(q) - 1 - lag), 1.0, float(apart[lag])) for lag in found[: rule.count]]
