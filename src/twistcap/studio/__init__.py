"""The studio: synthetic captures with exact truth."""

from twistcap.studio.config import StudioConfig
from twistcap.studio.scene import Capture, capture, ring

__all__ = ["Capture", "StudioConfig", "capture", "ring"]
