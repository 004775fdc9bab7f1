"""Grey values and CIELAB."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import AnyArray, Float32

_BYTE = np.arange(256, dtype=np.float32)
_BYTE_TO_FLOAT = (_BYTE / 255.0)[None]
_STEPS = 16384  # of the tabulated cube root; the error of CIELAB is then below that of half a byte
_FIELD, _SUBSTEPS = 21, 64  # bits of each of the three packed numbers, and their unit: so many to a step


def _fractions_of_white() -> AnyArray:
    """(3, 256) uint64: fraction of white's X, Y and Z (CIE 1931, D65) that each byte of R, G and B adds, in steps.

    The three are packed into one number, so that one sum of three table entries adds them all.
    """
    u = _BYTE.astype(np.float64) / 255.0
    linear = np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4)  # sRGB, IEC 61966-2-1
    xyz = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])
    fractions = (xyz / xyz.sum(axis=1, keepdims=True)).T
    fields = np.rint((_STEPS - 1) * _SUBSTEPS * linear[None, :, None] * fractions[:, None]).astype(np.uint64)
    return (fields << np.array([0, _FIELD, 2 * _FIELD], np.uint64)).sum(axis=2)


def _lightness() -> Float32:
    """(steps,) CIELAB's f: the cube root, and a line near black."""
    t = np.arange(_STEPS) / (_STEPS - 1)
    return np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116).astype(np.float32)


_FRACTIONS, _LIGHTNESS = _fractions_of_white(), _lightness()


def to_float(image: AnyArray) -> Float32:
    """A uint8 or float image as float32 in [0, 1], of the same shape."""
    if image.dtype == np.uint8:
        return np.asarray(cv2.LUT(image, _BYTE_TO_FLOAT), np.float32) if image.size else image.astype(np.float32)
    return image.astype(np.float32)


def grey(image: AnyArray) -> Float32:
    """(H, W) luma of a grey (H, W) or RGB (H, W, 3) image."""
    if image.ndim == 3:
        image = cv2.cvtColor(image if image.dtype == np.uint8 else to_float(image), cv2.COLOR_RGB2GRAY)
    return to_float(image)


_OPPONENT = np.array([[0.299, 0.587, 0.114], [0.707, -0.707, 0.0], [0.408, 0.408, -0.816]], dtype=np.float32)


def opponent(image: AnyArray, colour: bool = True) -> Float32:
    """(C, H, W) grey in [0, 1], and for RGB images (H, W, 3), where wanted, the colours red-green and yellow-blue."""
    values = image.astype(np.float32) / np.float32(255.0 if image.dtype == np.uint8 else 1.0)
    if values.ndim == 2:
        return values[None]
    mixed = np.moveaxis(values, -1, 0)
    return np.einsum("ck,khw->chw", _OPPONENT if colour else _OPPONENT[:1], mixed).astype(np.float32)


def lab(image: AnyArray) -> Float32:
    """(H, W, 3) CIELAB (CIE 1976) of an RGB image (H, W, 3), divided by 100."""
    if image.dtype == np.uint8:
        return _lab_of_bytes(np.ascontiguousarray(image), _FRACTIONS, _LIGHTNESS)
    return cv2.cvtColor(to_float(image), cv2.COLOR_RGB2LAB) * np.float32(0.01)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def _lab_of_bytes(image: AnyArray, fractions: AnyArray, lightness: Float32) -> Float32:
    """(H, W, 3) CIELAB / 100 of an RGB image (H, W, 3) of bytes, by tables."""
    out = np.empty(image.shape, dtype=np.float32)
    rgb, lab = image.reshape(-1), out.reshape(-1)
    field, half = np.int64((1 << _FIELD) - 1), np.int64(_SUBSTEPS // 2)
    for i in range(0, len(rgb), 3):
        xyz = np.int64(fractions[0, rgb[i]] + fractions[1, rgb[i + 1]] + fractions[2, rgb[i + 2]])
        x = lightness[((xyz & field) + half) // _SUBSTEPS]
        y = lightness[((xyz >> _FIELD & field) + half) // _SUBSTEPS]
        z = lightness[((xyz >> 2 * _FIELD & field) + half) // _SUBSTEPS]
        lab[i] = np.float32(1.16) * y - np.float32(0.16)
        lab[i + 1] = np.float32(5.0) * (x - y)
        lab[i + 2] = np.float32(2.0) * (y - z)
    return out
