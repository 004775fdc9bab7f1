"""A board's points in an image; OpenCV finds them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Bool, Float, Int, UInt8
from twistcap.calibrate.board import Board
from twistcap.calibrate.corners import refined

_FEWEST = 6  # points of a board by which its place is found
_OFF_PLANE = 0.05  # of the board's extent in the image, by which lenses may bend it


@dataclass(frozen=True)
class Found:
    """Points of a board in one image: their ids (N,), pixels (N, 2), and the mean width of the edges there, px."""

    ids: Int
    pixels: Float
    blur: float

    def __len__(self) -> int:
        return len(self.ids)

    def kept(self, which: AnyArray) -> Found:
        """Those of a mask or of indices."""
        return replace(self, ids=self.ids[which], pixels=self.pixels[which])


@dataclass(frozen=True)
class Detector:
    """Finds one board in images."""

    board: Board

    def __call__(self, image: UInt8) -> Found | None:
        """The board in an image (H, W[, 3]); None where fewer than six of its points are seen."""
        grey = in_grey(image)
        if self.board.inverted:
            grey = np.asarray(255 - grey, np.uint8)
        ids, pixels = self._finder(grey)
        found = Found(ids, pixels, 0.0)
        if len(found) >= _FEWEST:
            extent = float(np.ptp(pixels, axis=0).max())
            found = found.kept(on_one_plane(self.board.points[ids, :2], pixels, max(2.0, _OFF_PLANE * extent)))
        if len(found) < _FEWEST or _in_one_line(self.board.points[found.ids, :2]):
            return None
        return self._refined(grey, replace(found, blur=edge_width(grey, found.pixels)))

    def _refined(self, grey: UInt8, found: Found) -> Found:
        """With corners by the board's picture; as they were found where these are fewer. Tags have no saddles."""
        if self.board.kind == "aruco":
            return found
        shown = np.asarray(255 - grey if self.board.inverted else grey, np.uint8)
        ids, pixels = refined(shown, self.board, found.ids, found.pixels, found.blur)
        return replace(found, ids=ids, pixels=pixels) if len(ids) >= _FEWEST else found

    def _finder(self, grey: UInt8) -> tuple[Int, Float]:
        kind = self.board.kind
        return (self._chess if kind == "chessboard" else self._charuco if kind == "charuco" else self._tags)(grey)

    def _charuco(self, grey: UInt8) -> tuple[Int, Float]:
        corners, ids, _, _ = self._opencv.detectBoard(grey)
        return _as_arrays(ids, corners)

    def _tags(self, grey: UInt8) -> tuple[Int, Float]:
        corners, ids, _ = self._opencv.detectMarkers(grey)
        if ids is None or len(ids) == 0:
            return _as_arrays(None, None)
        known = np.ravel(ids) < self.board.columns * self.board.rows
        four = 4 * np.ravel(ids)[known, None] + np.arange(4)
        return _as_arrays(four, np.array(corners)[known])

    def _chess(self, grey: UInt8) -> tuple[Int, Float]:
        columns, rows = self.board.columns - 1, self.board.rows - 1
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        seen, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=flags)
        if not seen:
            return _as_arrays(None, None)
        grid = _right_handed(np.asarray(corners, float).reshape(rows, columns, 2))
        if _first_square_is_white(grey, grid):
            grid = grid[::-1, ::-1]
        return _as_arrays(np.arange(columns * rows), grid)

    @cached_property
    def _opencv(self) -> Any:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        if self.board.kind == "aruco":
            return cv2.aruco.ArucoDetector(self.board.pattern.getDictionary(), parameters)
        return cv2.aruco.CharucoDetector(self.board.pattern, cv2.aruco.CharucoParameters(), parameters)


def in_grey(image: UInt8) -> UInt8:
    """(H, W) of an image (H, W[, 3])."""
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)


def variants(board: Board) -> Iterator[Board]:
    """The board, and those that are easily taken for it: of the older pattern, with black and white exchanged."""
    for inverted in (board.inverted, not board.inverted):
        for legacy in (board.legacy, not board.legacy) if board.kind == "charuco" else (board.legacy,):
            yield replace(board, inverted=inverted, legacy=legacy)


def is_mirrored(board: Board, images: Sequence[UInt8]) -> bool:
    """Whether images show the board only if they are mirrored. A chessboard's do not tell."""
    finds = [Detector(v) for v in variants(board)] if board.kind != "chessboard" else []
    return any(find(np.ascontiguousarray(image[:, ::-1])) is not None for find in finds for image in images)


def on_one_plane(plane: Float, image: Float, off: float) -> Bool:
    """(N,) which points of an image fit points (N, 2) of a plane to within `off`, whatever its place."""
    found: Any = cv2.findHomography(plane, image, cv2.RANSAC, off)[1]
    return np.zeros(len(plane), np.bool_) if found is None else np.ravel(found).astype(np.bool_)


def edge_width(grey: UInt8, pixels: Float) -> float:
    """Width of the edges about points (N, 2), px: contrast over the steepest slope there, in the median."""
    reach = 5
    padded = cv2.copyMakeBorder(grey, reach, reach, reach, reach, cv2.BORDER_REPLICATE).astype(np.float32)
    widths = list[float]()
    for x, y in np.round(pixels).astype(int):
        patch = padded[max(y, 0) : y + 2 * reach + 1, max(x, 0) : x + 2 * reach + 1]
        if min(patch.shape) > reach:
            down, across = np.gradient(patch)
            slope = np.hypot(down, across)
            widths.append(float(np.ptp(patch) / max(float(slope.max()), 1e-3)))
    return float(np.median(widths)) if widths else float("inf")


def _as_arrays(ids: Any, corners: Any) -> tuple[Int, Float]:
    if ids is None or corners is None:
        return np.zeros(0, np.int32), np.zeros((0, 2))
    return np.ravel(ids).astype(np.int32), np.asarray(corners, float).reshape(-1, 2)


def _in_one_line(points: Float) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 0.1 * spread[0])


def _right_handed(grid: Float) -> Float:
    """Corners (rows, columns, 2) in an order whose columns go right where its rows go down."""
    right, down = (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
    return grid if right[0] * down[1] - right[1] * down[0] > 0 else grid[:, ::-1]


def _first_square_is_white(grey: UInt8, grid: Float) -> bool:
    centres = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    at = np.clip(np.round(centres).astype(int), 0, np.array(grey.shape[::-1]) - 1)
    values = grey[at[..., 1], at[..., 0]].astype(float)
    row, column = np.indices(values.shape)
    even = (row + column) % 2 == 0
    return bool(values[even].mean() > values[~even].mean())
