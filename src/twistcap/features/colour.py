"""Grey values and CIELAB."""

from __future__ import annotations

import cv2
import numpy as np

from twistcap._typing import AnyArray, Float32

_BYTE = np.arange(256, dtype=np.float32)
_LAB_OF_BYTE = np.stack([_BYTE / 255.0, (_BYTE - 128.0) / 100.0, (_BYTE - 128.0) / 100.0], axis=1)[None]
_BYTE_TO_FLOAT = (_BYTE / 255.0)[None]


def to_float(image: AnyArray) -> Float32:
    """uint8 or float image to float32 in [0, 1]; the shape stays."""
    if image.dtype == np.uint8:
        return np.asarray(cv2.LUT(image, _BYTE_TO_FLOAT), np.float32) if image.size else image.astype(np.float32)
    return image.astype(np.float32)


def grey(image: AnyArray) -> Float32:
    """(H, W) luma of a grey (H, W) or RGB (H, W, 3) image."""
    if image.ndim == 3:
        image = cv2.cvtColor(image if image.dtype == np.uint8 else to_float(image), cv2.COLOR_RGB2GRAY)
    return to_float(image)


def lab(image: AnyArray) -> Float32:
    """(H, W, 3) CIELAB of an RGB image (H, W, 3), divided by 100: equal steps look about equally large."""
    if image.dtype == np.uint8:  # in whole steps of OpenCV's 8-bit CIELAB: far below sensor noise, and much faster
        return np.asarray(cv2.LUT(cv2.cvtColor(image, cv2.COLOR_RGB2LAB), _LAB_OF_BYTE), np.float32)
    return cv2.cvtColor(to_float(image), cv2.COLOR_RGB2LAB) * np.float32(0.01)
