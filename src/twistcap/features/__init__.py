"""Images to feature channels: float32 (H, W, C), about [0, 1]."""

from twistcap.features.channels import Channels, feature_channels
from twistcap.features.colour import grey, opponent, to_float
from twistcap.features.texture import Texture

__all__ = ["Channels", "Texture", "feature_channels", "grey", "opponent", "to_float"]
