"""The first pose of a recording: from 2D keypoints, refined on silhouettes."""

from twistcap.firstpose.fit import FirstPose, fit_keypoints, fit_keypoints_sequence, pose_at
from twistcap.firstpose.problem import Priors
from twistcap.firstpose.skeleton import Proportions, Skeleton

__all__ = ["FirstPose", "Priors", "Proportions", "Skeleton", "fit_keypoints", "fit_keypoints_sequence", "pose_at"]
