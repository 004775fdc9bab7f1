"""Images to feature channels: float32 (H, W, C), about [0, 1]."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twistcap.arrays import AnyArray, Float32
from twistcap.features.colour import grey, lab, opponent, to_float
from twistcap.features.texture import Texture, with_texture

__all__ = ["Channels", "Texture", "feature_channels", "grey", "opponent", "to_float"]

Channels = Literal["grey", "lab", "grey+texture", "lab+texture"]

_DEFAULT = Texture()


def feature_channels(image: AnyArray, channels: Channels, texture: Texture = _DEFAULT) -> Float32:
    """(H, W, C) channels of a grey (H, W) or RGB (H, W, 3) image.

    "grey" has 1 channel, "lab" 3 (`colour.lab`); "+texture" adds 4 to either: the structure tensor's J₁₁ (x), J₂₂ (y)
    and J₁₂, and the local scale (`texture.with_texture`). "lab" of a grey image is its grey value.
    """
    coloured = channels.startswith("lab") and image.ndim == 3
    colours = lab(image) if coloured else grey(image)[..., None]
    if channels.endswith("+texture"):
        return with_texture(colours, grey(image) if coloured else colours[..., 0], texture)
    return np.ascontiguousarray(colours)
