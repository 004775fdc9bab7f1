"""Scaled motion dynamics: libraries of training motion, matching, and prediction from them."""

from twistcap.motion.clip import MotionClip
from twistcap.motion.library import PAPER_SCALES, MotionLibrary
from twistcap.motion.matching import Match, Matcher

__all__ = ["PAPER_SCALES", "Match", "Matcher", "MotionClip", "MotionLibrary"]
