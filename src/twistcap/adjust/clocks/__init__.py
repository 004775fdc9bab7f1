"""Clocks of cameras that were not started together: coarse from signals, fine from the tracked body."""

from twistcap.adjust.clocks.coarse import Coarse, Signal, coincidence, motion_signal, sound_signal
from twistcap.adjust.clocks.fine import Clocks, estimate_clocks
from twistcap.adjust.clocks.keypoints import KeypointClock, keypoint_clock

__all__ = [
    "Clocks", "Coarse", "KeypointClock", "Signal", "coincidence", "estimate_clocks", "keypoint_clock",
    "motion_signal", "sound_signal",
]  # fmt: skip
