"""The watch on cameras' clocks and places: sums of a tracked body's contours."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from twistcap import se3
from twistcap.adjust.watch import KNOCK, CameraWatch, Watched
from twistcap.arrays import UInt8
from twistcap.build import build
from twistcap.estimate import Frame
from twistcap.io.state import from_bytes, to_bytes
from twistcap.predict.inertia import INFLATION
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Tracker

FRAMES, EVERY = 36, 2  # frames that are tracked, of a capture of as many times the rate
LATE = 1


@cache
def _walk() -> Capture:
    return capture(StudioConfig(seed=3, views=4, frames=EVERY * (FRAMES + 2), fps=60.0 * EVERY))


@cache
def _image(moment: int, camera: int) -> UInt8 | None:
    return _walk().image(moment, camera)


@pytest.fixture(scope="module")
def scene() -> Capture:
    return _walk()


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
        images = [_image(EVERY * k + (moments if c == LATE else 0), c) for c in range(4)]
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


@pytest.mark.parametrize(
    ("turn_deg", "sigmas", "named"),
    [
        ((0.02, 0.2, 0.03, 0.02), (0.5, 4.0, 1.0, 2.0), [1]),  # a little, but surely, and more surely than any other
        ((0.02, 0.2, 0.03, 0.02), (0.5, 4.0, 1.0, 5.0), []),
        ((0.02, 0.2, 0.03, 0.02), (0.5, 2.5, 1.0, 2.0), []),
        ((0.02, 0.1, 0.03, 0.02), (0.5, 4.0, 1.0, 2.0), []),
        ((0.02, 0.4, 0.03, 0.02), (0.5, 2.5, 1.0, 3.0), [1]),  # clearly
        ((0.10, 0.2, 0.09, 0.08), (0.5, 4.0, 1.0, 2.0), []),  # as all do: the body does not fit
    ],
)
def test_a_camera_stands_elsewhere_by_much_or_surely(
    scene: Capture, turn_deg: tuple[float, ...], sigmas: tuple[float, ...], named: list[int]
) -> None:
    turn = np.deg2rad(turn_deg)
    information, step = np.zeros((4, 6, 6)), np.zeros((4, 6))
    information[:, 2, 2], step[:, 2] = (INFLATION * np.array(sigmas) / turn) ** 2, turn
    gradient = np.einsum("cij,cj->ci", information + np.diag((INFLATION / KNOCK) ** 2), step)
    seen = replace(CameraWatch().start(scene.body, scene.rig), places=(information, gradient))
    assert np.flatnonzero(seen.elsewhere()).tolist() == named
