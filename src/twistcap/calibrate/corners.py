"""Corners of a board to a few hundredths of a pixel: the image about each is compared with the board's own picture.

A saddle's gradients tell of its corner only as far as no other edge is near; those of a board's tags are. The picture has
these edges too. So it is drawn as a homography shows it, as blurred as the image is, and moved about each corner
until it fits, brightness and contrast free: Lucas and Kanade's method (Baker and Matthews, DOI
10.1023/B:VISI.0000011205.11775.fd). The tags themselves do not count, since prints place them to a pixel
only. Corners that the detector missed are looked for where their neighbours say.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from twistcap.arrays import AnyArray, Bool, Float, Int, UInt8
from twistcap.calibrate.board import Board

_FINE, _PARTS = 64, 3  # pixels of the picture for each square; parts of an image's pixel, each way, that are drawn
_REACH, _MOST = 0.45, 24  # squares about a corner that are compared; px, at most
_STEPS, _SETTLED = 12, 1e-3  # at most; px by which corners may still move
_STEP = 1.0  # px, at most
_FITS = 0.8  # correlation of image and picture about a corner
_NEAR = 0.25  # squares from where it was looked for
_FEWEST = 20  # px to compare
_NEIGHBOURS = 4  # that say where a missing corner is


def refined(grey: UInt8, board: Board, ids: Int, pixels: Float, width: float) -> tuple[Int, Float]:
    """Ids and pixels of all corners of a board that an image shows.

    Args:
        grey: (H, W).
        board: with a picture of squares.
        ids, pixels: corners that were found (N,), (N, 2), six or more.
        width: of the image's edges there, px; see `edge_width`.
    """
    plane = board.points[:, :2]
    H, _ = cv2.findHomography(plane[ids], pixels)
    if H is None:
        return ids, pixels
    by_plane = _through(H, plane)
    start = by_plane + _shifts(by_plane, ids, pixels - by_plane[ids])
    windows = _windows(grey, board, H, by_plane, start, width)
    return windows.fitted(np.arange(len(plane), dtype=np.int32))


@dataclass
class _Windows:
    """The image about each corner (N, n, n), which of its pixels count, and the drawn board: coefficients of a spline.

    `at` (N, n, n, 2) are row and column of the pixels in the drawn board, `shift` (N, 2) rows and columns by which the
    image shows it elsewhere; `least` (N,) px is how far a corner may move.
    """

    image: Float
    counts: Bool
    drawn: tuple[Float, Float, Float]
    at: Float
    shift: Float
    corners: Float
    least: Float

    def fitted(self, ids: Int) -> tuple[Int, Float]:
        """Those that fit, with their pixels."""
        start, moves = self.shift.copy(), np.full(len(ids), np.inf)
        for _ in range(_STEPS):
            step = self._step()
            self.shift, moves = self.shift + step, np.abs(step).max(axis=1)
            if moves.max() < _SETTLED:
                break
        near = np.linalg.norm(self.shift - start, axis=1) < self.least
        good = near & (moves < 10 * _SETTLED) & (self._correlation() > _FITS)
        good &= self.counts.sum(axis=(1, 2)) >= _FEWEST
        return ids[good], (self.corners + self.shift[:, ::-1])[good]

    def _seen(self, which: int) -> Float:
        """(N, n, n) the drawn board, or its slope by rows or columns, where the image's pixels show it."""
        places = np.moveaxis(self.at - self.shift[:, None, None, :], -1, 0)
        return map_coordinates(self.drawn[which], places, order=3, prefilter=False, mode="nearest") * self.counts

    def _step(self) -> Float:
        """(N, 2) Gauss and Newton's, brightness and contrast eliminated."""
        shown, down, across = (self._seen(k) for k in range(3))
        rows = np.stack([-down, -across, shown, self.counts.astype(float)], axis=-1).reshape(len(self.shift), -1, 4)
        contrast = self._gain(shown)[:, None]
        rows[..., :2] *= contrast[..., None]
        normal = rows.transpose(0, 2, 1) @ rows + 1e-6 * np.eye(4)
        pull = rows.transpose(0, 2, 1) @ (self.image * self.counts).reshape(len(self.shift), -1, 1)
        return np.clip(np.linalg.solve(normal, pull)[:, :2, 0], -_STEP, _STEP)

    def _gain(self, shown: Float) -> Float:
        a, b = (self._centred(x) for x in (shown, self.image))
        return np.sum(a * b, axis=(1, 2)) / np.maximum(np.sum(a * a, axis=(1, 2)), 1e-9)

    def _correlation(self) -> Float:
        a, b = self._centred(self._seen(0)), self._centred(self.image)
        norms = np.sqrt(np.sum(a * a, axis=(1, 2)) * np.sum(b * b, axis=(1, 2)))
        return np.sum(a * b, axis=(1, 2)) / np.maximum(norms, 1e-9)

    def _centred(self, values: Float) -> Float:
        """Less the mean of those that count; 0 elsewhere."""
        count = np.maximum(self.counts.sum(axis=(1, 2), keepdims=True), 1)
        mean = np.sum(values * self.counts, axis=(1, 2), keepdims=True) / count
        return (values - mean) * self.counts


def _windows(grey: UInt8, board: Board, H: Float, by_plane: Float, start: Float, width: float) -> _Windows:
    side = board.square * _scale(H, board.points[:, :2])  # (N,) px
    reach = int(np.ceil(min(float(_MOST), np.sqrt(2.0) * _REACH * float(side.max()))))
    inside = np.all((start > 0) & (start < np.array(grey.shape[::-1]) - 1.0), axis=1)
    origin = np.floor(by_plane.min(axis=0)) - 2 * reach - 4
    size = (np.ceil(by_plane.max(axis=0)) + 2 * reach + 4 - origin).astype(int)
    drawn = _drawn(board, H, origin, size, width)
    span = np.arange(-reach, reach + 1)
    x, y = (np.round(start[:, k]).astype(int)[:, None, None] + grid for k, grid in enumerate(np.meshgrid(span, span)))
    shown = (x >= 0) & (x < grey.shape[1]) & (y >= 0) & (y < grey.shape[0])
    image = grey[np.clip(y, 0, grey.shape[0] - 1), np.clip(x, 0, grey.shape[1] - 1)].astype(float)
    shift = start - by_plane
    in_plane = _through(np.linalg.inv(H), np.stack([x, y], axis=-1) - shift[:, None, None, :])
    off = np.abs(in_plane - board.points[:, None, None, :2]).max(axis=-1)
    amid = np.abs(in_plane % board.square - 0.5 * board.square).max(axis=-1)  # m from the middle of a square
    tag = 0.5 * board.marker + board.square / side[:, None, None] if board.marker else 0.0  # and a pixel about it
    counts = shown & (off < _REACH * board.square) & (amid > tag) & inside[:, None, None]
    at = np.stack([y - origin[1], x - origin[0]], axis=-1)
    return _Windows(image, counts, drawn, at, shift[:, ::-1].copy(), by_plane, _NEAR * side)


def _drawn(board: Board, H: Float, origin: Float, size: AnyArray, width: float) -> tuple[Float, Float, Float]:
    """The board in a part of the image, and its slopes by rows and columns, as coefficients of splines."""
    to_plane = np.diag([board.square / _FINE, board.square / _FINE, 1.0])
    to_plane[:2, 2] = 0.5 * board.square / _FINE  # a pixel's middle is at a whole number
    finer = np.diag([_PARTS, _PARTS, 1.0])
    finer[:2, 2] = 0.5 * (_PARTS - 1)
    shifted = np.eye(3)
    shifted[:2, 2] = -origin
    parts = cv2.warpPerspective(
        board.image(_FINE), finer @ shifted @ H @ to_plane, tuple(_PARTS * size), borderValue=128.0
    )  # fmt: skip
    picture = cv2.resize(parts.astype(np.float64), tuple(size), interpolation=cv2.INTER_AREA)
    sigma = np.sqrt(max(width * width / (2.0 * np.pi) - 1.0 / 3.0, 0.1))  # slopes over two pixels make edges wider
    picture = cv2.GaussianBlur(picture, (0, 0), sigma)
    down, across = np.gradient(picture)
    first, second, third = (np.asarray(spline_filter(p, 3), np.float64) for p in (picture, down, across))
    return first, second, third


def _through(H: Float, points: Float) -> Float:
    """Points (..., 2) mapped by a homography."""
    out = points @ H[:, :2].T + H[:, 2]
    return out[..., :2] / out[..., 2:]


def _scale(H: Float, points: Float) -> Float:
    """(N,) px for each m of a plane at some of its points: the root of the area's."""
    a, b = np.array([1e-4, 0.0]), np.array([0.0, 1e-4])
    across, down = (_through(H, points + d) - _through(H, points - d) for d in (a, b))
    return np.sqrt(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])) / 2e-4


def _shifts(by_plane: Float, ids: Int, found: Float) -> Float:
    """(P, 2) px by which corners are elsewhere: those that were `found`, and for others what their neighbours say."""
    far = np.linalg.norm(by_plane[:, None] - by_plane[ids], axis=-1)
    near = np.argsort(far, axis=1)[:, :_NEIGHBOURS]
    out = np.median(found[near], axis=1)
    out[ids] = found
    return out
