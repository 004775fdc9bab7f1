"""The tracker: a pure step from one frame to the next."""

from __future__ import annotations

from typing import Any

from twistcap.body import Pose
from twistcap.differential.model import DifferentialModel
from twistcap.estimate import Estimate, Frame
from twistcap.settings import Settings
from twistcap.stages import next_frame
from twistcap.track.model import Model
from twistcap.track.state import State
from twistcap.track.step import step

__all__ = ["Model", "Settings", "State", "Tracker", "step"]


class Tracker:
    """A model and the state that it has reached, for those who want each estimate at once; see `hindsight.tracked`."""

    def __init__(self, model: Model | DifferentialModel) -> None:
        self.model = model
        self.state: Any = model.start(Pose.rest(model.body))

    def start(self, pose: Pose, time: float = 0.0) -> None:
        """Take the pose from which the first frame is tracked."""
        self.state = self.model.start(pose, time)

    def step(self, frame: Frame) -> Estimate:
        """Track one frame."""
        next_frame()
        self.state, estimate = step(self.state, frame, self.model)
        return estimate
