"""A limb that was elsewhere when more cameras saw it again had gone astray while one alone did.

One camera hardly tells how far away a limb is, and an arm that is bent toward it looks like one that is bent away. No
picture tells which frames were wrong. What is known is how far the limb was off in the end; before, its error is taken
to have grown as that of an unknown acceleration does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body.limbs import limbs
from twistcap.estimate import Estimate
from twistcap.hindsight.passed import Passed
from twistcap.search.flag import FEW, JUMPED, LOST, flag_groups
from twistcap.search.memory import LostMemory
from twistcap.track import Model, State

_FEWEST = 3  # frames; in fewer hardly any limb goes far astray


def doubted(model: Model, before: State, state: State, passed: Sequence[Passed], estimate: Estimate) -> list[Estimate]:
    """Estimates of the last frames, the oldest first, with what is doubtful of limbs that have come back elsewhere.

    Args:
        model: of the track.
        before, state: before and after the frame.
        passed: frames before it, the latest last.
        estimate: of the frame.
    """
    earlier, now = _signs(before), _signs(state)
    if earlier is None or now is None or not estimate.seen:
        return []
    off = now[:-1, JUMPED]
    back = (now[:-1, FEW] < earlier[:-1, FEW]) & (off > np.maximum(LOST, earlier[:-1, JUMPED]))
    alone = list(takewhile(lambda one: one.estimate.single_view, reversed(passed)))[::-1]
    if not back.any() or len(alone) < _FEWEST:
        return []
    shares = (np.arange(1.0, len(alone) + 1.0) / len(alone)) ** 2
    return [
        _doubted(model, one.estimate, share * np.where(back, off, 0.0), share * _way(model, alone[-1], estimate, back))
        for one, share in zip(alone, shares, strict=True)
    ]


def _signs(state: State) -> Float | None:
    return next((memory.signs for memory in state.searches.values() if isinstance(memory, LostMemory)), None)


def _way(model: Model, last: Passed, estimate: Estimate, back: Bool) -> Float:
    """(6 + J,) of limbs (G − 1,), from where they were in the last frame to where they are."""
    own = np.any([limb for limb, moved in zip(limbs(model.body), back, strict=True) if moved], axis=0)
    return np.where(own, estimate.pose.minus(last.estimate.pose), 0.0)


def _doubted(model: Model, estimate: Estimate, off: Float, way: Float) -> Estimate:
    """An estimate whose limbs may be off by so many m (G − 1,), and its pose by a step (6 + J,). Limbs that are not
    judged stay so.
    """
    claimed = replace(estimate, covariance=estimate.covariance + np.outer(way, way))
    own, likely = estimate.part_probability, (flag_groups(model.body)[:-1].T * (off / (off + LOST))).max(axis=1)
    if own is None or np.isnan(own).all():
        return claimed
    by_part = np.where(np.isnan(own), own, np.maximum(own, likely))
    probability = max(estimate.probability, float(likely[~np.isnan(own)].max()))
    return replace(claimed, part_probability=by_part, probability=probability, lost=probability >= model.flag.lost)
