"""Error measures: arrays in, numbers out. Angles in rad come out in degrees, metres come out in millimetres.

A NaN in the reference means "not known there" and is left out; a non-finite *estimate* counts as infinitely wrong, so
that no answer is never better than a wrong one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from twistcap.arrays import AnyArray, Bool, Float, Int
from twistcap.camera.projection import project
from twistcap.region.compare import iou as iou
from twistcap.render.raster import rasterise

SIDES = ("r", "l")
JOINT_CENTRES = tuple(f"{joint}_{s}" for s in SIDES for joint in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"))
"""Landmarks that count as joints; toes, heels and the face do not."""

_KHE = ("knee_angle", "hip_flexion", "hip_adduction", "elbow_flex")
KHE_COORDINATES = tuple(f"{name}_{s}" for s in SIDES for name in _KHE)
"""Coordinates of the knee-hip-elbow error, the one number by which the project compares trackers."""

LOST_FRAME_MM = 150.0  # a frame is lost when any joint has a larger error than this
LOST_SEQUENCE_MM = 20.0  # a sequence is lost when its mean joint error is above this


class Row(TypedDict):
    """One line of a table, as `evaluate`, `reproduce` and `bench` print it in JSON."""

    case: str
    metric: str
    value: float | None
    unit: str
    target: str | None
    holds: bool | None
    seeds: list[float | None] | None
    lost: int | None


def row(
    case: str, metric: str, value: float, unit: str, *, at_most: float | None = None, at_least: float | None = None,
    seeds: Sequence[float] | None = None, lost: int | None = None,
) -> Row:  # fmt: skip
    """A table line; its target is `at_most` or `at_least`, and a value that is not finite never holds. `seeds` are the
    values on every seed that `value` sums up, `lost` how many of those sequences were lost."""
    finite = math.isfinite(value)
    target, holds = None, None
    if at_most is not None:
        target, holds = f"≤ {at_most:g}", finite and value <= at_most
    elif at_least is not None:
        target, holds = f"≥ {at_least:g}", finite and value >= at_least
    known = None if seeds is None else [seed if math.isfinite(seed) else None for seed in seeds]
    number = float(value) if finite else None  # JSON knows neither NaN nor infinity
    return Row(case=case, metric=metric, value=number, unit=unit, target=target, holds=holds, seeds=known, lost=lost)


def differences(estimate: Float, reference: Float) -> Float:
    """Estimate minus reference; NaN where the reference is unknown, infinite where only the estimate is."""
    out = estimate - reference
    return np.where(np.isfinite(reference), np.where(np.isfinite(estimate), out, np.inf), np.nan)


def angle_differences_deg(estimate: Float, reference: Float) -> Float:
    """Signed angle differences (N, J) in degrees, wrapped into [-180, 180), from angles (N, J) in rad."""
    d = np.degrees(differences(estimate, reference))
    finite = np.isfinite(d)
    return np.where(finite, (np.where(finite, d, 0.0) + 180.0) % 360.0 - 180.0, d)


def without_offset(difference: Float) -> Float:
    """Differences (N, ...) less their mean over the frames, as if the two frames of reference agreed. Frames that are
    not finite do not count in the mean and stay as they are."""
    finite = np.isfinite(difference)
    return difference - np.where(finite, difference, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)


def distances_mm(difference: Float) -> Float:
    """Lengths (N, L) in mm of position differences (N, L, 3) in m; NaN where any component is unknown."""
    return 1000.0 * np.linalg.norm(difference, axis=-1)


def mean_known(values: AnyArray) -> float:
    """Mean of the values that are not NaN; NaN (without a warning) where there is none."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else math.nan


def percentile_known(values: AnyArray, percent: float) -> float:
    """Percentile of the values that are not NaN, the next higher value where it falls between two infinities."""
    known = np.sort(values[~np.isnan(values)], axis=None)
    if not known.size:
        return math.nan
    finite = np.where(np.isfinite(known), known, np.finfo(float).max / 4)
    value = float(np.percentile(finite, percent))
    return value if value < 1e300 else math.inf


def khe_deg(difference_deg: Float, names: Sequence[str]) -> float:
    """Mean absolute error in degrees over those `KHE_COORDINATES` of both sides that `names` has."""
    columns = [k for k, name in enumerate(names) if name in KHE_COORDINATES]
    return mean_known(np.abs(difference_deg[:, columns]))


def lost_frames(errors_mm: Float) -> Bool:
    """(N,) whether any joint of (N, L) is more than `LOST_FRAME_MM` off; unknown joints do not count."""
    return np.any(errors_mm > LOST_FRAME_MM, axis=1)


def lost_sequence(errors_mm: Float) -> bool:
    """Whether the mean joint error over the sequence (N, L) is above `LOST_SEQUENCE_MM`."""
    return mean_known(errors_mm) > LOST_SEQUENCE_MM


def silhouette(P: Float, vertices: Float, faces: Int, size: tuple[int, int]) -> Bool:
    """(H, W) mask of a surface (V, 3) m seen by a pinhole camera (3, 4) with an image of (width, height)."""
    pixels, inverse_depth = project(np.ascontiguousarray(P), vertices)
    face_index, _ = rasterise(pixels, inverse_depth, faces, (0, 0), size)
    return face_index >= 0


def z_scores(error: Float, covariance: Float) -> Float:
    """Errors (N, D) in units of their own standard deviation, from covariances (N, D, D). Coordinates of zero variance
    (held fixed) give NaN."""
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    known = variance > 0
    return np.where(known, error / np.sqrt(np.where(known, variance, 1.0)), np.nan)


def within_sigmas(z: Float, sigmas: float) -> float:
    """Fraction of z-scores inside ± `sigmas`: of normal errors 68.3 % are inside 1, 95.4 % inside 2."""
    known = z[np.isfinite(z)]
    return float(np.mean(np.abs(known) <= sigmas)) if known.size else math.nan
