"""What is said of a calibration: the distances that a wrong square spoils, and a board of unlike scale."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.boards import BIG, SIZE, carried, filmed, ring_rig
from twistcap.calibrate.advice import sentences
from twistcap.calibrate.board import Board
from twistcap.calibrate.calibrate import Calibration, Options, of_sightings
from twistcap.calibrate.detect import Detector
from twistcap.calibrate.sightings import Sighting
from twistcap.camera import Camera, Rig

QUICK = Options(kinds=("brown",), clocks=False)


def calibrated(rig: Rig, sightings: list[Sighting], board: Board) -> Calibration:
    return of_sightings(sightings, board, rig.names, dict.fromkeys(range(len(rig)), SIZE), QUICK)


@pytest.mark.parametrize(("square", "odd"), [(0.12, False), (0.009, True), (1.2, True)])
def test_the_distances_that_the_square_says_are_told(square: float, odd: bool) -> None:
    """Cameras are 4 to 6 m apart; of squares that are much smaller or ten times as large, that is doubted."""
    made = filmed(2, moments=30)
    board = replace(BIG, square=square, marker=0.75 * square)
    (told,) = [s for s in sentences(calibrated(made.rig, made.sightings, board)) if s.startswith("By ")]
    pairs = [np.linalg.norm(a.centre - b.centre) for a in made.rig for b in made.rig if a is not b]
    found = re.match(r"By ([\d.]+) mm a square, the cameras are ([\d.]+) to ([\d.]+) m apart and the board was", told)
    assert found is not None, told
    numbers = np.array([float(word) for word in found.groups()])
    np.testing.assert_allclose(numbers, square / 0.12 * np.array([120.0, min(pairs), max(pairs)]), rtol=0.02, atol=0.01)
    assert ("hardly so. Measure the squares" in told) is odd
    assert ("pictures do not tell the scale" in told) is not odd


def rendered(camera: Camera, T: np.ndarray, higher: float, noise: np.random.Generator) -> np.ndarray:
    """(H, W) the board at T as a pinhole sees it, printed `higher` times as high as its squares say."""
    fine, parts = 60, 3
    to_plane = np.diag([BIG.square / fine, higher * BIG.square / fine, 1.0])
    to_plane[:2, 2] = 0.5 * BIG.square / fine * np.array([1.0, higher])
    finer = np.diag([parts, parts, 1.0])
    finer[:2, 2] = 0.5 * (parts - 1)
    H = finer @ camera.K @ (camera.T_cam_world @ T)[:3, [0, 1, 3]] @ to_plane
    size = (parts * SIZE[0], parts * SIZE[1])
    large = cv2.warpPerspective(BIG.image(fine), H, size, flags=cv2.INTER_LINEAR, borderValue=150)
    image = cv2.GaussianBlur(cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA).astype(float), (0, 0), 0.7)
    return np.clip(np.round(30.0 + 0.7 * image + 2.0 * noise.normal(size=image.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("higher", [1.0, 0.99])
def test_a_board_that_was_printed_at_unlike_scale_is_told_from_its_pictures(higher: float) -> None:
    rng, find = np.random.default_rng(4), Detector(BIG)
    rig = Rig(tuple(replace(c, dist=np.zeros(5)) for c in ring_rig(2, rng, distance=2.2, arc=1.2)))
    seen = list[Sighting]()
    for moment, T in enumerate(carried(rng, 0.4) for _ in range(26)):
        for c, camera in enumerate(rig):
            middle = T[:3, :3] @ BIG.points.mean(axis=0) + T[:3, 3]
            if (middle - camera.centre) @ T[:3, 2] > 0.5 * np.linalg.norm(middle - camera.centre):
                found = find(rendered(camera, T, higher, rng))
                if found is not None:
                    seen.append(Sighting(c, moment, found.ids, found.pixels, found.blur))
    told = [s for s in sentences(calibrated(rig, seen, BIG)) if "than its width says" in s]
    assert len(told) == (higher != 1.0)
    for sentence in told:
        match = re.match(r"The board is ([\d.]+) ± ([\d.]+) % (higher|lower)", sentence)
        assert match is not None and match[3] == ("higher" if higher > 1 else "lower"), sentence
        assert float(match[1]) == pytest.approx(1.0, abs=0.2) and float(match[2]) < 0.25
