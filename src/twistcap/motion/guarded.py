"""Prediction from training motion for as long as it proves itself; otherwise the person's own motion goes on.

A person who does what the library does not know is matched all the same, and led astray. So in each frame that was seen
forecasts for it are judged that were made before: the library's, and those of inertia, in which the last velocity dies
away. Whichever was nearer lately predicts. One frame ahead inertia is hard to beat; it is over a gap that the library
is needed, and there it is judged by forecasts from farther back.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap import se3
from twistcap.body import Pose
from twistcap.motion.openloop import Expected, OpenLoop
from twistcap.predict import Leeway, Moment, MotionNoise, constant_velocity

_AHEAD = (1, 8)  # frames by which the judged forecasts are made ahead
_FAR = 3  # frames from which on the farther ones tell
_MEMORY = 0.85  # share of past errors that counts in the next frame
_MOST = 0.3  # rad that one joint counts at most: a limb that was lost must not decide for the whole body
_DECAY = 0.15  # s in which a velocity dies away


class GuardedMotion:
    """A predictor that yields to inertia where inertia does better.

    Args:
        inner: predictor from training motion.
        noise: of inertia.
    """

    def __init__(self, inner: OpenLoop, noise: MotionNoise | None = None) -> None:
        self.inner, self._noise = inner, noise or MotionNoise()
        self._last: Moment | None = None
        self._leeway: Leeway | None = None
        self._errors = np.zeros((len(_AHEAD), 2))  # squared, of the library and of inertia, fading

    def trusts(self, frames: float) -> bool:
        """Whether the library predicts so many frames ahead."""
        ours, inert = self._errors[int(frames >= _FAR)]
        return bool(ours <= inert)

    def predict(self, history: Sequence[Moment], time: float) -> Expected:
        """The pose at `time`; see `MotionPredictor`.

        Raises:
            InputError: for a history without moments.
        """
        seen = [moment for moment in history if moment.seen]
        if len(seen) < 2:
            return self.inner.predict(history, time)
        if seen[-1] is not self._last:
            self._last = seen[-1]
            self._judge(seen)
        ahead = (time - seen[-1].time) * self.inner.library.rate
        return self.inner.predict(history, time) if self.trusts(ahead) else self._inert(seen, time)

    def _judge(self, history: Sequence[Moment]) -> None:
        """Compare the forecasts of the last moment."""
        now, frame = history[-1], 1.0 / self.inner.library.rate
        for errors, ahead in zip(self._errors, _AHEAD, strict=True):
            before = [moment for moment in history if moment.time <= now.time - (ahead - 0.5) * frame]
            if len(before) < 2:
                continue
            inert = constant_velocity(before, now.time, _DECAY)
            forecasts = self.inner.predict(before, now.time).pose, inert
            errors[:] = _MEMORY * errors + [_apart(pose, now.pose) for pose in forecasts]
            if ahead == _AHEAD[0]:
                self._given(now.pose).learn(inert, now.pose, now.time - before[-1].time, "constant_velocity")

    def _inert(self, history: Sequence[Moment], time: float) -> Expected:
        pose, passed = constant_velocity(history, time, _DECAY), time - history[-1].time
        # Accelerations do not last: an unknown step grows with the square of the first moments only.
        lasting = np.sqrt(min(passed, _DECAY) * passed)
        found = self._given(pose).covariance(lasting, "constant_velocity", pose.root[:3, 3])
        return Expected(pose, *found, None)

    def _given(self, pose: Pose) -> Leeway:
        self._leeway = self._leeway or Leeway(self._noise, 6 + len(pose.q))
        return self._leeway


def _apart(pose: Pose, truth: Pose) -> float:
    """Sum of squares of turn (rad), shift (m) and angles (rad) between two poses; each angle counts up to _MOST."""
    turn = se3.log_rotation(pose.root[:3, :3].T @ truth.root[:3, :3])
    shift = pose.root[:3, 3] - truth.root[:3, 3]
    joints = np.minimum(np.abs(pose.q - truth.q), _MOST)
    return float(turn @ turn + shift @ shift + joints @ joints)
