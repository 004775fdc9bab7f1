"""Total variation flow of an image of one or many channels by additive operator splitting (AOS).

``∂_t u_k = div(g ∇u_k)`` with one diffusivity ``g = 1/√(Σ_j |∇u_j|² + ε²)`` for all channels: an edge in one stops
diffusion in all. AOS (Weickert, ter Haar Romeny, Viergever, IEEE Trans. Image Processing 7(3), 1998,
doi:10.1109/83.661190) is stable for steps of any size.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import Float32


def tv_step(channels: Float32, tau: float, epsilon: float) -> Float32:
    """One step of `tau` (brightness · px) of the flow of channels (C, H, W), reflecting borders.

    The mean of two implicit steps of twice the size, down the columns and along the rows.
    """
    down = _implicit_down(channels, 2.0 * tau, epsilon)
    along = _implicit_down(_transposed(channels), 2.0 * tau, epsilon)
    return np.float32(0.5) * (down + _transposed(along))


def _transposed(channels: Float32) -> Float32:
    """(C, W, H) of (C, H, W), by OpenCV's transpose, which is faster than numpy's."""
    out = np.empty((len(channels), channels.shape[2], channels.shape[1]), dtype=np.float32)
    for channel, turned in zip(channels, out, strict=True):
        cv2.transpose(channel, dst=turned)
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp"})
def _implicit_down(u: Float32, tau: float, epsilon: float) -> Float32:
    """Solve ``x − τ ∂_y(g ∂_y x) = u`` (C, H, W) down all columns at once, by the Thomas algorithm."""
    C, height, width = u.shape
    size, least = np.float32(tau), np.float32(epsilon * epsilon)
    quarter, one, near = np.float32(0.25), np.float32(1.0), min(1, width - 1)
    out = np.empty_like(u)
    upper = np.empty((height, width), dtype=np.float32)  # what elimination leaves above the diagonal, negated
    above, below = np.zeros(width, dtype=np.float32), np.zeros(width, dtype=np.float32)
    inverse, across = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    for r in range(height):
        if r < height - 1:
            below[:] = least
            for k in range(C):
                here, next_row = u[k, r], u[k, r + 1]
                for c in range(1, width - 1):  # twice the sum of the central differences of both rows
                    across[c] = (here[c + 1] - here[c - 1]) + (next_row[c + 1] - next_row[c - 1])
                across[0] = (here[near] - here[0]) + (next_row[near] - next_row[0])
                across[width - 1] = (here[width - 1] - here[-1 - near]) + (next_row[width - 1] - next_row[-1 - near])
                for c in range(width):
                    step, aside = next_row[c] - here[c], quarter * across[c]
                    below[c] += step * step + aside * aside
            for c in range(width):
                below[c] = size / np.sqrt(below[c])
        else:
            below[:] = np.float32(0.0)
        for c in range(width):
            before = upper[r - 1, c] if r > 0 else np.float32(0.0)
            inverse[c] = one / (one + below[c] + above[c] * (one - before))
            upper[r, c] = below[c] * inverse[c]
        for k in range(C):
            for c in range(width):
                before = out[k, r - 1, c] if r > 0 else np.float32(0.0)
                out[k, r, c] = (u[k, r, c] + above[c] * before) * inverse[c]
        above, below = below, above
    for k in range(C):
        for r in range(height - 2, -1, -1):
            for c in range(width):
                out[k, r, c] += upper[r, c] * out[k, r + 1, c]
    return out
