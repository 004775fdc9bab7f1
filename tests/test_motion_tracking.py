"""The tracker on predictions from training motion: without an image the answer is the prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twistcap.errors import InputError
from twistcap.motion import MotionClip, MotionLibrary, motion_predictor
from twistcap.predict import Moment
from twistcap.settings import TrackerConfig
from twistcap.studio import StudioConfig, capture
from twistcap.studio.motion import gait
from twistcap.track import Tracker, track

FPS = 60.0


def test_without_an_image_the_answer_is_the_prediction() -> None:
    scene = capture(StudioConfig(seed=3, views=2, frames=12, variant="legs"))
    poses = gait(scene.body, fps=FPS, frames=120, speed=1.2)
    clip = MotionClip("walk", scene.body.coordinate_names, FPS, np.array([p.root for p in poses]),
                      np.array([p.q for p in poses]))  # fmt: skip
    library = MotionLibrary.of([clip], FPS)
    blind = {8, 9}
    frames = [replace(f, images=tuple(None for _ in f.images)) if f.index in blind else f for f in scene.frames()]
    config = TrackerConfig(predictor="motion", motion="scaled")
    found = list(track(frames, scene.body, scene.rig, scene.first_pose, config, motions=library))
    seen = [Moment(e.time, e.pose) for e in found[:8]]
    for k in sorted(blind):
        told = motion_predictor("scaled", library, scene.body).predict(seen, frames[k].time)
        assert (found[k].status, found[k].predicted) == ("no_images", "motion")
        np.testing.assert_allclose(found[k].pose.q, told.pose.q, atol=1e-9)
        np.testing.assert_allclose(found[k].pose.root, told.pose.root, atol=1e-9)
        assert np.all(np.diag(found[k].covariance) >= np.diag(told.covariance))
    assert np.all(np.diag(found[9].covariance)[6:] > np.diag(found[7].covariance)[6:])
    assert found[10].status != "no_images"
    assert np.degrees(np.abs(found[11].pose.q - scene.true_poses[11].q)).mean() < 3.0


def test_a_library_must_be_given() -> None:
    scene = capture(StudioConfig(seed=3, views=2, frames=1, variant="legs"))
    with pytest.raises(InputError, match="go together"):
        Tracker(scene.body, scene.rig, TrackerConfig(predictor="motion"))
