"""The motion between the last two frames goes on, or the body stays where it is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.estimate import Frame
from twistcap.predict import Prediction
from twistcap.predict.history import MotionNoise, Past, constant_velocity
from twistcap.ranges import Checked, Positive

DECAY = 0.2
"""s in which joint velocities die away, so that a limb that nothing shows comes to rest."""
INFLATION = 5.0
"""Factor on every claimed standard deviation: image samples are not independent, and no body is exact. Set on studio
captures with truth (docs/concepts/covariance.md)."""


@dataclass(frozen=True)
class Inertia(Checked):
    """Constant velocity, or with `hold` none; it always answers. `first_sigma_deg` and `first_sigma_m` are how far the
    given first pose may be off (turns; root place).
    """

    hold: bool = False
    first_sigma_deg: Positive = 1.0
    first_sigma_m: Positive = 0.005
    name: str = field(default="inertia", init=False)

    def start(self, body: Body, rig: Rig) -> None:
        """Nothing is remembered beside the past poses."""

    def predict(self, memory: None, past: Past, frame: Frame) -> tuple[Prediction, None]:
        return self.prediction(self.pose(past, frame.time), past, frame.time, self.kind(past)), None

    def learn(self, memory: None, fit: Fit, past: Past, frame: Frame) -> None:
        """Nothing."""

    def pose(self, past: Past, time: float) -> Pose:
        """Where the body is expected."""
        return past.last if self.hold else constant_velocity(past.moments, time, DECAY)

    def kind(self, past: Past) -> str:
        """Which noise the prediction has: one pose alone has no velocity."""
        return "hold" if self.hold or not past.moving else "constant_velocity"

    def prediction(self, pose: Pose, past: Past, time: float, name: str) -> Prediction:
        """A prediction at a pose, with the spread of this one, or of the given first pose."""
        dof, centre = 6 + len(pose.q), pose.root[:3, 3]
        if past.started:  # open-loop through gaps
            found = past.spread.covariance(dof, time - past.seen_time, self.kind(past), centre)
        else:
            turn = float(np.deg2rad(self.first_sigma_deg))
            given = MotionNoise(joint_speed=turn, turn_speed=turn, shift_speed=self.first_sigma_m)
            found = given.covariance(dof, 1.0, "hold", centre)
        covariance, information = found
        return Prediction(pose, name, INFLATION**2 * covariance, information)
