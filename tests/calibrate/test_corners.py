"""Corners by the board's own picture, against where a drawn board truly has them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twistcap.arrays import Float, UInt8
from twistcap.calibrate.board import Board, board_of
from twistcap.calibrate.corners import refined
from twistcap.calibrate.detect import Detector, edge_width

BOARD = board_of("charuco:9x6:100:75:4X4_50")
LYING = np.array([[150.3, 110.7], [330.2, 90.4], [352.8, 196.9], [120.6, 209.3]])  # px of the board's corners
FLAT = np.array([[150.3, 150.7], [330.2, 140.4], [382.8, 196.9], [100.6, 209.3]])
SMALL = np.array([[150.3, 150.7], [260.2, 140.4], [272.8, 226.9], [140.6, 239.3]])


def drawn(board: Board, corners: Float, seed: int = 0) -> tuple[UInt8, Float]:
    """An image (320, 480) of a board whose corners are there, with blur and noise; the true pixels of its points."""
    fine, parts = 32, 6  # pixels of the picture for each square, of the image's pixel; none is passed over
    (w, h), rng = board.size, np.random.default_rng(seed)
    plane = np.array([[0, 0], [w, 0], [w, h], [0, h]])
    H = cv2.getPerspectiveTransform(plane.astype(np.float32), corners.astype(np.float32)).astype(float)
    to_plane = np.diag([board.square / fine, board.square / fine, 1.0])
    to_plane[:2, 2] = 0.5 * board.square / fine
    finer = np.diag([parts, parts, 1.0])
    finer[:2, 2] = 0.5 * (parts - 1)
    size = (480 * parts, 320 * parts)
    large = cv2.warpPerspective(board.image(fine), finer @ H @ to_plane, size, flags=cv2.INTER_AREA, borderValue=150)
    image = cv2.GaussianBlur(cv2.resize(large.astype(float), (480, 320), interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    image = 30.0 + 0.7 * image + 2.0 * rng.normal(size=image.shape)
    true = cv2.perspectiveTransform(board.points[None, :, :2], H)[0]
    return np.clip(np.round(image), 0, 255).astype(np.uint8), true


def off(pixels: Float, true: Float) -> float:
    """Root mean square of a coordinate, px."""
    return float(np.sqrt(np.mean((pixels - true) ** 2)))


@pytest.mark.parametrize("inverted", [False, True])
def test_corners_of_a_small_board_are_found_to_a_few_hundredths_of_a_pixel(inverted: bool) -> None:
    """All of them: the tags of some are too small to be read. Each square is 20 px wide."""
    board = Board("charuco", 9, 6, 0.1, 0.075, inverted=inverted)
    image, true = drawn(board, LYING)
    found = Detector(board)(image)
    assert found is not None and len(found) == len(true)
    assert off(found.pixels, true[found.ids]) < 0.012


@pytest.mark.parametrize(("corners", "bar"), [(LYING, 0.012), (FLAT, 0.035), (SMALL, 0.017)])
def test_corners_that_err_in_common_do_not_pull_those_found_by_them(corners: Float, bar: float) -> None:
    """The picture is drawn by the first corners; here they turn the board by two degrees."""
    image, true = drawn(BOARD, corners)
    ids, rng = np.arange(len(true), dtype=np.int32), np.random.default_rng(0)
    turned = true.mean(axis=0) + (true - true.mean(axis=0)) @ np.array([[1.0, 0.03], [-0.03, 1.0]])
    start = turned + 0.15 * rng.normal(size=true.shape)
    found, pixels = refined(image, BOARD, ids, start, edge_width(image, start))
    assert len(found) >= len(ids) - 1 and off(pixels, true[found]) < bar


def test_wrong_corners_are_left_out_or_mended() -> None:
    image, true = drawn(BOARD, LYING)
    ids, rng = np.arange(len(true), dtype=np.int32), np.random.default_rng(1)
    start = true + 0.3 * rng.normal(size=true.shape)
    start[[3, 17]] += 7.0
    found, pixels = refined(image, BOARD, ids, start, 2.2)
    assert len(found) >= len(ids) - 2 and np.linalg.norm(pixels - true[found], axis=1).max() < 0.15


def test_corners_beside_the_image_are_left_out() -> None:
    image, true = drawn(BOARD, LYING)
    found, pixels = refined(image, BOARD, np.arange(len(true), dtype=np.int32), true - 1000.0, 2.2)
    assert len(found) == len(pixels) == 0


def test_corners_without_an_edge_stay_as_they_were_found() -> None:
    image, true = drawn(BOARD, LYING)
    found, pixels = refined(image, BOARD, np.arange(len(true), dtype=np.int32), true, np.inf)
    assert len(found) == len(true) and np.array_equal(pixels, true)


def test_corners_that_are_hidden_or_half_in_the_image_are_left_out() -> None:
    image, true = drawn(BOARD, LYING)
    edge = int(true[4, 0])
    image = np.ascontiguousarray(image[:, :edge])  # through a column of corners
    hand = true[9].astype(int)
    image[hand[1] - 8 : hand[1] + 9, hand[0] - 9 : hand[0] + 10] = 120
    inside = np.flatnonzero(true[:, 0] < edge - 12).astype(np.int32)
    found, pixels = refined(image, BOARD, inside, true[inside], 2.2)
    assert 9 not in found and 15 < len(found) < len(true)
    assert np.linalg.norm(pixels - true[found], axis=1).max() < 0.2
