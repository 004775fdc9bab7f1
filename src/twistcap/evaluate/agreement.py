"""Agreement of two systems as validation papers report it: bias and limits, RMSE, correlation, CMC."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float
from twistcap.evaluate import metrics

_LIMITS = 1.96  # standard deviations
_STILL = 1e-6  # standard deviation of a waveform that does not move, but for the rounding of a file


@dataclass(frozen=True)
class Agreement:
    """Of one coordinate in two systems, in its unit; NaN where it is not defined.

    Attributes:
        name: of the coordinate.
        frames: in which both know it.
        bias, lower, upper: mean difference (first less second) and the limits of agreement, ±1.96 standard deviations
            about it (Bland and Altman 1986, DOI 10.1016/S0140-6736(86)90837-8).
        rmse, rmse_offset_removed: root mean square of the differences, and of them less the bias.
        correlation: Pearson's r; NaN where one of them does not move.
        cmc: coefficient of multiple correlation of the two waveforms (Ferrari et al. 2010, DOI
            10.1016/j.gaitpost.2009.09.009); NaN where they differ more than they move.
    """

    name: str
    frames: int
    bias: float
    lower: float
    upper: float
    rmse: float
    rmse_offset_removed: float
    correlation: float
    cmc: float


def agreements(names: Sequence[str], differences: Float, reference: Float) -> list[Agreement]:
    """Of coordinates (C) whose differences and reference values are (N, C), in one unit; NaN where not known."""
    return [_agreement(name, d, r) for name, d, r in zip(names, differences.T, reference.T, strict=True)]


def _agreement(name: str, difference: Float, reference: Float) -> Agreement:
    both = np.isfinite(difference) & np.isfinite(reference)
    d, theirs = difference[both], reference[both]
    if len(d) < 2:
        nan = float("nan")
        return Agreement(name, len(d), nan, nan, nan, nan, nan, nan, nan)
    bias, spread = float(d.mean()), float(d.std(ddof=1))
    ours = theirs + d
    moving = min(ours.std(), theirs.std()) > _STILL
    return Agreement(
        name, len(d), bias, bias - _LIMITS * spread, bias + _LIMITS * spread, float(np.sqrt(np.mean(d**2))),
        float(d.std()), float(np.corrcoef(ours, theirs)[0, 1]) if moving else float("nan"), _cmc(ours, theirs),
    )  # fmt: skip


def _cmc(one: Float, other: Float) -> float:
    """Of P = 2 waveforms over F frames: the variance between them against that of all about their grand mean."""
    waves = np.stack([one, other])
    within = np.sum((waves - waves.mean(axis=0)) ** 2) / waves.shape[1]
    total = np.sum((waves - waves.mean()) ** 2) / (waves.size - 1)
    return float(np.sqrt(1.0 - within / total)) if total > 0 and within <= total else float("nan")


@dataclass(frozen=True)
class Distance:
    """Of one joint in two systems, mm: means over the frames in which both know it."""

    name: str
    mean: float
    rmse: float
    p95: float
    offset_removed: float


def distances(names: Sequence[str], raw: Float, offset_removed: Float) -> list[Distance]:
    """Of joints (K) whose distances are (N, K) mm, raw and with the constant offset removed."""
    return [
        Distance(name, metrics.mean_known(d), float(np.sqrt(metrics.mean_known(d**2))),
                 metrics.percentile_known(d, 95), metrics.mean_known(rest))
        for name, d, rest in zip(names, raw.T, offset_removed.T, strict=True)
    ]  # fmt: skip
