"""The tracker on predictions from training motion: without an image the answer is the prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twistcap.build import build
from twistcap.cues.observation import Agreement
from twistcap.cues.support import SupportRule
from twistcap.errors import InputError
from twistcap.hindsight import tracked
from twistcap.motion import MotionClip, MotionLibrary, motion_predictor
from twistcap.predict import Moment
from twistcap.studio import StudioConfig, capture
from twistcap.studio.motion import gait
from twistcap.track import Settings

FPS = 60.0


def test_without_an_image_the_answer_is_the_prediction() -> None:
    scene = capture(StudioConfig(seed=3, views=2, frames=12, variant="legs"))
    poses = gait(scene.body, fps=FPS, frames=120, speed=1.2)
    clip = MotionClip("walk", scene.body.coordinate_names, FPS, np.array([p.root for p in poses]),
                      np.array([p.q for p in poses]))  # fmt: skip
    library = MotionLibrary.of([clip], FPS)
    blind = {8, 9}
    frames = [replace(f, images=tuple(None for _ in f.images)) if f.index in blind else f for f in scene.frames()]
    model = build(scene.body, scene.rig, Settings(predictor="motion", motion="scaled"), motions=library)
    found = list(tracked(frames, model, scene.first_pose))
    seen, predictor = [Moment(e.time, e.pose) for e in found[:8]], motion_predictor("scaled", library, scene.body)
    for k in sorted(blind):
        expected, _ = predictor.predict(seen, frames[k].time)
        assert (found[k].status, found[k].predicted) == ("no_images", "motion")
        np.testing.assert_allclose(found[k].pose.q, expected.pose.q, atol=1e-9)
        np.testing.assert_allclose(found[k].pose.root, expected.pose.root, atol=1e-9)
        assert np.all(np.diag(found[k].covariance) >= np.diag(expected.covariance))
    assert np.all(np.diag(found[9].covariance)[6:] > np.diag(found[7].covariance)[6:])
    assert found[10].status != "no_images"
    assert np.degrees(np.abs(found[11].pose.q - scene.true_poses[11].q)).mean() < 3.0


def test_images_of_mere_noise_tell_nothing() -> None:
    """Each pixel is replaced for five frames: the track goes on by its prediction, as it would without images."""
    scene = capture(StudioConfig(seed=3, views=2, frames=16, variant="legs"))
    poses = gait(scene.body, fps=FPS, frames=120, speed=1.2)
    clip = MotionClip("walk", scene.body.coordinate_names, FPS, np.array([p.root for p in poses]),
                      np.array([p.q for p in poses]))  # fmt: skip
    rng, noisy = np.random.default_rng(0), range(10, 15)
    frames = [
        replace(f, images=tuple(None if i is None else rng.integers(0, 256, i.shape).astype(i.dtype) for i in f.images))
        if f.index in noisy
        else f
        for f in scene.frames()
    ]
    library = MotionLibrary.of([clip], FPS)
    model = build(scene.body, scene.rig, Settings(predictor="motion"), motions=library)
    found = list(tracked(frames, model, scene.first_pose))
    assert [found[k].status for k in noisy] == ["not_found"] * 5
    assert all(found[k].seen for k in (*range(10), 15))


def test_images_are_believed_as_far_as_more_agree_than_by_chance() -> None:
    rule, points = SupportRule(chance=0.1, sure=0.5), np.full(4, 25, np.int32)
    for good, trust in ((5.0, 0.0), (10.0, 0.0), (30.0, 0.5), (50.0, 1.0), (90.0, 1.0)):
        agreeing = np.full(4, good / 4)
        assert rule.trust(Agreement(points, agreeing, agreeing)) == pytest.approx(trust)
    none = np.zeros(4)
    assert rule.trust(Agreement(np.zeros(4, np.int32), none, none)) == 0.0


def test_a_library_must_be_given() -> None:
    scene = capture(StudioConfig(seed=3, views=2, frames=1, variant="legs"))
    with pytest.raises(InputError, match="go together"):
        build(scene.body, scene.rig, Settings(predictor="motion"))
