"""The watch on cameras' clocks and places: sums of a tracked body's contours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twistcap import se3
from twistcap.adjust.watch import CameraWatch, Watched
from twistcap.build import build
from twistcap.estimate import Frame
from twistcap.io.state import from_bytes, to_bytes
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Tracker

FRAMES, EVERY = 36, 2  # frames that are tracked, of a capture of as many times the rate
LATE = 1


@pytest.fixture(scope="module")
def scene() -> Capture:
    return capture(StudioConfig(seed=3, views=4, frames=EVERY * (FRAMES + 2), fps=60.0 * EVERY))


def watched(scene: Capture, moments: int = 0, turned_deg: float = 0.0) -> Watched:
    """After frames in which one camera is late by so many moments of half a frame, or turned about its viewing axis."""
    turn = se3.exp(np.deg2rad([0.0, 0.0, turned_deg, 0.0, 0.0, 0.0]))
    there = replace(scene.rig[LATE], T_cam_world=turn @ scene.rig[LATE].T_cam_world)
    cameras = (*scene.rig.cameras[:LATE], there, *scene.rig.cameras[LATE + 1 :])
    model = build(scene.body, replace(scene.rig, cameras=cameras))
    model = replace(model, cues=(*model.cues, CameraWatch()))
    tracker = Tracker(model)
    tracker.start(scene.first_pose, 0.0)
    for k in range(FRAMES):
        if k == FRAMES // 2:  # what is remembered outlives an interruption
            tracker.state, _ = from_bytes(to_bytes(tracker.state), model)
        images = [scene.image(EVERY * k + (moments if c == LATE else 0), c) for c in range(4)]
        tracker.step(Frame(k, k / 60.0, tuple(images)))
    memory = tracker.state.cues["camera watch"]
    assert isinstance(memory, Watched)
    return memory


def test_a_late_camera_is_conspicuous_and_cameras_in_step_are_not(scene: Capture) -> None:
    right = watched(scene)
    assert not right.out_of_step().any() and np.all(right.since == -1)
    late = watched(scene, 2)  # by a frame
    assert late.out_of_step()[LATE] and late.lateness()[0][LATE] > 0


def test_a_camera_that_was_turned_about_its_viewing_axis_is_suspected(scene: Capture) -> None:
    """The body stays where it is in the image, so that nothing else tells it; the camera that faces it may be wrong."""
    since = watched(scene, turned_deg=2.0).since
    assert 0 < since[LATE] <= 30 and np.all(since[[LATE - 1, LATE + 1]] == -1)


def test_nothing_seen_says_nothing(scene: Capture) -> None:
    nothing = CameraWatch().start(scene.body, scene.rig)
    assert not nothing.out_of_step().any() and not nothing.elsewhere().any()
