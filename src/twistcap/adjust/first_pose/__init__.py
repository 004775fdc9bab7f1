"""The first pose of a recording: from 2D keypoints, refined on silhouettes."""

from twistcap.adjust.first_pose.fit import FirstPose, fit_keypoints, fit_keypoints_sequence, pose_at
from twistcap.adjust.first_pose.silhouette import Refined, girth_groups, refine_on_silhouettes
from twistcap.adjust.first_pose.skeleton import Proportions, Skeleton

__all__ = [
    "FirstPose", "Proportions", "Refined", "Skeleton", "fit_keypoints", "fit_keypoints_sequence", "girth_groups",
    "pose_at", "refine_on_silhouettes",
]  # fmt: skip
