"""Corners of a board to a few hundredths of a pixel: the image about each is compared with the board's own picture.

A saddle's gradients tell of its corner only as far as no other edge is near; those of a board's tags are. The picture
has these edges too. So it is drawn as a homography shows it, as blurred as the image is, and moved about each corner
until it fits, brightness and contrast free: Lucas and Kanade's method (Baker and Matthews, DOI
10.1023/B:VISI.0000011205.11775.fd). The tags themselves do not count, since prints place them to a pixel only.
Corners that the detector missed are looked for where their neighbours say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from twistcap.arrays import AnyArray, Bool, Float, Int, UInt8
from twistcap.calibrate.board import Board

_FINE = 64  # pixels of the picture for each square
_PARTS = (3, 6)  # parts of an image's pixel, each way, that are drawn: fewest, most
_REACH, _MOST = 0.45, 24  # squares about a corner that are compared; px, at most
_STEPS, _SETTLED = 12, 1e-3  # at most; px by which corners may still move
_STEP = 1.0  # px, at most
_FITS = 0.8  # correlation of image and picture about a corner
_NEAR = 0.25  # squares from where it was looked for
_FEWEST = 20  # px to compare
_LEAST = 4  # corners that make a homography
_SURE = 0.1  # px, standard deviation
_NEIGHBOURS = 4  # that say where a missing corner is
_ROUNDS, _DRAWN_WELL = 3, 0.02  # at most; px by which the homography of the last one may be off


def refined(grey: UInt8, board: Board, ids: Int, pixels: Float, width: float) -> tuple[Int, Float]:
    """Ids and pixels of all corners of a board that an image shows.

    A picture that is drawn a little turned or too large pulls corners aside; so it is drawn again by those it found.

    Args:
        grey: (H, W).
        board: with a picture of squares.
        ids, pixels: corners that were found (N,), (N, 2), six or more.
        width: of the image's edges there, px; see `edge_width`.
    """
    plane, last = board.points[:, :2], np.full((len(board.points), 2), np.inf)
    for _ in range(_ROUNDS):
        H: Any = cv2.findHomography(plane[ids], pixels)[0] if len(ids) >= _LEAST else None
        if H is None or not np.isfinite(width):  # no edge was near the corners that were found
            break
        corners = _through(H, plane)
        if np.abs(corners - last).max() < _DRAWN_WELL:
            break
        ids, pixels, last = *_moved(grey, board, H, ids, pixels, width), corners
    return ids, pixels


def _moved(grey: UInt8, board: Board, H: Float, ids: Int, pixels: Float, width: float) -> tuple[Int, Float]:
    """Those that fit of all corners, and their pixels; the picture is drawn by one homography."""
    corners = _through(H, board.points[:, :2])
    start = corners + _shifts(corners, ids, pixels - corners[ids])
    inside = np.flatnonzero(np.all((start >= 0.0) & (start < grey.shape[::-1]), axis=1)).astype(np.int32)
    if not len(inside):
        return ids[:0], pixels[:0]
    return _windows(grey, board, H, inside, corners[inside], start[inside], width).fitted(inside)


@dataclass
class _Windows:
    """About each of N corners, K pixels of the image (N, K); fewer of some corners, whose rest does not count (N, K).

    `drawn` is the board and its slopes by rows and columns, as splines; `at` (N, K, 2) row and column of
    the pixels there. `corners` (N, 2) are where the homography has them, px, and `shift` (N, 2) by how many rows and
    columns the image shows them elsewhere; `far` (N,) px is how far they may move.
    """

    image: Float
    counts: Bool
    drawn: tuple[Float, Float, Float]
    at: Float
    corners: Float
    shift: Float
    far: Float

    def fitted(self, ids: Int) -> tuple[Int, Float]:
        """Those of the corners that fit, and their pixels."""
        start, moved = self.shift, np.full(len(ids), np.inf)
        for _ in range(_STEPS):
            step = self._step()
            self.shift, moved = self.shift + step, np.abs(step).max(axis=1)
            if moved.max() < _SETTLED:
                break
        good = (np.linalg.norm(self.shift - start, axis=1) < self.far) & (moved < 10 * _SETTLED)
        good &= (self.counts.sum(axis=1) >= _FEWEST) & (self._correlation() > _FITS) & (self._sigma() < _SURE)
        return ids[good], (self.corners + self.shift[:, ::-1])[good]

    def _seen(self, which: int) -> Float:
        """(N, K) the drawn board, or one of its slopes, where the image's pixels show it."""
        places = np.moveaxis(self.at - self.shift[:, None], -1, 0)
        shown = map_coordinates(self.drawn[which], places, order=3, prefilter=False, mode="nearest")
        return np.asarray(shown, np.float64)

    def _step(self) -> Float:
        """(N, 2) Gauss and Newton's, with brightness and contrast."""
        _, normal, pull = self._normal()
        return np.asarray(np.clip(np.linalg.solve(normal, pull)[:, :2, 0], -_STEP, _STEP), np.float64)

    def _sigma(self) -> Float:
        """(N,) px, standard deviation of where the corners are: large where one edge alone is seen."""
        rows, normal, pull = self._normal()
        covariance = np.linalg.inv(normal)
        left = (self.image * self.counts)[..., None] - rows @ (covariance @ pull)
        free = np.maximum(self.counts.sum(axis=1) - rows.shape[-1], 1)
        variance = np.sum(left * left, axis=(1, 2)) / free * (covariance[:, 0, 0] + covariance[:, 1, 1])
        return np.asarray(np.sqrt(variance), np.float64)

    def _normal(self) -> tuple[Float, Float, Float]:
        """Derivatives of the pixels (N, K, 4) by shift, contrast and brightness; the normal equations."""
        shown, down, across = (self._seen(k) for k in range(3))
        a, b = self._centred(shown), self._centred(self.image)
        contrast = (np.sum(a * b, axis=1) / np.maximum(np.sum(a * a, axis=1), 1e-9))[:, None]
        rows = np.stack([-contrast * down, -contrast * across, shown, np.ones_like(shown)], axis=-1)
        rows *= self.counts[..., None]
        pull = rows.transpose(0, 2, 1) @ self.image[..., None]
        return rows, rows.transpose(0, 2, 1) @ rows + 1e-6 * np.eye(4), pull

    def _correlation(self) -> Float:
        a, b = self._centred(self._seen(0)), self._centred(self.image)
        norms = np.sqrt(np.sum(a * a, axis=1) * np.sum(b * b, axis=1))
        return np.asarray(np.sum(a * b, axis=1) / np.maximum(norms, 1e-9), np.float64)

    def _centred(self, values: Float) -> Float:
        """Less the mean of those that count; 0 elsewhere."""
        count = np.maximum(self.counts.sum(axis=1, keepdims=True), 1)
        return (values - np.sum(values * self.counts, axis=1, keepdims=True) / count) * self.counts


def _windows(grey: UInt8, board: Board, H: Float, ids: Int, corners: Float, start: Float, width: float) -> _Windows:
    plane = board.points[ids, :2]
    side = board.square * np.sqrt(np.abs(np.linalg.det(_slopes(H, plane))))  # (N,) px
    reach = int(np.ceil(min(float(_MOST), np.sqrt(2.0) * _REACH * float(side.max()))))
    x, y = (p.reshape(len(start), -1) for p in _about(start, reach))
    to_plane = np.asarray(np.linalg.inv(H), np.float64)
    in_plane = _through(to_plane, np.stack([x, y], axis=-1) - (start - corners)[:, None])
    shown = (x >= 0) & (x < grey.shape[1]) & (y >= 0) & (y < grey.shape[0])
    counts = np.asarray(_near(board, plane, in_plane, side) & shown, np.bool_)
    own = np.argsort(~counts, axis=1, kind="stable")[:, : max(1, int(counts.sum(axis=1).max()))]
    x, y = np.take_along_axis(x, own, axis=1), np.take_along_axis(y, own, axis=1)
    counts = np.take_along_axis(counts, own, axis=1)
    image = grey[np.clip(y, 0, grey.shape[0] - 1), np.clip(x, 0, grey.shape[1] - 1)].astype(float)
    origin = np.floor(corners.min(axis=0)).astype(int) - 2 * reach
    size = np.ceil(corners.max(axis=0)).astype(int) + 2 * reach - origin
    at = np.stack([y - origin[1], x - origin[0]], axis=-1).astype(float)
    drawn = _drawn(board, H, origin, size, width)
    return _Windows(image, counts, drawn, at, corners, (start - corners)[:, ::-1], _NEAR * side)


def _about(pixels: Float, reach: int) -> tuple[AnyArray, AnyArray]:
    """(N, n, n) columns and rows of the image's pixels about some."""
    span = np.arange(-reach, reach + 1)
    across, down = np.meshgrid(span, span)
    middle = np.round(pixels).astype(int)[:, :, None, None]
    return middle[:, 0] + across, middle[:, 1] + down


def _near(board: Board, plane: Float, in_plane: Float, side: Float) -> Bool:
    """(N, K) which points of the board's plane are near their corner, and not of a tag; a pixel beside it is of it."""
    off = np.abs(in_plane - plane[:, None]).max(axis=-1)
    amid = np.abs(in_plane % board.square - 0.5 * board.square).max(axis=-1)  # m from the middle of a square
    tag = 0.5 * board.marker + board.square / side[:, None] if board.marker else 0.0
    return np.asarray((off < _REACH * board.square) & (amid > tag), np.bool_)


def _drawn(board: Board, H: Float, origin: Float, size: AnyArray, width: float) -> tuple[Float, Float, Float]:
    """The board in a part of the image, and its slopes by rows and columns, as coefficients of splines."""
    to_plane = np.diag([board.square / _FINE, board.square / _FINE, 1.0])
    to_plane[:2, 2] = 0.5 * board.square / _FINE  # a pixel's middle is at a whole number
    parts = _parts(board, H)
    finer = np.diag([parts, parts, 1.0])
    finer[:2, 2] = 0.5 * (parts - 1)
    shifted = np.eye(3)
    shifted[:2, 2] = -origin
    shown = cv2.warpPerspective(
        board.image(_FINE), finer @ shifted @ H @ to_plane, tuple(parts * size), borderValue=128.0
    )
    picture = cv2.resize(shown.astype(np.float64), tuple(size), interpolation=cv2.INTER_AREA)
    sigma = np.sqrt(max(width * width / (2.0 * np.pi) - 1.0 / 3.0, 0.1))  # slopes over two pixels make edges wider
    picture = cv2.GaussianBlur(picture, (0, 0), sigma)
    down, across = np.gradient(picture)
    first, second, third = (np.asarray(spline_filter(p, 3), np.float64) for p in (picture, down, across))
    return first, second, third


def _through(H: Float, points: Float) -> Float:
    """Points (..., 2) mapped by a homography."""
    out = points @ H[:, :2].T + H[:, 2]
    return out[..., :2] / out[..., 2:]


def _parts(board: Board, H: Float) -> int:
    """Parts of a pixel, each way, so many that no pixel of the board's picture is passed over where it is shortest."""
    shortest = board.square * float(np.linalg.svd(_slopes(H, board.points[:, :2]), compute_uv=False).min())
    return int(np.clip(np.ceil(_FINE / max(shortest, 1.0)), *_PARTS))


def _slopes(H: Float, points: Float) -> Float:
    """(N, 2, 2) px for each m of a plane at some of its points, along the plane's axes."""
    a, b = np.array([1e-4, 0.0]), np.array([0.0, 1e-4])
    return np.stack([_through(H, points + d) - _through(H, points - d) for d in (a, b)], axis=1) / 2e-4


def _shifts(corners: Float, ids: Int, found: Float) -> Float:
    """(P, 2) px by which corners are elsewhere: those that were `found`, and for others what their neighbours say."""
    apart = np.linalg.norm(corners[:, None] - corners[ids], axis=-1)
    out = np.median(found[np.argsort(apart, axis=1)[:, :_NEIGHBOURS]], axis=1)
    out[ids] = found
    return out
