"""Cameras that were bumped or badly calibrated, from the tracked body; the other cameras hold the world."""

from twistcap.adjust.cameras.coarse import turned_towards
from twistcap.adjust.cameras.fine import SWAYS, MendedCameras, mended_cameras
from twistcap.adjust.cameras.since import agreement_at, holds_from

__all__ = ["SWAYS", "MendedCameras", "agreement_at", "holds_from", "mended_cameras", "turned_towards"]
