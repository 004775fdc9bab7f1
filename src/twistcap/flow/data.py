"""The data term: which constancies hold between the images, linearised about the present flow.

Brightness and gradient constancy (Brox, Bruhn, Papenberg and Weickert 2004, "High accuracy optical flow estimation
based on a theory for warping", DOI 10.1007/978-3-540-24673-2_3), written as motion tensors: the squared residual of an
increment (du, dv) is ``wᵀ J w`` with w = (du, dv, 1). Normalised as by Zimmer, Bruhn and Weickert 2011 ("Optic flow in
harmony", DOI 10.1007/s11263-011-0422-6), it is a squared distance in px to the line of flows that explain the pixel.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.flow.solver import FAST, TENSOR

_CENTRAL = np.array([-1, 9, -45, 0, 45, -9, 1], np.float32) / 60  # first derivative, sixth order
_ONE = np.ones(1, np.float32)
_MAPS = 6  # I, I_x, I_y, I_xx, I_xy, I_yy


def derivative_maps(image: Float32) -> Float32:
    """(C, H, W, 6) of an image (H, W, C): I, I_x, I_y, I_xx, I_xy, I_yy of each channel."""
    out = np.empty((image.shape[2], *image.shape[:2], _MAPS), np.float32)
    for channel, maps in zip(np.moveaxis(image, 2, 0), out, strict=True):
        channel = np.ascontiguousarray(channel)
        x, y = _derivative(channel, 0), _derivative(channel, 1)
        cv2.merge([channel, x, y, _derivative(x, 0), _derivative(x, 1), _derivative(y, 1)], maps)
    return out


def _derivative(image: Float32, axis: int) -> Float32:
    kernels = (_CENTRAL, _ONE) if axis == 0 else (_ONE, _CENTRAL)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, *kernels, borderType=cv2.BORDER_REFLECT), np.float32)


@njit(cache=True, nogil=True, fastmath=FAST)
def motion_tensors(
    first: Float32, second: Float32, u: Float32, v: Float32, mask: Bool, corner: tuple[int, int], zeta: float,
    blend: float,
) -> Float32:  # fmt: skip
    """(H, 12, W) motion tensors of brightness (6 entries) and gradient, summed over the channels.

    Of `derivative_maps` (C, H, W, 6) of a window at a corner (row, column) of the first image and of the whole second
    image, which is looked up at the flow u, v (H, W) px by Catmull-Rom interpolation. 0 off the mask (H, W), and where
    the flow leaves the image. For zeta and blend see `FlowSettings`.
    """
    (C, H, W, _), (top, left) = first.shape, corner
    rows_there, columns_there = second.shape[1:3]
    out = np.zeros((H, 2 * TENSOR, W), dtype=np.float32)
    warped, mean = np.empty(_MAPS, dtype=np.float32), np.empty(_MAPS, dtype=np.float32)
    rows, columns = np.empty(4, dtype=np.int32), np.empty(4, dtype=np.int32)
    at_x, at_y = np.empty(4, dtype=np.float32), np.empty(4, dtype=np.float32)
    b = np.float32(blend)
    for r in range(H):
        for c in range(W):
            x, y = left + c + u[r, c], top + r + v[r, c]
            if not mask[r, c] or x < 0.0 or y < 0.0 or x > columns_there - 1 or y > rows_there - 1:
                continue
            _cubic_taps(x, columns_there, columns, at_x)
            _cubic_taps(y, rows_there, rows, at_y)
            for channel in range(C):
                _look_up(second[channel], rows, at_y, columns, at_x, warped)
                here = first[channel, r, c]
                for k in range(_MAPS):
                    mean[k] = warped[k] + b * (here[k] - warped[k])
                _add_constraint(out[r, :TENSOR, c], mean[1], mean[2], warped[0] - here[0], zeta)
                _add_constraint(out[r, TENSOR:, c], mean[3], mean[4], warped[1] - here[1], zeta)
                _add_constraint(out[r, TENSOR:, c], mean[4], mean[5], warped[2] - here[2], zeta)
    return out


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _cubic_taps(x: np.float32, size: int, places: Int, weights: Float32) -> None:
    """The four pixels (clamped) and their weights (Catmull and Rom) with which to interpolate at x."""
    k = int(x)
    t = np.float32(x - k)
    half, s = np.float32(0.5), np.float32(1.0) - t
    weights[0] = -half * t * s * s
    weights[3] = -half * s * t * t
    weights[1] = s * (np.float32(1.0) + t - np.float32(1.5) * t * t)
    weights[2] = t * (np.float32(1.0) + s - np.float32(1.5) * s * s)
    for i in range(4):
        places[i] = min(max(k - 1 + i, 0), size - 1)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _look_up(maps: Float32, rows: Int, at_y: Float32, columns: Int, at_x: Float32, out: Float32) -> None:
    """Interpolate maps (H, W, 6)."""
    for k in range(_MAPS):
        out[k] = np.float32(0.0)
    for i in range(4):
        for j in range(4):
            w, source = at_y[i] * at_x[j], maps[rows[i], columns[j]]
            for k in range(_MAPS):
                out[k] += w * source[k]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _add_constraint(J: Float32, x: np.float32, y: np.float32, t: np.float32, zeta: float) -> None:
    """Add (x, y, t)(x, y, t)ᵀ to a tensor (6,)."""
    n = np.float32(1.0)
    if zeta > 0.0:
        n /= x * x + y * y + np.float32(zeta * zeta)
    J[0] += n * x * x
    J[1] += n * x * y
    J[2] += n * y * y
    J[3] += n * x * t
    J[4] += n * y * t
    J[5] += n * t * t


def motion_tensors_reference(
    first: Float32, second: Float32, u: Float32, v: Float32, mask: Bool, corner: tuple[int, int], zeta: float,
    blend: float,
) -> Float:  # fmt: skip
    """Readable twin of `motion_tensors`: all pixels at once."""
    (C, H, W, _), (rows, columns) = first.shape, second.shape[1:3]
    x, y = np.arange(W) + corner[1] + u.astype(float), np.arange(H)[:, None] + corner[0] + v.astype(float)
    seen, out = mask & (x >= 0) & (y >= 0) & (x <= columns - 1) & (y <= rows - 1), np.zeros((H, 2 * TENSOR, W))
    for channel in range(C):
        here, there = first[channel].astype(float), _interpolated(second[channel].astype(float), x, y)
        mean = there + blend * (here - there)
        for term, gx, gy, t in ((0, 1, 2, 0), (TENSOR, 3, 4, 1), (TENSOR, 4, 5, 2)):
            row = np.stack([mean[..., gx], mean[..., gy], there[..., t] - here[..., t]], axis=-1)
            size = np.sum(row[..., :2] ** 2, axis=-1) + zeta**2 if zeta > 0.0 else np.ones((H, W))
            for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
                out[:, term + k] += seen * row[..., i] * row[..., j] / size
    return out


def _interpolated(maps: Float, x: Float, y: Float) -> Float:
    """Maps (H', W', 6) at places, by Catmull and Rom in either direction; borders are repeated."""
    i, j, out = np.floor(y).astype(int), np.floor(x).astype(int), np.zeros((*x.shape, _MAPS))
    for a, by_row in enumerate(_catmull_rom(y - i)):
        for b, by_column in enumerate(_catmull_rom(x - j)):
            places = np.clip(i + a - 1, 0, len(maps) - 1), np.clip(j + b - 1, 0, maps.shape[1] - 1)
            out = out + (by_row * by_column)[..., None] * maps[places]
    return out


def _catmull_rom(t: Float) -> tuple[Float, Float, Float, Float]:
    """Weights of the four places about one at t from the second to the third."""
    first, last = -0.5 * t + t**2 - 0.5 * t**3, -0.5 * t**2 + 0.5 * t**3
    return first, 1.0 - 2.5 * t**2 + 1.5 * t**3, 0.5 * t + 2.0 * t**2 - 1.5 * t**3, last
