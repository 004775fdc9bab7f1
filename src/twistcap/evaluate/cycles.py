"""Joint angles over cycles of a result, gait's or those between events: mean, spread, and how sure the mean is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twistcap.arrays import Float
from twistcap.body.model import split_side
from twistcap.evaluate.filters import Filter, Filtered, Motion, filtered
from twistcap.evaluate.gait import SIDES, Gait, cycles, facing, facing_covariances, normalised
from twistcap.io.coordinates import Angles, Coordinates
from twistcap.io.result import Result


@dataclass(frozen=True)
class Cycle:
    """A coordinate over the cycles of a side: mean and standard deviation (101,), degrees, at 0, 1 … 100 %. Of a single
    cycle the deviation is NaN.

    `sigma` (101,), degrees, is what the covariance claims of a frame there. It does not fall with the number of
    strides: what the images leave open is much the same in each. `cutoff` is that of the filter (Hz). The side is empty
    where cycles are of no side.
    """

    coordinate: str
    side: str
    mean: Float
    deviation: Float
    sigma: Float
    strides: int
    cutoff: float


def walking_angles(found: Gait, result: Result, how: Filter | None = None, angles: Angles = "opensim") -> Filtered:
    """The coordinates of a walk as if it went along x, filtered. Raises InputError for unknown `angles`, or a cutoff
    that is too high."""
    covariances = facing_covariances(found, result.covariances)
    walk = Motion(result.body, result.times, facing(found, result.poses), covariances, result.known)
    return filtered(walk, how or Filter(), angles)


def cycles_of(found: Gait, times: Float, walk: Filtered) -> Mapping[str, Cycle]:
    """Each side's own angles, and those of the trunk, over its strides, by name and side (``knee_angle_r``). A side
    without strides has none."""
    out: dict[str, Cycle] = {}
    for side in SIDES:
        own = own_angles(walk.table, side)
        curves, sigmas = (cycles(found, times, columns[:, own], side) for columns in (walk.values, walk.sigmas))
        for k, cycle in zip(own, _cycles(walk, own, curves, sigmas, side), strict=False):
            out[f"{walk.table.names[k].removesuffix('_' + side)}_{side}"] = cycle
    return out


def cycles_between(limits: Float, times: Float, walk: Filtered) -> Mapping[str, Cycle]:
    """All angles from each of the `limits` (s) to the next, by name; cycles with frames that are not known are left
    out."""
    own = [k for k, turns in enumerate(walk.table.turning) if turns]
    spans = list(pairwise(limits.tolist()))
    curves, sigmas = (normalised(spans, times, columns[:, own]) for columns in (walk.values, walk.sigmas))
    missing = times[~np.isfinite(walk.values[:, own]).all(axis=1)]
    whole = np.array([not np.any((missing >= start) & (missing <= end)) for start, end in spans], np.bool_)
    known = np.isfinite(curves).all(axis=(1, 2)) & whole
    return {cycle.coordinate: cycle for cycle in _cycles(walk, own, curves[known], sigmas[known], "")}


def _cycles(walk: Filtered, own: Sequence[int], curves: Float, sigmas: Float, side: str) -> list[Cycle]:
    """Of curves and sigmas (cycles, 101, C) of the columns `own`; none where there are no cycles."""
    count = len(curves)
    if not count:
        return []
    means = curves.mean(axis=0)
    deviations = curves.std(axis=0, ddof=1) if count > 1 else np.full_like(means, np.nan)
    claimed = np.sqrt(np.mean(sigmas**2, axis=0))
    return [
        Cycle(walk.table.names[k], side, means[:, c], deviations[:, c], claimed[:, c], count, float(walk.cutoffs[k]))
        for c, k in enumerate(own)
    ]


def own_angles(table: Coordinates, side: str) -> list[int]:
    """Columns of the angles of a side, and of the trunk."""
    return [k for k, name in enumerate(table.names) if table.turning[k] and split_side(name)[1] in (side, "")]
