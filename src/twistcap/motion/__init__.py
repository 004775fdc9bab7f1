"""Motion as data: clips in a body's coordinates, skeletons of motion files, retargeting between them."""

from twistcap.motion.clip import MotionClip
from twistcap.motion.retargeting import grounded, retarget
from twistcap.motion.skeleton import SkeletonMotion, skeleton_of
from twistcap.motion.table import SkeletonTable, body_table, read_table, table_for

__all__ = [
    "MotionClip",
    "SkeletonMotion",
    "SkeletonTable",
    "body_table",
    "grounded",
    "read_table",
    "retarget",
    "skeleton_of",
    "table_for",
]
