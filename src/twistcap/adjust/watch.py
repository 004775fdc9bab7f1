"""Cameras, watched while a body is tracked: is one out of step with the others?"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.cues import Evidence, Fit, Level, Sight
from twistcap.predict.inertia import INFLATION

_FASTEST = 0.4  # rad or m from frame to frame; what moves more has jumped
_OFF = np.repeat([0.01, 0.03], 3)  # rad and m by which a calibration may be wrong, which is not taken for lateness
_HINT = 0.08  # frames of lateness that are worth a closer look; one step of the solver finds about a third of it
_SIGMAS = 1.0  # of its standard deviation as claimed, which is more than twice the true one


@dataclass(frozen=True)
class Watched:
    """Sums of the normal equations of C cameras; in each, all other cameras are believed, and poses are eliminated.

    The unknowns of a camera are a twist of the world before it (rad, m), and the number of frames by which it is late.

    Attributes:
        information: (C, 7, 7).
        gradient: (C, 7).
        last: the latest pose.
    """

    information: Float
    gradient: Float
    last: Pose | None

    def lateness(self) -> tuple[Float, Float]:
        """(C,) frames by which each camera is late against the median, by one step, and their standard deviations."""
        turn = self.information[:, :6, :6] + np.diag((INFLATION / _OFF) ** 2)
        cross = np.linalg.solve(turn, self.information[:, :6, 6:])[..., 0]
        information = self.information[:, 6, 6] - np.sum(cross * self.information[:, 6, :6], axis=1)
        known = np.maximum(information, 1e-9)
        late = (np.sum(cross * self.gradient[:, :6], axis=1) - self.gradient[:, 6]) / known
        return late - np.median(late), INFLATION / np.sqrt(known)

    def out_of_step(self) -> Bool:
        """(C,) cameras whose clocks are worth a closer look."""
        late, sigma = self.lateness()
        return np.abs(late) > np.maximum(_HINT, _SIGMAS * sigma)


@dataclass(frozen=True)
class CameraWatch:
    """A cue that brings no evidence: it adds up what each camera's contours say of the camera's clock.

    A point that moves at v is v·Δt off in an image that is Δt late. `contour` is the name of the cue of the contours.
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
        hessian = fit.quadratic.hessian
        inverse = np.linalg.inv(hessian)
        rest = inverse @ (fit.quadratic.gradient + hessian @ fit.pose.minus(fit.before.pose))
        by_pose = np.c_[np.eye(len(step))[:, :6], step]  # the world moves as the body does; to be late is to go on
        information, gradient = memory.information.copy(), memory.gradient.copy()
        for sight, evidence in fit.of(self.contour):
            quadratic, camera = evidence.term.linearize(fit.posed), sight.camera_index
            cross = quadratic.hessian @ by_pose
            information[camera] += by_pose.T @ cross - cross.T @ inverse @ cross
            gradient[camera] += by_pose.T @ quadratic.gradient - cross.T @ rest
        return Watched(information, gradient, fit.pose)
