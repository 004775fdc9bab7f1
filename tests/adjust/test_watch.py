"""The watch on cameras' clocks: sums of a tracked body's contours."""

from __future__ import annotations

from dataclasses import replace

import pytest

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


def watched(scene: Capture, moments: int) -> Watched:
    """After frames in which one camera is late by so many moments of half a frame."""
    model = build(scene.body, scene.rig)
    model = replace(model, cues=(*model.cues, CameraWatch()))
    tracker = Tracker(model)
    tracker.start(scene.first_pose, 0.0)
    for k in range(FRAMES):
        if k == FRAMES // 2:  # what is remembered outlives an interruption
            tracker.state = from_bytes(to_bytes(tracker.state), model)
        images = [scene.image(EVERY * k + (moments if c == LATE else 0), c) for c in range(4)]
        tracker.step(Frame(k, k / 60.0, tuple(images)))
    memory = tracker.state.cues["camera watch"]
    assert isinstance(memory, Watched)
    return memory


def test_a_late_camera_is_conspicuous_and_cameras_in_step_are_not(scene: Capture) -> None:
    assert not watched(scene, 0).out_of_step().any()
    late = watched(scene, 2)  # by a frame
    assert late.out_of_step()[LATE] and late.lateness()[0][LATE] > 0


def test_nothing_seen_says_nothing(scene: Capture) -> None:
    nothing = CameraWatch().start(scene.body, scene.rig)
    assert not nothing.out_of_step().any()
