"""Region densities on the pixel grid: what log-likelihood ratio inside to outside each pixel has.

Channels are taken as independent (Brox, Rosenhahn and Cremers, eq. 11.8); variances are those of the squared
deviations, where the paper omits the square.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import erf

from twistcap._typing import Float32


def heaviside(phi: Float32, width: float) -> Float32:
    """Smooth step: the error function of `phi` px, whose derivative is a Gaussian of standard deviation `width` px."""
    return (0.5 * (1.0 + erf(phi / (np.sqrt(2.0) * width)))).astype(np.float32)


def global_log_ratio(channels: Float32, inside: Float32, floor: float) -> Float32:
    """(H, W) Σ_j log p₁/p₂ under one Gaussian per region and channel. `inside` (H, W) is the region's membership."""
    out = np.zeros(inside.shape, dtype=np.float32)
    for j in range(channels.shape[2]):
        values = channels[..., j]
        mu_in, var_in = _weighted_gaussian(values, inside, floor)
        mu_out, var_out = _weighted_gaussian(values, 1.0 - inside, floor)
        out += _log_ratio(values, mu_in, var_in, mu_out, var_out)
    return out


def local_log_ratio(channels: Float32, inside: Float32, rho: float, floor: float, prior_mass: float) -> Float32:
    """(H, W) Σ_j log p₁/p₂ under Gaussians estimated in a window of standard deviation `rho` px about each pixel.

    The window is a box of that deviation, which costs the same at any size. Where a region hardly reaches into the
    window, its global statistics take over smoothly, with the weight of `prior_mass` (share of the window).
    """
    size = max(3, 2 * round(rho * np.sqrt(3.0)) + 1)
    out = np.zeros(inside.shape, dtype=np.float32)
    mass_in, mass_out = _box(inside, size), _box(1.0 - inside, size)
    for j in range(channels.shape[2]):
        values = channels[..., j]
        first, second = _box(values, size), _box(values * values, size)
        first_in, second_in = _box(values * inside, size), _box(values * values * inside, size)
        g_in = _weighted_gaussian(values, inside, floor)
        g_out = _weighted_gaussian(values, 1.0 - inside, floor)
        local_in = _blended(mass_in, first_in, second_in, g_in, floor, prior_mass)
        local_out = _blended(mass_out, first - first_in, second - second_in, g_out, floor, prior_mass)
        out += _log_ratio(values, *local_in, *local_out)
    return out


def _box(values: Float32, size: int) -> Float32:
    return cv2.blur(values, (size, size), borderType=cv2.BORDER_REFLECT_101)


def _weighted_gaussian(values: Float32, weight: Float32, floor: float) -> tuple[float, float]:
    mass = float(weight.sum()) + 1e-6
    mu = float((weight * values).sum()) / mass
    return mu, float((weight * (values - mu) ** 2).sum()) / mass + floor


def _blended(
    mass: Float32, first: Float32, second: Float32, fallback: tuple[float, float], floor: float, prior_mass: float
) -> tuple[Float32, Float32]:
    """Local mean and variance, with `prior_mass` of the global Gaussian mixed in."""
    mu0, var0 = fallback
    total = mass + prior_mass
    mu = (first + prior_mass * mu0) / total
    variance = (second + prior_mass * (var0 + mu0 * mu0)) / total - mu * mu
    return mu, np.maximum(variance, 0.0) + np.float32(floor)


def _log_ratio(
    values: Float32, mu_in: Float32 | float, var_in: Float32 | float, mu_out: Float32 | float, var_out: Float32 | float
) -> Float32:
    difference = (values - mu_out) ** 2 / var_out - (values - mu_in) ** 2 / var_in
    return (0.5 * (difference + np.log(var_out / var_in))).astype(np.float32)
