"""Bodies: a tree of twists with limits, a surface and its binding; poses and forward kinematics."""

from twistcap.body.kinematics import Pose, Posed
from twistcap.body.model import Body, Landmarks
from twistcap.body.shape import rescaled

__all__ = ["Body", "Landmarks", "Pose", "Posed", "rescaled"]
