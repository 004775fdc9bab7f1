"""Bringing another system's clock and world to ours, where nobody has measured them together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from twistcap import se3
from twistcap.adjust.first_pose.triangulate import rigid_fit
from twistcap.arrays import Float
from twistcap.errors import InputError, check
from twistcap.evaluate import metrics
from twistcap.evaluate.load import Reference
from twistcap.evaluate.ours import shared_angles
from twistcap.io.markers import TO_FILE, WorldAxes
from twistcap.io.result import Result

_WIDEST = 2.0  # s
_LEAST_FRAMES = 10
_LEAST_SHARE = 0.5  # of the frames that overlap best
_AS_GOOD = 0.01  # of the variance
_STILL = 1e-6  # rad or m/s; what moves less tells no time
_FAR = 250.0  # mm, the median from which on the world's axes are doubted
_CLEARLY = 1 / 3  # of that error, below which other axes are named


def aligned(result: Result, reference: Reference, clock: bool, world: bool) -> Reference:
    """The reference with its clock, its world, or both brought to those of a result; what was done is in its notes.

    Raises InputError as `clock_offset` and `world_motion`.
    """
    body, notes = result.body, list(reference.notes)
    marks = result.landmarks
    points = np.full((len(marks), len(reference.names), 3), np.nan)
    for k, name in enumerate(reference.names):
        if name in body.landmarks.names:
            points[:, k] = marks[:, body.landmarks.index(name)]
    if clock:
        ours = shared_angles(result, reference.coordinate_names)
        columns = [reference.coordinate_names.index(name) for name in ours.names]
        picked = replace(reference, coordinate_names=ours.names, angles=reference.angles[:, columns])
        offset = clock_offset(result.times, ours.values, points, picked)
        reference = replace(reference, times=reference.times + offset)
        notes.append(f"{offset:.4f} s were added to the reference's clock")
    if world and reference.names:
        R, shift = world_motion(points, reference.at(result.times)[0])
        reference = replace(reference, points=reference.points @ R.T + shift)
        turn = np.degrees(np.linalg.norm(se3.log_rotation(R)))
        notes.append(f"the reference was turned by {turn:.1f}° and moved to lie nearest")
    return replace(reference, notes=tuple(notes))


def clock_offset(times: Float, angles: Float, points: Float, reference: Reference) -> float:
    """Seconds to add to the reference's clock, between −2 and 2.

    `angles` (N, C) rad and `points` (N, P, 3) m are ours at `times` (N,) s, in the order of the reference's coordinates
    and points, NaN where we lack one. Angles are compared, or speeds of points where there are none: neither depends on
    the world. The offset is that of least difference, each signal less its mean and by its own variance; of several
    that are as good, since steps repeat, the smallest. Raises InputError where nothing moves, or fewer than 10 frames
    overlap.
    """
    few = f"the result has {len(times)} frames, and it takes {_LEAST_FRAMES} to find a clock; give --time-offset"
    check("alignment", len(times) >= _LEAST_FRAMES, few)
    by_angle = angles.shape[1] > 0
    ours = angles if by_angle else _speeds(times, points)

    def theirs(offset: float) -> Float:
        shifted = replace(reference, times=reference.times + offset)
        at_points, at_angles = shifted.at(times)
        return at_angles if by_angle else _speeds(times, at_points)

    step = 0.5 * float(np.median(np.diff(times)))
    offsets = np.arange(-_WIDEST, _WIDEST + step, step)
    costs, shares = (np.array(v) for v in zip(*[_cost(ours, theirs(float(o))) for o in offsets], strict=True))
    usable = shares >= max(_LEAST_SHARE * shares.max(), _LEAST_FRAMES / len(times))
    if not np.any(usable & np.isfinite(costs)):
        raise InputError("alignment: the reference and the result have no movement in common; give --time-offset.")
    held = np.pad(np.where(usable, costs, np.inf), 1, constant_values=np.inf)
    low = (held[1:-1] <= held[:-2]) & (held[1:-1] <= held[2:]) & (held[1:-1] <= held.min() + _AS_GOOD)
    best = float(min(offsets[low], key=abs))
    fine = minimize_scalar(lambda o: _cost(ours, theirs(o))[0], bounds=(best - step, best + step), method="bounded")
    return float(fine.x)


def _cost(ours: Float, theirs: Float) -> tuple[float, float]:
    """Mean over the signals of the variance of the difference by that of ours; share of the frames that both know."""
    both = np.isfinite(ours) & np.isfinite(theirs)
    counts = both.sum(axis=0)
    n = np.maximum(counts, 1)

    def variance(values: Float) -> Float:
        held = np.where(both, values, 0.0)
        return np.where(both, (held - held.sum(axis=0) / n) ** 2, 0.0).sum(axis=0) / n

    moved = variance(ours)
    telling = (moved > _STILL**2) & (counts > 2)
    if not telling.any():
        return np.inf, 0.0
    ratio = variance(np.where(both, ours - theirs, 0.0))[telling] / moved[telling]
    return float(ratio.mean()), float(counts.max()) / len(ours)


def _speeds(times: Float, points: Float) -> Float:
    """(N, P) m/s."""
    return np.linalg.norm(np.gradient(points, times, axis=0), axis=2)


def world_motion(ours: Float, theirs: Float) -> tuple[Float, Float]:
    """Rotation (3, 3) and shift (3,) m that bring their points (N, P, 3) nearest to ours, by least squares. Raises
    InputError for fewer than three known points.
    """
    both = np.isfinite(ours).all(axis=2) & np.isfinite(theirs).all(axis=2)
    check("alignment", both.sum() >= 3, "fewer than three points of the reference are known; leave out --register")
    motion = rigid_fit(theirs[both], ours[both], np.ones(both.sum()))
    return motion[:3, :3], motion[:3, 3]


def better_axes(ours: Float, theirs: Float, axes: WorldAxes) -> str:
    """A note that names other axes of the reference's file, where its points lie far off and would be near with those;
    "" otherwise.

    `ours` and `theirs` are (N, K, 3) m, theirs NaN where unknown and read with `axes`, see `io.markers`.
    """
    off = {name: _median_mm(ours, theirs @ TO_FILE[axes].T @ to_file) for name, to_file in TO_FILE.items()}
    best, now = min(off, key=lambda name: off[name]), off[axes]
    if not (now > _FAR and off[best] < _CLEARLY * now):
        return ""
    return f"the points are {now:.0f} mm off; with --axes {best} they would be {off[best]:.0f} mm off"


def _median_mm(ours: Float, theirs: Float) -> float:
    return metrics.percentile_known(metrics.distances_mm(metrics.differences(ours, theirs)), 50)
