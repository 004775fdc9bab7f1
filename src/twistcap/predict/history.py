"""The past poses, and how far motion strays from what they let one expect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body import Pose
from twistcap.ranges import Checked, Share

_SHIFT = 0.004  # m, the same of the root
_REST = 0.3  # s in which a body that is not seen is thought to come to rest
_JUMP = np.deg2rad(2.0)  # of a joint: more than a fit wavers
REMEMBERED = 128
"""Moments of the history."""


@dataclass(frozen=True)
class Moment:
    """A pose at a time (s), and whether images told it or it is a prediction."""

    time: float
    pose: Pose
    seen: bool = True


@dataclass(frozen=True)
class MotionNoise(Checked):
    """How far motion strays from its prediction.

    Attributes:
        joint, turn, shift: standard deviation of acceleration of joints, root rotation (rad/s²) and root translation
            (m/s²); joint_speed, turn_speed, shift_speed: of velocity (rad/s, m/s), for the hold predictor.
        allowance: how many times the deviation seen of late is allowed for, where that is more than the usual one.
        memory: share that what was seen of late keeps from frame to frame.
    """

    joint: float = 100.0
    turn: float = 60.0
    shift: float = 25.0
    joint_speed: float = 4.0
    turn_speed: float = 2.0
    shift_speed: float = 1.5
    allowance: float = 3.0
    memory: Share = 0.85

    def covariance(self, dof: int, dt: float, predictor: str, centre: Float) -> tuple[Float, Float]:
        """(dof, dof) covariance of a prediction over dt seconds, and its inverse; the root turns about `centre`."""
        return covariance_about(self.variance(dof, dt, predictor), centre)

    def variance(self, dof: int, dt: float, predictor: str) -> Float:
        """(dof,) of a prediction over dt seconds: turn (rad²) and shift (m²) of the root, joints (rad²)."""
        if predictor != "hold":
            joint, turn, shift = (a * dt * dt for a in (self.joint, self.turn, self.shift))
        else:
            joint, turn, shift = (v * dt for v in (self.joint_speed, self.turn_speed, self.shift_speed))
        return np.repeat([turn**2, shift**2, joint**2], (3, 3, dof - 6))


@dataclass(frozen=True)
class MotionSpread:
    """How far one body may be from where it is predicted: as far as usual, farther while it moves more than that.

    `excess` (3,) are mean squares of late of turn, shift and joints, in units of the usual variance. All joints
    have one measure: a limb that goes astray alone is not given more room for it.
    """

    noise: MotionNoise
    excess: Float

    @staticmethod
    def usual(noise: MotionNoise) -> MotionSpread:
        """Nothing has been seen yet."""
        return MotionSpread(noise, np.zeros(3))

    def covariance(self, dof: int, dt: float, predictor: str, centre: Float) -> tuple[Float, Float]:
        """(dof, dof) covariance of a prediction over dt seconds, and its inverse; the root turns about `centre`."""
        more = np.maximum(1.0, self.noise.allowance**2 * self.excess)
        usual = self.noise.variance(dof, dt, predictor)
        return covariance_about(usual * np.repeat(more, (3, 3, dof - 6)), centre)

    def learnt(self, expected: Pose, found: Pose, dt: float, predictor: str) -> MotionSpread:
        """After a pose was found where another was expected, dt seconds after the one before."""
        if dt <= 0.0:
            return self
        step = found.minus(expected)
        step[3:6] -= se3.hat(expected.root[:3, 3]) @ step[:3]
        ratios = step**2 / self.noise.variance(len(step), dt, predictor)
        means = np.array([part.sum() / max(len(part), 1) for part in (ratios[:3], ratios[3:6], ratios[6:])])
        return replace(self, excess=self.excess + (1.0 - self.noise.memory) * (means - self.excess))


def covariance_about(variance: Float, centre: Float) -> tuple[Float, Float]:
    """Covariance (dof, dof) of a pose step, and its inverse, from the `variance` (dof,) of turns (rad²) about a body's
    point `centre` (3,) m, of its shifts (m²) and of the coordinates (rad²).
    """
    # δξ acts about the world's origin: a turn about the body's centre is ω there, with −ω × centre as v.
    A, back, arm = np.eye(len(variance)), np.eye(len(variance)), se3.hat(centre)
    A[3:6, :3], back[3:6, :3] = arm, -arm
    return (A * variance) @ A.T, (back.T / variance) @ back


def constant_velocity(history: Sequence[Moment], time: float, decay: float = np.inf) -> Pose:
    """The motion between the last two moments of the history goes on until `time` s; hold where there is but one.

    Joint velocities die away with the time constant `decay` s, so that a limb nobody sees comes to rest.
    """
    last = history[-1]
    if len(history) < 2 or time <= last.time or last.time <= history[-2].time:
        return last.pose
    passed, between = time - last.time, last.time - history[-2].time
    step = last.pose.minus(history[-2].pose) * (passed / between)
    step[6:] *= np.exp(-passed / decay)
    if not last.seen:
        step[:6] *= np.exp(-passed / _REST)
    return last.pose.retract(step)


def jumped(last: Moment, jump: Float, pose: Pose) -> Moment:
    """The last moment where the present pose jumps (6 + J,) to another: it was off as well; joints that jumped rest."""
    joints = rested(last, pose, np.abs(jump[6:]) > _JUMP).pose.q
    return replace(last, pose=Pose(last.pose.retract(jump).root, joints))


def rested(last: Moment, pose: Pose, which: Bool) -> Moment:
    """The last moment with some joints (J,) as in the present pose: how they came there is not known."""
    return replace(last, pose=Pose(last.pose.root, np.where(which, pose.q, last.pose.q)))


@dataclass(frozen=True)
class Past:
    """What is known of the motion before a frame: the moments, the latest last, at first of the given pose alone; when
    images last showed the body, s; whether a frame has been tracked; how far the body is from where it is predicted.
    """

    moments: tuple[Moment, ...]
    seen_time: float
    started: bool
    spread: MotionSpread

    @property
    def last(self) -> Pose:
        """The latest pose."""
        return self.moments[-1].pose

    @property
    def moving(self) -> bool:
        """Whether there are two poses, which give a velocity."""
        return len(self.moments) > 1

    @property
    def in_motion(self) -> bool:
        """Whether the body has moved between the last two moments by more than a fit wavers."""
        if not self.moving:
            return False
        step = self.last.minus(self.moments[-2].pose)
        shift = self.last.root[:3, 3] - self.moments[-2].pose.root[:3, 3]
        return bool(np.abs(step[6:]).max(initial=0.0) > 0.5 * _JUMP or np.abs(shift).max() > _SHIFT)

    @property
    def seen(self) -> tuple[Moment, ...]:
        """The moments that images showed."""
        return tuple(moment for moment in self.moments if moment.seen)

    def advanced(self, moment: Moment) -> Past:
        """With one more moment; the given first pose makes room for the first frame's."""
        before = self.moments if self.started else ()
        seen_time = moment.time if moment.seen else self.seen_time
        return replace(self, moments=(*before, moment)[-REMEMBERED:], seen_time=seen_time, started=True)

    def tracked(self, expected: Pose, predicted: str, moment: Moment, jump: bool) -> Past:
        """With a moment that images showed, and what it says of how far bodies are from where they are expected.

        What predicted the pose by training motion says nothing of that, nor does a jump.
        """
        if not self.started or jump or predicted == "motion":
            return self.advanced(moment)
        kind = "constant_velocity" if self.moving and predicted != "hold" else "hold"
        spread = self.spread.learnt(expected, moment.pose, moment.time - self.seen_time, kind)
        return replace(self, spread=spread).advanced(moment)

    def with_last(self, moment: Moment) -> Past:
        """With another latest moment."""
        return replace(self, moments=(*self.moments[:-1], moment))
