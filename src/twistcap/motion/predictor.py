"""Predictors from training motion by name, and any of them as a predictor of the tracker."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from twistcap.body import Body
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.estimate import Frame
from twistcap.motion.following import FollowedMotion
from twistcap.motion.guarded import GuardedMotion
from twistcap.motion.library import MotionLibrary
from twistcap.motion.openloop import MotionPredictor
from twistcap.motion.paper import PaperMotion
from twistcap.predict import Prediction
from twistcap.predict.history import Past
from twistcap.stages import stage

MotionKind = Literal["followed", "scaled", "unscaled", "standard", "guarded"]


def motion_predictor(kind: MotionKind, library: MotionLibrary, body: Body) -> MotionPredictor:
    """A predictor: "followed", the default (`FollowedMotion`), "guarded" (`GuardedMotion`), or a `PaperMotion`. Raises
    InputError where body and library have no coordinate in common, or the library is too small."""
    if kind == "guarded":
        return GuardedMotion(FollowedMotion(library, body))
    return FollowedMotion(library, body) if kind == "followed" else PaperMotion(library, body, kind)


@dataclass(frozen=True)
class TrainedMotion:
    """Predicts from training motion, once there are two frames with images."""

    motion: MotionPredictor
    name: str = field(default="motion", init=False)

    @property
    def memory_type(self) -> Any:
        """Type of its memory, for saving."""
        return self.motion.memory_type

    def start(self, body: Body, rig: Rig) -> Any:
        """No memory."""

    def predict(self, memory: Any, past: Past, frame: Frame) -> tuple[Prediction | None, Any]:
        """The pose expected by the training motion."""
        if not past.started or len(past.seen) < 2:
            return None, memory
        with stage("motion"):
            expected, memory = self.motion.predict(past.moments, frame.time, memory)
        name = "constant_velocity" if expected.match is None else self.name
        return Prediction(expected.pose, name, expected.covariance, expected.information), memory

    def learn(self, memory: Any, fit: Fit, past: Past, frame: Frame) -> Any:
        """Nothing to learn: the past poses are all that is used."""
        return memory
