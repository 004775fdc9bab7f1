"""Where the body is expected in the next frame. One file for each predictor; this is what a predictor is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from twistcap.arrays import Float
from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.estimate import Frame
from twistcap.predict.history import Moment, MotionNoise, MotionSpread, Past

__all__ = ["Moment", "MotionNoise", "MotionSpread", "Past", "Prediction", "Predictor"]


@dataclass(frozen=True)
class Prediction:
    """Where the body is expected.

    Attributes:
        pose: there.
        name: of what predicted it, as the estimate reports it.
        covariance: (6 + J, 6 + J) of the step from the last pose's prediction to the truth, as it is claimed.
        information: (6 + J, 6 + J) with which the pose is drawn to the prediction.
    """

    pose: Pose
    name: str
    covariance: Float
    information: Float


class Predictor(Protocol):
    """A predictor; the first of a model's that answers is believed. It holds settings only, its memory is a value."""

    @property
    def name(self) -> str:
        """Its name in the state."""
        ...

    def start(self, body: Body, rig: Rig) -> Any:
        """The memory before the first frame; as a cue's."""

    def predict(self, memory: Any, past: Past, frame: Frame) -> tuple[Prediction | None, Any]:
        """The prediction for a frame, None where there is none, and the memory after it."""
        ...

    def learn(self, memory: Any, fit: Fit, past: Past, frame: Frame) -> Any:
        """The memory after a frame that was tracked; `past` holds it already."""
