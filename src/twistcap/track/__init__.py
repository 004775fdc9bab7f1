"""The tracker: a pure step from one frame to the next."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from twistcap.body import Pose
from twistcap.cues import Cue
from twistcap.differential.model import DifferentialModel
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.priors import Prior
from twistcap.settings import Settings
from twistcap.track.model import Model
from twistcap.track.state import State
from twistcap.track.step import step

__all__ = ["Model", "Settings", "State", "Tracker", "step", "track"]


class Tracker:
    """A model and the state that it has reached, for those who go frame by frame."""

    def __init__(self, model: Model | DifferentialModel) -> None:
        self.model = model
        self.state: Any = model.start(Pose.rest(model.body))

    def start(self, pose: Pose, time: float = 0.0) -> None:
        """Take the pose from which the first frame is tracked."""
        self.state = self.model.start(pose, time)

    def step(self, frame: Frame) -> Estimate:
        """Track one frame."""
        self.state, estimate = step(self.state, frame, self.model)
        return estimate


def track(
    frames: Iterable[Frame], model: Model | DifferentialModel, first_pose: Pose, *,
    cues: Sequence[Cue] = (), priors: Sequence[Prior] = (),
) -> Iterator[Estimate]:  # fmt: skip
    """Track a body through frames, one estimate each; with cues and priors of your own beside the model's.

    Raises:
        InputError: for cues or priors beside a model that has none, the differential one.
    """
    if cues or priors:
        if isinstance(model, DifferentialModel):
            raise InputError("track: the differential tracker takes neither cues nor priors; leave them out.")
        model = replace(model, cues=(*model.cues, *cues), priors=(*model.priors, *priors))
    return _tracked(frames, Tracker(model), first_pose)


def _tracked(frames: Iterable[Frame], tracker: Tracker, first_pose: Pose) -> Iterator[Estimate]:
    for k, frame in enumerate(frames):
        if k == 0:
            tracker.start(first_pose, frame.time)
        yield tracker.step(frame)
