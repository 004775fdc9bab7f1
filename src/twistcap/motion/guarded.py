"""Prediction from training motion for as long as it proves itself; otherwise the person's own motion goes on.

A person who does what the library does not know is matched all the same, and led astray. So in each frame that was seen
two forecasts for it are judged that were made some frames before: the library's, and one of inertia, in which the last
velocity dies away. Whichever was nearer lately predicts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap import se3
from twistcap.body import Pose
from twistcap.motion.openloop import Expected, OpenLoop
from twistcap.predict import Moment, MotionNoise, constant_velocity, covariance_about

_AHEAD = 8  # frames by which the judged forecasts are made ahead
_MEMORY = 0.85  # share of past errors that counts in the next frame
_DECAY = 0.15  # s in which a velocity dies away


class GuardedMotion:
    """A predictor that yields to inertia where inertia does better.

    Args:
        inner: predictor from training motion.
        noise: of inertia.
    """

    def __init__(self, inner: OpenLoop, noise: MotionNoise | None = None) -> None:
        self.inner, self.noise = inner, noise or MotionNoise()
        self._last: Moment | None = None
        self._errors = np.zeros(2)  # squared, of the library and of inertia, fading

    @property
    def trusted(self) -> bool:
        """Whether the library predicts."""
        return bool(self._errors[0] <= self._errors[1])

    def predict(self, history: Sequence[Moment], time: float) -> Expected:
        """The pose at `time`; see `MotionPredictor`.

        Raises:
            InputError: for a history without moments.
        """
        seen = [moment for moment in history if moment.seen]
        if seen and seen[-1] is not self._last:
            self._last = seen[-1]
            self._judge(seen)
        return self.inner.predict(history, time) if self.trusted or len(seen) < 2 else self._inert(seen, time)

    def _judge(self, history: Sequence[Moment]) -> None:
        """Compare both forecasts of the last moment."""
        now = history[-1]
        made = now.time - (_AHEAD - 0.5) / self.inner.library.rate
        before = [moment for moment in history if moment.time <= made]
        if len(before) < 2:
            return
        forecasts = self.inner.predict(before, now.time).pose, constant_velocity(before, now.time, _DECAY)
        self._errors = _MEMORY * self._errors + [_apart(pose, now.pose) for pose in forecasts]

    def _inert(self, history: Sequence[Moment], time: float) -> Expected:
        pose, passed = constant_velocity(history, time, _DECAY), time - history[-1].time
        # Accelerations do not last: an unknown step grows with the square of the first moments only.
        lasting = min(passed, _DECAY) * passed
        variance = np.full(6 + len(pose.q), (self.noise.joint * lasting) ** 2)
        variance[:3], variance[3:6] = (self.noise.turn * lasting) ** 2, (self.noise.shift * lasting) ** 2
        return Expected(pose, *covariance_about(variance, pose.root[:3, 3]), None)


def _apart(pose: Pose, truth: Pose) -> float:
    """Sum of squares of turn (rad), shift (m) and angles (rad) between two poses."""
    turn = se3.log_rotation(pose.root[:3, :3].T @ truth.root[:3, :3])
    shift = pose.root[:3, 3] - truth.root[:3, 3]
    return float(turn @ turn + shift @ shift + np.sum((pose.q - truth.q) ** 2))
