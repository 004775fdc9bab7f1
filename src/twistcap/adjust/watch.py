"""Cameras, watched while a body is tracked: whether one is out of step, or does not stand where it was calibrated."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.cues import Evidence, Fit, Level, Sight

_FASTEST = 0.4  # rad or m from frame to frame; what moves more has jumped
_MEMORY = 0.975  # of the sums from one lesson to the next


@dataclass(frozen=True)
class Watched:
    """Sums of C cameras' normal equations; in each, all other cameras are believed, and the poses are eliminated.

    Unknowns are the twist of the world before the camera (rad, m), and by how many frames it is late.

    Attributes:
        information: (C, 7, 7).
        gradient: (C, 7).
        last: the latest pose.
    """

    information: Float
    gradient: Float
    last: Pose | None


@dataclass(frozen=True)
class CameraWatch:
    """A cue that brings no evidence: it adds up what each camera's contours say of the camera itself.

    A point that moves at v is v·Δt off in an image that is Δt late, and a camera that was turned shows the whole body
    elsewhere. `contour` is the name of the cue that brings the contours.
    """

    contour: str = "contour"
    name: str = field(default="camera watch", init=False)

    def start(self, body: Body, rig: Rig) -> Watched:
        """Nothing seen yet."""
        return Watched(np.zeros((len(rig), 7, 7)), np.zeros((len(rig), 7)), None)

    def measure(self, sight: Sight, memory: Watched, level: Level) -> Evidence | None:
        """None: it has no say in the pose."""
        return None

    def learn(self, memory: Watched, fit: Fit, lesson: int) -> Watched:
        """With the equations of a frame that brings a lesson."""
        step = None if memory.last is None else fit.pose.minus(memory.last)
        if not lesson or step is None or np.abs(step).max() > _FASTEST:
            return Watched(memory.information, memory.gradient, fit.pose)
        inverse = np.linalg.inv(fit.quadratic.hessian)
        rest = inverse @ (fit.quadratic.gradient + fit.quadratic.hessian @ fit.pose.minus(fit.before.pose))
        by_pose = np.c_[np.eye(len(step))[:, :6], step]  # moving the world is moving the body, being late is going on
        information, gradient = _MEMORY * memory.information, _MEMORY * memory.gradient
        for sight, evidence in fit.of(self.contour):
            quadratic, c = evidence.term.linearize(fit.posed), sight.camera_index
            cross = quadratic.hessian @ by_pose
            information[c] += by_pose.T @ cross - cross.T @ inverse @ cross
            gradient[c] += by_pose.T @ quadratic.gradient - cross.T @ rest
        return Watched(information, gradient, fit.pose)
