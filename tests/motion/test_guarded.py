"""The library predicts while it proves itself; a person who does what it does not know goes on by inertia."""

from __future__ import annotations

import numpy as np
import pytest

from twistcap.arrays import Float
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.motion import FollowedMotion, MotionClip, MotionLibrary, motion_predictor
from twistcap.motion.guarded import ForecastErrors, GuardedMotion, trusts
from twistcap.predict import Moment
from twistcap.studio.motion import gait

BODY = humanoid("legs")
FPS = 60.0


def walking(seconds: float, speed: float) -> MotionClip:
    poses = gait(BODY, fps=FPS, frames=int(seconds * FPS), speed=speed)
    return MotionClip(
        "walk", BODY.coordinate_names, FPS, np.array([p.root for p in poses]), np.array([p.q for p in poses])
    )


def standing(count: int) -> MotionClip:
    """Somebody who stands with bent knees and hardly sways."""
    t = np.arange(count)[:, None]
    q: Float = 0.3 + 0.01 * np.sin(2 * np.pi * t / 150 + np.arange(len(BODY.coordinate_names)))
    return MotionClip("stand", BODY.coordinate_names, FPS, np.tile(np.eye(4), (count, 1, 1)), q)


def moments(clip: MotionClip) -> list[Moment]:
    return [Moment(k / FPS, pose) for k, pose in enumerate(clip.poses())]


def guarded() -> GuardedMotion:
    found = motion_predictor("guarded", MotionLibrary.of([walking(4.0, 1.1)], FPS), BODY)
    assert isinstance(found, GuardedMotion)
    return found


def seen(
    predictor: GuardedMotion, clip: MotionClip, frames: int, memory: ForecastErrors | None = None
) -> ForecastErrors:
    """What the predictor remembers once a clip has been seen."""
    history = moments(clip)
    for n in range(2, frames):
        _, memory = predictor.predict(history[:n], n / FPS, memory)
    assert memory is not None
    return memory


def test_a_walk_is_predicted_by_walking() -> None:
    predictor, clip = guarded(), walking(2.0, 1.4)
    history = moments(clip)[:60]
    found, memory = predictor.predict(history, 75 / FPS, seen(predictor, clip, 60))
    assert trusts(memory.errors, 15) and found.match is not None
    plain, _ = FollowedMotion(predictor.inner.library, BODY).predict(history, 75 / FPS)
    np.testing.assert_allclose(found.pose.q, plain.pose.q, atol=1e-9)


def test_one_who_stands_is_not_led_into_a_walk() -> None:
    predictor, clip = guarded(), standing(90)
    history, memory = moments(clip), seen(predictor, clip, 40)
    found, memory = predictor.predict(history[:40], 55 / FPS, memory)
    assert not trusts(memory.errors, 15) and found.match is None
    assert np.abs(found.pose.q - history[55].pose.q).max() < 0.02
    near, _ = predictor.predict(history[:40], 41 / FPS, memory)
    assert np.trace(near.covariance) < np.trace(found.covariance)
    np.testing.assert_allclose(found.covariance @ found.information, np.eye(BODY.dof), atol=1e-6)
    walked, _ = predictor.inner.predict(history[:40], 55 / FPS)
    assert np.abs(walked.pose.q - history[55].pose.q).max() > 0.05


def test_it_comes_back_when_the_person_walks_again() -> None:
    predictor = guarded()
    memory = seen(predictor, standing(60), 40)
    assert not trusts(memory.errors, 8)
    assert trusts(seen(predictor, walking(2.0, 1.2), 90, memory).errors, 8)


def test_a_history_is_needed() -> None:
    with pytest.raises(InputError, match="at least one moment"):
        guarded().predict([], 1.0)
