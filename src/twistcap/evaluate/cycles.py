"""Joint angles over the gait cycle of a result: mean and standard deviation of each side's strides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from twistcap.arrays import Float
from twistcap.evaluate.gait import SIDES, Gait, cycles, facing, facing_covariances
from twistcap.evaluate.smoothing import butterworth
from twistcap.io.coordinates import Angles, Coordinates, coordinates_of
from twistcap.io.result import Result


@dataclass(frozen=True)
class Cycle:
    """A coordinate over the strides of a side: mean and standard deviation (101,), degrees, at 0, 1 … 100 %."""

    coordinate: str
    side: str
    mean: Float
    deviation: Float
    strides: int


def cycles_of(found: Gait, result: Result, cutoff: float = 6.0, angles: Angles = "opensim") -> Mapping[str, Cycle]:
    """Each side's own coordinates, and those of the trunk, over its strides, by name and side (``knee_angle_r``).

    Angles are filtered below `cutoff` (Hz) and those of the pelvis are as if the walk went along x. A side without
    strides has none. Raises InputError for unknown `angles`.
    """
    table, smooth, _ = walking_angles(found, result, cutoff, angles)
    out: dict[str, Cycle] = {}
    for side in SIDES:
        own = own_angles(table, side)
        curves = cycles(found, result.times, smooth[:, own], side)
        for c, k in enumerate(own if len(curves) else []):
            name, mean = table.names[k], curves[..., c].mean(axis=0)
            deviation = curves[..., c].std(axis=0, ddof=1 if len(curves) > 1 else 0)
            out[f"{name.removesuffix('_' + side)}_{side}"] = Cycle(name, side, mean, deviation, len(curves))
    return out


def walking_angles(
    found: Gait, result: Result, cutoff: float = 6.0, angles: Angles = "opensim"
) -> tuple[Coordinates, Float, Float]:
    """The coordinates of a walk as if it went along x, their filtered values and their sigmas (N, C), degrees and m."""
    covariances = facing_covariances(found, result.covariances)
    table = coordinates_of(result.body, facing(found, result.poses), covariances, angles)
    values, sigmas = table.in_degrees
    return table, butterworth(values, 1.0 / found.frame, cutoff, result.known), sigmas


def own_angles(table: Coordinates, side: str) -> list[int]:
    """Columns of the angles of a side, and of the trunk."""
    return [k for k, name in enumerate(table.names) if table.turning[k] and _side(name) in (side, "")]


def _side(name: str) -> str:
    return name[-1] if name[-2:] in ("_r", "_l") else ""
