"""Cameras, watched while a body is tracked: is one out of step with the others, or elsewhere than calibrated?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Bool, Float, Int
from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.cues import Evidence, Fit, Level, Sight
from twistcap.predict.inertia import INFLATION

_FASTEST = 0.4  # rad or m from frame to frame; what moves more has jumped
_OFF = np.repeat([0.01, 0.03], 3)  # rad and m by which a calibration may be wrong, which is not taken for lateness
_HINT = 0.06  # frames of lateness that are worth a closer look; one step of the solver finds a tenth of it or more
_SIGMAS = 0.75  # of its standard deviation as claimed, which is more than twice the true one
_KEPT = 0.9  # of what was seen of a camera's place, from lesson to lesson: a knock comes at any time
_TURNED = np.deg2rad(0.3)  # by which one step must turn a camera; it finds about a third of a turn
_STANDS_OUT = 3.0  # times the turn of most others: a body that does not fit turns all cameras alike
_SURE = 2.0  # standard deviations as claimed, by which a camera must stand elsewhere
_TURNED_LITTLE, _SURER = np.deg2rad(0.15), 3.5  # enough in the camera that is the surest: a roll moves few contours
KNOCK = np.repeat([np.deg2rad(6.0), 0.02], 3)
"""(6,) how far a camera may stand from where it was calibrated, rad and m: a knock turns it far and moves it little."""


@dataclass(frozen=True)
class Watched:
    """Sums of the normal equations of C cameras; in each, all other cameras are believed, and poses are eliminated.

    The unknowns of a camera are a twist of the world before it (rad, m), and the number of frames by which it is late.

    Attributes:
        information: (C, 7, 7).
        gradient: (C, 7).
        places: (C, 6, 6) and (C, 6), the same of late, by left twists of the cameras themselves.
        last: the latest pose.
        frames: that were seen.
        since: (C,) how many of them had been when each camera came to seem to stand elsewhere; -1 where it does not.
    """

    information: Float
    gradient: Float
    places: tuple[Float, Float]
    last: Pose | None
    frames: int
    since: Int

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

    def elsewhere(self) -> Bool:
        """(C,) cameras that seem to stand elsewhere than they were calibrated.

        Where one of two cameras that face each other was turned about its viewing axis, that is both.
        """
        information, gradient = self.places
        step = np.linalg.solve(information + np.diag((INFLATION / KNOCK) ** 2), gradient[..., None])
        sigmas = np.sqrt(np.maximum(np.sum(step * (information @ step), axis=(1, 2)), 0.0)) / INFLATION
        turned = np.linalg.norm(step[:, :3, 0], axis=1)
        usual = np.array([np.median(np.delete(turned, c)) for c in range(len(turned))])
        clearly = (sigmas > _SURE) & (turned > _TURNED)
        slightly = (sigmas > _SURER) & (sigmas >= sigmas.max()) & (turned > _TURNED_LITTLE)
        return (clearly | slightly) & (turned > _STANDS_OUT * usual)


@dataclass(frozen=True)
class CameraWatch:
    """A cue that brings no evidence: it adds up what each camera's contours say of the camera's clock and place.

    A point that moves at v is v·Δt off in an image that is Δt late.
    """

    name: str = field(default="camera watch", init=False)

    def start(self, body: Body, rig: Rig) -> Watched:
        """Nothing seen yet."""
        C = len(rig)
        return Watched(
            np.zeros((C, 7, 7)), np.zeros((C, 7)), (np.zeros((C, 6, 6)), np.zeros((C, 6))), None, 0, np.full(C, -1)
        )

    def measure(self, sight: Sight, memory: Watched, level: Level) -> Evidence | None:
        """None: it has no say in the pose."""
        return None

    def learn(self, memory: Watched, fit: Fit, lesson: int) -> Watched:
        """With the equations of a frame that brings a lesson."""
        step = None if memory.last is None else fit.pose.minus(memory.last)
        memory = replace(memory, last=fit.pose, frames=memory.frames + 1)
        if not lesson or step is None or np.abs(step).max() > _FASTEST:
            return memory
        information, gradient = memory.information.copy(), memory.gradient.copy()
        places, pulls = (_KEPT * sums for sums in memory.places)
        for sight, own, pull in self._equations(fit, step):
            c, by_camera = sight.camera_index, np.linalg.inv(se3.adjoint(sight.view.camera.T_cam_world))
            information[c] += own
            gradient[c] += pull
            places[c] += by_camera.T @ own[:6, :6] @ by_camera
            pulls[c] += by_camera.T @ pull[:6]
        after = replace(memory, information=information, gradient=gradient, places=(places, pulls))
        since = np.where(memory.since < 0, memory.frames, memory.since)
        return replace(after, since=np.where(after.elsewhere(), since, -1))

    def _equations(self, fit: Fit, step: Float) -> Iterator[tuple[Sight, Float, Float]]:
        """Each camera's information (7, 7) and gradient (7,), poses eliminated; `step` is that from the last pose."""
        hessian = fit.quadratic.hessian
        inverse = np.linalg.inv(hessian)
        rest = inverse @ (fit.quadratic.gradient + hessian @ fit.pose.minus(fit.before.pose))
        by_pose = np.c_[np.eye(len(step))[:, :6], step]  # the world moves as the body does; to be late is to go on
        for sight, evidence in fit.of("contour"):
            quadratic = evidence.term.linearize(fit.posed)
            cross = quadratic.hessian @ by_pose
            yield sight, by_pose.T @ cross - cross.T @ inverse @ cross, by_pose.T @ quadratic.gradient - cross.T @ rest
