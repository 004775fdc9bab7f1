"""A camera that has been bumped: the turn that its background tells, and when it is believed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twistcap.arrays import Bool, Float, Float32
from twistcap.camera import Camera
from twistcap.camera.bump import after_both, bumped, turned_back
from twistcap.search.backdrop import Backdrop
from twistcap.search.surroundings import Surroundings

SIZE = (160, 120)
K = np.array([[150.0, 0.0, 79.5], [0.0, 150.0, 59.5], [0.0, 0.0, 1.0]])
CAMERA = Camera("one", K, np.eye(4), SIZE)
FARTHEST = 0.1


def _room(seed: int) -> Float32:
    """(h, w, 3) of a wall with large and small things on it."""
    rng, out = np.random.default_rng(seed), np.zeros((SIZE[1], SIZE[0], 3))
    for blur in (1.5, 5.0, 20.0):
        out += cv2.GaussianBlur(rng.standard_normal(out.shape), (0, 0), blur) * blur
    return np.asarray(0.5 + 0.12 * out / out.std(), np.float32)


def _seen(room: Float32, turn: Float, rng: np.random.Generator) -> Float32:
    """The room with some noise, by the camera after a turn."""
    back = turned_back(room, CAMERA, -turn)  # as seen from the turned camera
    return np.asarray(back + 0.01 * rng.standard_normal(room.shape), np.float32)


def _learnt(room: Float32, rng: np.random.Generator) -> Backdrop:
    out = Backdrop.blank()
    for _ in range(4):
        out = out.learnt(_seen(room, np.zeros(3), rng), _beside())
    return out


def _beside(width: int = 0) -> Bool:
    """(h, w) all pixels but those of a body of some width."""
    out = np.ones(SIZE[::-1], np.bool_)
    out[20:110, 60 : 60 + width] = False
    return out


@pytest.mark.parametrize("seed", range(8))
def test_a_turn_is_found(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    axis, room = rng.standard_normal(3), _room(seed)
    turn = np.deg2rad(rng.uniform(0.5, 5.0)) * axis / np.linalg.norm(axis)
    backdrop, features = _learnt(room, rng), _seen(room, turn, rng)
    found = (view := Surroundings(CAMERA, backdrop, features, _beside())).turn(FARTHEST)
    assert np.rad2deg(np.linalg.norm(after_both(found, -turn))) < 0.03
    (before, _), (after, share) = view.fitting(np.zeros(3)), view.fitting(found)
    assert 1.0 - after < 0.3 * (1.0 - before) and share > 0.6


def test_a_body_and_somebody_else_do_not_hinder() -> None:
    rng, room, turn = np.random.default_rng(0), _room(0), np.deg2rad([0.8, -1.0, 0.4])
    backdrop, features = _learnt(room, rng), _seen(room, turn, rng)
    features[20:110, 60:90] = 0.1  # the body, which is known
    features[30:115, 110:140] = 0.9  # somebody else, who is not
    found = Surroundings(CAMERA, backdrop, features, _beside(30)).turn(FARTHEST)
    assert np.rad2deg(np.linalg.norm(after_both(found, -turn))) < 0.05


def test_a_camera_that_stands_still_has_no_turn() -> None:
    rng, room = np.random.default_rng(0), _room(0)
    found = Surroundings(CAMERA, _learnt(room, rng), _seen(room, np.zeros(3), rng), _beside()).turn(FARTHEST)
    assert np.rad2deg(np.linalg.norm(found)) < 0.02


def test_of_what_nothing_tells_there_is_no_turn() -> None:
    """Level stripes say nothing of a turn to the side."""
    rng, level = np.random.default_rng(0), np.deg2rad([1.0, 0.0, 0.0])
    room = np.repeat(_room(0)[:, :1], SIZE[0], axis=1)
    found = Surroundings(CAMERA, _learnt(room, rng), _seen(room, level, rng), _beside()).turn(FARTHEST)
    assert np.rad2deg(np.abs(found - level)).max() < 0.1


def test_another_room_does_not_fit() -> None:
    rng = np.random.default_rng(0)
    backdrop, features = _learnt(_room(0), rng), _seen(_room(1), np.zeros(3), rng)
    found = (view := Surroundings(CAMERA, backdrop, features, _beside())).turn(FARTHEST)
    assert view.fitting(found)[0] < 0.5


def test_pictures_are_turned_back_to_where_the_camera_was_calibrated() -> None:
    """A point of the room lies where the calibrated camera sees it."""
    turn, point = np.deg2rad([1.0, -2.0, 3.0]), np.array([0.3, 0.2, 4.0])
    image = np.zeros((SIZE[1], SIZE[0]), np.float32)
    (x, y), _ = bumped(CAMERA, turn).project(point)
    grid = np.mgrid[: SIZE[1], : SIZE[0]]
    image = np.exp(-0.5 * ((grid[1] - x) ** 2 + (grid[0] - y) ** 2) / 4.0).astype(np.float32)
    back = turned_back(image, CAMERA, turn)
    found = [float((g * back).sum() / back.sum()) for g in grid[::-1]]
    np.testing.assert_allclose(found, CAMERA.project(point)[0], atol=0.05)


def test_two_turns_one_after_the_other() -> None:
    """Of a camera that has made the second, then the first in the frame that it has by then."""
    first, second = np.deg2rad([1.0, -2.0, 0.5]), np.deg2rad([0.3, 0.4, -1.0])
    both = after_both(first, second)
    once = np.eye(3)
    for camera, turn in ((CAMERA, second), (bumped(CAMERA, second), first)):
        once = bumped(camera, turn).T_cam_world[:3, :3]
    np.testing.assert_allclose(bumped(CAMERA, both).T_cam_world[:3, :3], once, atol=1e-12)
