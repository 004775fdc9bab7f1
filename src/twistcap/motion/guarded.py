"""Prediction from training motion while its forecasts are the better ones; otherwise by inertia.

A motion that the library does not contain is matched all the same, and predicted wrongly. So in each frame with images
earlier forecasts are compared: the library's, and those of inertia with a decaying velocity. The one with smaller
errors predicts. Inertia is hard to beat one frame ahead, so that longer gaps are decided by longer forecasts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.errors import check
from twistcap.motion.openloop import Expected, OpenLoop, Rollout
from twistcap.predict.history import Moment, MotionNoise, MotionSpread, constant_velocity

_AHEAD = (1, 8)  # frames ahead of the compared forecasts
_FAR = 3  # frames ahead from which the longer forecasts decide
_MEMORY = 0.85  # factor of past errors in the next frame
_MOST = 0.3  # rad, greatest error of a joint: a lost limb must not decide for the whole body
_DECAY = 0.15  # s, decay time of the velocity


@dataclass(frozen=True)
class ForecastErrors:
    """Past errors of both predictors.

    `last` is the last moment compared, `spread` that of inertia, `run` the library's prediction, to be extended.
    Squared errors (2, 2) are those one and several frames ahead, of the library and of inertia; older ones count less.
    """

    last: Moment
    errors: Float
    spread: MotionSpread
    run: Rollout | None = None


class GuardedMotion:
    """A predictor from training motion that is replaced by inertia where inertia has smaller errors."""

    def __init__(self, inner: OpenLoop) -> None:
        self.inner = inner

    @property
    def memory_type(self) -> Any:
        """Past errors, or None."""
        return ForecastErrors | None

    def predict(
        self, history: Sequence[Moment], time: float, memory: ForecastErrors | None = None
    ) -> tuple[Expected, ForecastErrors]:
        """The pose at `time`; see `MotionPredictor`. A history without images is an InputError."""
        seen = [moment for moment in history if moment.seen]
        if memory is None or seen[-1].time != memory.last.time:
            check("motion", seen, "a prediction needs at least one moment with images")
            fresh = ForecastErrors(seen[-1], np.zeros((len(_AHEAD), 2)), MotionSpread.usual(MotionNoise()))
            memory = self._compared(seen, memory or fresh)
        ahead = (time - seen[-1].time) * self.inner.library.rate
        if len(seen) > 1 and not trusts(memory.errors, ahead):
            return self._inert(seen, time, memory.spread), memory
        expected, run = self.inner.predict(history, time, memory.run)
        return expected, replace(memory, run=run)

    def _compared(self, history: Sequence[Moment], memory: ForecastErrors) -> ForecastErrors:
        """The memory with the errors of the forecasts of the last moment."""
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
        return ForecastErrors(now, errors, spread)

    def _inert(self, history: Sequence[Moment], time: float, spread: MotionSpread) -> Expected:
        pose, passed = constant_velocity(history, time, _DECAY), time - history[-1].time
        # Accelerations are short: the step grows with the square of time at first only.
        lasting = np.sqrt(min(passed, _DECAY) * passed)
        found = spread.covariance(6 + len(pose.q), lasting, "constant_velocity", pose.root[:3, 3])
        return Expected(pose, *found, None)


def trusts(errors: Float, frames: float) -> bool:
    """Whether the library predicts this number of frames ahead, by past errors as in `ForecastErrors`."""
    ours, inert = errors[int(frames >= _FAR)]
    return bool(ours <= inert)


def _apart(pose: Pose, truth: Pose) -> float:
    """Sum of squares of turn (rad), shift (m) and angles (rad, each up to `_MOST`) between two poses."""
    turn = se3.log_rotation(pose.root[:3, :3].T @ truth.root[:3, :3])
    shift = pose.root[:3, 3] - truth.root[:3, 3]
    joints = np.minimum(np.abs(pose.q - truth.q), _MOST)
    return float(turn @ turn + shift @ shift + joints @ joints)
