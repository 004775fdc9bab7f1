"""Motion as data: clips, skeletons of motion files, retargeting; libraries, scaled matching, prediction from them."""

from twistcap.motion.clip import MotionClip
from twistcap.motion.following import FollowedMotion, FollowRule, RecurrenceRule
from twistcap.motion.library import PAPER_SCALES, MotionLibrary
from twistcap.motion.matching import Match, Matcher
from twistcap.motion.openloop import Expected, MotionPredictor
from twistcap.motion.paper import PaperMotion
from twistcap.motion.predictor import MotionKind, motion_predictor
from twistcap.motion.retargeting import grounded, retarget
from twistcap.motion.skeleton import SkeletonMotion, skeleton_of
from twistcap.motion.table import SkeletonTable, body_table, read_table, table_for

__all__ = [
    "PAPER_SCALES", "Expected", "FollowRule", "FollowedMotion", "Match", "Matcher", "MotionClip", "MotionKind",
    "MotionLibrary", "MotionPredictor", "PaperMotion", "RecurrenceRule", "SkeletonMotion", "SkeletonTable",
    "body_table", "grounded", "motion_predictor", "read_table", "retarget", "skeleton_of", "table_for",
]  # fmt: skip
