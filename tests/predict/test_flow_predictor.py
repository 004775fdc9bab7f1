"""The flow predictor: the pose that optic flow leads to, and when it is not believed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from twistcap.body import Pose, Posed
from twistcap.build import build
from twistcap.predict.flow import FlowPredictor
from twistcap.predict.history import MotionNoise
from twistcap.settings import PredictorName
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Settings, Tracker

DT = 0.04


@cache
def walk() -> Capture:
    """Two frames of a quick walk, exact."""
    return capture(StudioConfig(seed=2, views=2, frames=4, fps=1 / DT))


def predicted(scene: Capture, shown: int) -> Pose | None:
    """Where flow leads from frame 0 to what frame `shown` shows; without it the body is expected to stand still."""
    first, then = scene.frame(0), scene.frame(shown)
    pose = scene.true_poses[0]
    _, information = MotionNoise().covariance(scene.body.dof, DT, "hold", pose.root[:3, 3])
    flow = FlowPredictor(scene.rig)
    last = flow.last_frame(Posed(scene.body, pose), first, range(len(scene.rig)))
    return flow.followed(last, then, pose, information)


def landmarks_off(scene: Capture, pose: Pose, frame: int) -> float:
    here, there = Posed(scene.body, pose).landmarks, Posed(scene.true_body, scene.true_poses[frame]).landmarks
    return float(np.linalg.norm(here - there, axis=1).mean())


def test_flow_takes_the_body_along() -> None:
    scene = walk()
    pose = predicted(scene, 1)
    assert pose is not None
    standing = landmarks_off(scene, scene.true_poses[0], 1)
    assert standing > 0.03 and landmarks_off(scene, pose, 1) < 0.25 * standing


def test_what_the_way_back_does_not_confirm_is_not_believed() -> None:
    """Noise moves nowhere: too few vectors agree there and back, and the predictor says that it has nothing to say."""
    scene = walk()
    rng = np.random.default_rng(0)
    pose = scene.true_poses[0]
    images = tuple(rng.integers(0, 256, np.shape(image), dtype=np.uint8) for image in scene.frame(0).images)
    flow, first = FlowPredictor(scene.rig), scene.frame(0)
    last = flow.last_frame(Posed(scene.body, pose), first, range(len(scene.rig)))
    for shown in (images, (None, None)):
        assert flow.followed(last, replace(first, images=shown), pose, np.eye(scene.body.dof)) is None


@pytest.mark.parametrize(
    ("predictor", "words"),
    [
        ("constant_velocity", ["hold", "flow", "constant_velocity", "constant_velocity"]),
        ("flow", ["hold", "flow", "flow", "flow"]),
        ("hold", ["hold", "hold", "hold", "hold"]),
    ],
)
def test_the_estimate_says_what_predicted_it(predictor: PredictorName, words: list[str]) -> None:
    scene = walk()
    tracker = Tracker(build(scene.body, scene.rig, Settings(predictor=predictor)))
    tracker.start(scene.first_pose)
    assert [tracker.step(scene.frame(k)).predicted for k in range(4)] == words
