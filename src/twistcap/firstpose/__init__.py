"""The first pose of a recording: from 2D keypoints, refined on silhouettes."""

from twistcap.firstpose.fit import FirstPose, fit_keypoints, fit_keypoints_sequence, pose_at
from twistcap.firstpose.problem import Priors
from twistcap.firstpose.silhouette import Refined, SilhouetteOptions, girth_groups, refine_on_silhouettes
from twistcap.firstpose.skeleton import Proportions, Skeleton

__all__ = [
    "FirstPose",
    "Priors",
    "Proportions",
    "Refined",
    "SilhouetteOptions",
    "Skeleton",
    "fit_keypoints",
    "fit_keypoints_sequence",
    "girth_groups",
    "pose_at",
    "refine_on_silhouettes",
]
