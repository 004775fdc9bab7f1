"""Scaled motion dynamics: libraries of training motion, matching, and prediction from them."""

from twistcap.motion.choice import MotionKind, motion_predictor
from twistcap.motion.clip import MotionClip
from twistcap.motion.following import FollowedMotion, FollowRule
from twistcap.motion.library import PAPER_SCALES, MotionLibrary
from twistcap.motion.matching import Match, Matcher
from twistcap.motion.openloop import Expected, MotionPredictor
from twistcap.motion.paper import PaperMotion

__all__ = [
    "PAPER_SCALES",
    "Expected",
    "FollowRule",
    "FollowedMotion",
    "Match",
    "Matcher",
    "MotionClip",
    "MotionKind",
    "MotionLibrary",
    "MotionPredictor",
    "PaperMotion",
    "motion_predictor",
]
