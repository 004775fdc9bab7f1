"""Images to feature channels: float32 (H, W, C), about [0, 1]."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np

from twistcap._typing import AnyArray, Float32

Channels = Literal["grey", "lab"]


def to_float(image: AnyArray) -> Float32:
    """uint8 or float image to float32 in [0, 1]; the shape stays."""
    if image.dtype == np.uint8:
        return image.astype(np.float32) * np.float32(1.0 / 255.0)
    return image.astype(np.float32)


def grey(image: AnyArray) -> Float32:
    """(H, W) luma of a grey (H, W) or RGB (H, W, 3) image."""
    if image.ndim == 3:
        image = cv2.cvtColor(image if image.dtype == np.uint8 else to_float(image), cv2.COLOR_RGB2GRAY)
    return to_float(image)


def feature_channels(image: AnyArray, channels: Channels) -> Float32:
    """(H, W, C) channels that the region statistics use; "lab" of a grey image is its grey value.

    CIELAB comes divided by 100: equal steps then look about equally large in every channel.
    """
    if channels == "grey" or image.ndim == 2:
        return np.ascontiguousarray(grey(image)[..., None])
    lab = cv2.cvtColor(to_float(image), cv2.COLOR_RGB2LAB)
    return lab * np.float32(0.01)
