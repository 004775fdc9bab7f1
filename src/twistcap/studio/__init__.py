"""The studio: synthetic captures with exact truth."""

from twistcap.studio.config import StudioConfig
from twistcap.studio.ring import ring
from twistcap.studio.scene import Capture, capture

__all__ = ["Capture", "StudioConfig", "capture", "ring"]
