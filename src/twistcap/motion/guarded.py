"""Prediction from training motion for as long as it proves itself; otherwise the person's own motion goes on.

A person who does what the library does not know is matched all the same, and led astray. So in each frame that was seen
forecasts for it are judged that were made before: the library's, and those of inertia, in which the last velocity dies
away. Whichever was nearer lately predicts. One frame ahead inertia is hard to beat; it is over a gap that the library
is needed, and there it is judged by forecasts from farther back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twistcap import se3
from twistcap._typing import Float
from twistcap.body import Pose
from twistcap.errors import InputError
from twistcap.motion.openloop import Expected, OpenLoop, Run
from twistcap.predict.history import Moment, MotionNoise, MotionSpread, constant_velocity

_AHEAD = (1, 8)  # frames by which the judged forecasts are made ahead
_FAR = 3  # frames from which on the farther ones tell
_MEMORY = 0.85  # share of past errors that counts in the next frame
_MOST = 0.3  # rad that one joint counts at most: a limb that was lost must not decide for the whole body
_DECAY = 0.15  # s in which a velocity dies away


@dataclass(frozen=True)
class Judged:
    """How both predictors have done.

    Attributes:
        last: the last moment that was judged.
        errors: (2, 2) squared, one and several frames ahead, of the library and of inertia; older ones count less.
        spread: of inertia.
        run: the library's prediction under way.
    """

    last: Moment
    errors: Float
    spread: MotionSpread
    run: Run | None = None


class GuardedMotion:
    """A predictor that yields to inertia where inertia does better.

    Args:
        inner: predictor from training motion.
        noise: of inertia.
    """

    def __init__(self, inner: OpenLoop, noise: MotionNoise | None = None) -> None:
        self.inner, self._noise = inner, noise or MotionNoise()

    @property
    def memory_type(self) -> Any:
        """How both predictors have done, or nothing yet."""
        return Judged | None

    def predict(self, history: Sequence[Moment], time: float, memory: Judged | None = None) -> tuple[Expected, Judged]:
        """The pose at `time`; see `MotionPredictor`.

        Raises:
            InputError: for a history without moments.
        """
        seen = [moment for moment in history if moment.seen]
        if memory is None or seen[-1].time != memory.last.time:
            memory = self._judged(seen, memory or self._fresh(seen))
        ahead = (time - seen[-1].time) * self.inner.library.rate
        if len(seen) > 1 and not trusts(memory.errors, ahead):
            return self._inert(seen, time, memory.spread), memory
        expected, run = self.inner.predict(history, time, memory.run)
        return expected, replace(memory, run=run)

    def _fresh(self, seen: Sequence[Moment]) -> Judged:
        if not seen:
            raise InputError("motion: a prediction needs at least one moment that was seen.")
        return Judged(seen[-1], np.zeros((len(_AHEAD), 2)), MotionSpread.usual(self._noise))

    def _judged(self, history: Sequence[Moment], memory: Judged) -> Judged:
        """With the forecasts of the last moment compared."""
        now, frame, errors = history[-1], 1.0 / self.inner.library.rate, memory.errors.copy()
        spread = memory.spread
        for k, ahead in enumerate(_AHEAD):
            before = [moment for moment in history if moment.time <= now.time - (ahead - 0.5) * frame]
            if len(before) < 2:
                continue
            inert = constant_velocity(before, now.time, _DECAY)
            forecasts = self.inner.predict(before, now.time)[0].pose, inert
            errors[k] = _MEMORY * errors[k] + [_apart(pose, now.pose) for pose in forecasts]
            if ahead == _AHEAD[0]:
                spread = spread.learnt(inert, now.pose, now.time - before[-1].time, "constant_velocity")
        return Judged(now, errors, spread)

    def _inert(self, history: Sequence[Moment], time: float, spread: MotionSpread) -> Expected:
        pose, passed = constant_velocity(history, time, _DECAY), time - history[-1].time
        # Accelerations do not last: an unknown step grows with the square of the first moments only.
        lasting = np.sqrt(min(passed, _DECAY) * passed)
        found = spread.covariance(6 + len(pose.q), lasting, "constant_velocity", pose.root[:3, 3])
        return Expected(pose, *found, None)


def trusts(errors: Float, frames: float) -> bool:
    """Whether the library predicts so many frames ahead, by past errors as in `Judged`."""
    ours, inert = errors[int(frames >= _FAR)]
    return bool(ours <= inert)


def _apart(pose: Pose, truth: Pose) -> float:
    """Sum of squares of turn (rad), shift (m) and angles (rad) between two poses; each angle counts up to _MOST."""
    turn = se3.log_rotation(pose.root[:3, :3].T @ truth.root[:3, :3])
    shift = pose.root[:3, 3] - truth.root[:3, 3]
    joints = np.minimum(np.abs(pose.q - truth.q), _MOST)
    return float(turn @ turn + shift @ shift + joints @ joints)
