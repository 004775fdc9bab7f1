"""Robust losses ρ(r²/σ²) as (energy, weight) pairs for iteratively reweighted least squares."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Float


def huber(residual: Float, scale: Float | float) -> tuple[Float, Float]:
    """Quadratic up to `scale`, linear beyond: (energy in residual², weight in (0, 1])."""
    size = np.abs(residual)
    inside = size <= scale
    energy = np.where(inside, 0.5 * size**2, scale * (size - 0.5 * scale))
    return energy, np.where(inside, 1.0, scale / np.maximum(size, 1e-300))


def cauchy(residual: Float, scale: Float | float) -> tuple[Float, Float]:
    """Lorentzian, down-weights large residuals: (energy in residual², weight in (0, 1])."""
    ratio = (residual / scale) ** 2
    return 0.5 * scale**2 * np.log1p(ratio), 1.0 / (1.0 + ratio)


def geman_mcclure(squares: Float, reach: float) -> tuple[Float, Float]:
    """``½ c² r² / (c² + r²)``, whose weight falls to 0 for gross errors: (energy, weight in [0, 1]) of r² and c."""
    inner = reach**2 / (reach**2 + squares)
    return 0.5 * squares * inner, inner**2


@njit(cache=True, nogil=True)
def weighted_cauchy(residual: Float, weight: Float, scale: float) -> tuple[float, Float]:
    """Σ weight · energy of `cauchy` over residuals (N,), and the weights (N,) times its own."""
    energy, out = 0.0, np.zeros(len(residual))
    for n in range(len(residual)):
        if weight[n] == 0.0:
            continue
        ratio = (residual[n] / scale) ** 2
        energy += weight[n] * np.log1p(ratio)
        out[n] = weight[n] / (1.0 + ratio)
    return 0.5 * scale * scale * energy, out


def weighted_cauchy_reference(residual: Float, weight: Float, scale: float) -> tuple[float, Float]:
    """Readable twin of `weighted_cauchy`; residuals of weight 0 may be NaN."""
    energy, robust = cauchy(np.where(weight == 0.0, 0.0, residual), scale)
    return float(weight @ energy), weight * robust
