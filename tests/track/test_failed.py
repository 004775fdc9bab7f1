"""A frame whose numbers cannot be computed is failed and lost; the track goes on, and comes back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from twistcap.build import build, of_method
from twistcap.cues import Evidence, Fit, Level, Sight
from twistcap.differential.step import _Follow
from twistcap.errors import InputError
from twistcap.io.state import from_bytes, to_bytes
from twistcap.predict import Prediction
from twistcap.predict.history import Past
from twistcap.studio import StudioConfig, capture
from twistcap.track import Model, Settings, step

FRAMES = 5
ERRORS = (
    np.linalg.LinAlgError("Singular matrix"),
    FloatingPointError("overflow"),
    ValueError("NaN"),
    ZeroDivisionError(),
)


@dataclass(frozen=True)
class FaultyCue:
    """Raises where it is told to."""

    error: Exception | None = None
    where: str = ""
    name: str = field(default="faulty", init=False)

    def start(self, body: object, rig: object) -> int:
        return 0

    def measure(self, sight: Sight, memory: int, level: Level) -> Evidence | None:
        if self.error is not None and self.where == "measure":
            raise self.error
        return None

    def learn(self, memory: int, fit: Fit, lesson: int) -> int:
        if self.error is not None and self.where == "learn":
            raise self.error
        return memory + 1


@dataclass(frozen=True)
class FaultyPredictor:
    """Raises, or leaves the frame to the next one."""

    error: Exception | None = None
    name: str = field(default="faulty", init=False)

    def start(self, body: object, rig: object) -> int:
        return 0

    def predict(self, memory: int, past: Past, frame: object) -> tuple[Prediction | None, int]:
        if self.error is not None:
            raise self.error
        return None, memory

    def learn(self, memory: int, fit: Fit, past: Past, frame: object) -> int:
        return memory + 1


@lru_cache
def scene() -> Any:
    return capture(StudioConfig(seed=3, views=2, frames=FRAMES, size=(192, 140)))


def model_with(error: Exception | None, where: str) -> Model:
    model = build(scene().body, scene().rig)
    if where == "predict":
        return replace(model, predictors=(FaultyPredictor(error), *model.predictors))
    return replace(model, cues=(*model.cues, FaultyCue(error, where)))


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize(("where", "at"), [("measure", 0), ("measure", 2), ("learn", 3), ("predict", 2)])
def test_one_frame_fails_and_the_track_goes_on(
    error: Exception, where: str, at: int, caplog: pytest.LogCaptureFixture
) -> None:
    sound, faulty = model_with(None, where), model_with(error, where)
    state, lost = sound.start(scene().first_pose), list[bool]()
    for k, frame in enumerate(scene().frames()):
        before = state
        state, estimate = step(before, frame, faulty if k == at else sound)
        lost.append(estimate.lost)
        if k == at:
            expected = sound.predictors[-1].predict(None, before.past, frame)[0]
            assert expected is not None and estimate.status == "failed" and estimate.support == 0.0
            np.testing.assert_array_equal(estimate.pose.q, expected.pose.q)
            assert np.isfinite(estimate.covariance).all() and np.trace(estimate.covariance) >= np.trace(before.claimed)
            assert state.cues == before.cues and not state.past.moments[-1].seen
            state, _ = from_bytes(to_bytes(state), sound)  # it can be resumed from here
        else:
            assert estimate.status != "failed"
    assert lost == [k == at for k in range(FRAMES)]
    assert np.degrees(np.abs(estimate.pose.minus(scene().true_poses[-1])[6:]).mean()) < 5.0
    assert f"frame {at} failed ({type(error).__name__}" in caplog.text


def test_bad_input_is_no_failed_frame() -> None:
    model = model_with(InputError("a mistake of the user."), "measure")
    with pytest.raises(InputError, match="of the user"):
        step(model.start(scene().first_pose), scene().frame(0), model)


@pytest.mark.parametrize("at", [0, 2])
def test_brightness_alone_fails_alike(at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    model = of_method(scene().body, scene().rig, Settings(method="differential"))
    state, statuses, original = model.start(scene().first_pose), list[str](), _Follow._learned

    def remembered(self: _Follow, *arguments: Any) -> Any:
        if len(statuses) == at and any(picture is not None for picture in self.pictures):
            raise np.linalg.LinAlgError("Singular matrix")
        return original(self, *arguments)

    monkeypatch.setattr(_Follow, "_learned", remembered)
    for frame in scene().frames():
        state, estimate = step(state, frame, model)
        statuses.append(estimate.status)
        assert estimate.lost == (estimate.status == "failed") and np.isfinite(estimate.covariance).all()
    assert [status == "failed" for status in statuses] == [k == at for k in range(FRAMES)]
