"""What pictures show in place of the board that was said: boards of tags are known by their dictionary and numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from twistcap.arrays import Float, Int, UInt8
from twistcap.calibrate.board import DICTIONARIES, Board
from twistcap.calibrate.detect import Detector, in_grey, variants

_SIZES = (50, 100, 250, 1000)  # of dictionaries; each of a kind begins with the tags of the smaller ones
_FEWEST = 3  # tags in a picture, and pictures, from which on they are no chance
_MARKER = 0.75  # of a square's side, which is not known


@dataclass(frozen=True)
class Tags:
    """Tags in an image (H, W[, 3]): the `kind` of their dictionary, as "4X4"; numbers (N,); middles (N, 2) px."""

    image: UInt8
    kind: str
    ids: Int
    middles: Float


def tagged(images: Sequence[UInt8]) -> list[Tags]:
    """The images that show three tags of one dictionary or more; none where they are fewer than three, or differ."""
    all_of_them = [tags for image in images if (tags := _tags(image)) is not None]
    kinds = [tags.kind for tags in all_of_them]
    usual = max(kinds, key=kinds.count, default="")
    found = [tags for tags in all_of_them if tags.kind == usual]
    return found if len(found) >= _FEWEST else []


def _tags(image: UInt8) -> Tags | None:
    parameters = cv2.aruco.DetectorParameters()
    parameters.detectInvertedMarker = True
    best = None
    for name in (n for n in DICTIONARIES if n.endswith("_1000")):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
        found: Any = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(in_grey(image))
        corners, ids, _ = found
        if ids is not None and len(ids) >= (_FEWEST if best is None else len(best.ids) + 1):
            middles = np.asarray(corners, float).reshape(-1, 4, 2).mean(axis=1)
            best = Tags(image, name.split("_")[0], np.ravel(ids).astype(np.int32), middles)
    return best


def is_contradicted(board: Board, tags: Sequence[Tags]) -> bool:
    """Whether images with a ChArUco board show no chessboard `board`, or mostly one whose corners have tags among them.

    Tags may hang on a wall behind a chessboard.
    """
    if board.kind != "chessboard" or charuco_of(board, tags) is None:
        return False
    seen = [(found.pixels, own) for own in tags if (found := Detector(board)(own.image)) is not None]
    return 2 * sum(_amid(corners, own) for corners, own in seen) >= len(seen)


def _amid(corners: Float, tags: Tags) -> bool:
    """Whether a tag is among corners (N, 2)."""
    hull = cv2.convexHull(corners.astype(np.float32))
    return any(cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0 for x, y in tags.middles)


def charuco_of(board: Board, tags: Sequence[Tags]) -> Board | None:
    """The ChArUco board that most images with tags show, its squares taken to be those of `board`; None without one."""
    counts = dict[Board, int]()
    for shape in _shapes(board.square, tags) if tags else ():
        for find in map(Detector, variants(shape)):
            counts[shape] = max(counts.get(shape, 0), sum(find(own.image) is not None for own in tags))
    best = max(counts, key=counts.__getitem__, default=None)
    return None if best is None or counts[best] < _FEWEST else best


def _shapes(square: float, tags: Sequence[Tags]) -> Iterator[Board]:
    """ChArUco boards with as many tags."""
    many = 1 + _highest(tags)
    for columns in range(3, 101):
        for rows in {2 * many // columns, (2 * many + 1) // columns}:
            if 3 <= rows <= 100 and columns * rows // 2 == many:
                yield Board("charuco", columns, rows, square, _MARKER * square, _dictionary(tags))


def _highest(tags: Sequence[Tags]) -> int:
    """The highest number that more than one image shows."""
    numbers, counts = np.unique(np.concatenate([own.ids for own in tags]), return_counts=True)
    return int(numbers[counts > 1].max(initial=0))


def _dictionary(tags: Sequence[Tags]) -> str:
    return f"{tags[0].kind}_{next(size for size in _SIZES if _highest(tags) < size)}"


def other_in_words(board: Board, tags: Sequence[Tags]) -> str:
    """What images with tags show in place of a board, and what to do, after a sentence that it is not seen."""
    if not tags:
        few = "" if board.kind == "chessboard" else ", and few show tags of any dictionary"
        return f"{few}; check --board, or film it nearer and slower"
    name, found = _dictionary(tags), charuco_of(board, tags)
    shape = "KIND:COLUMNSxROWS" if found is None else f"charuco:{found.columns}x{found.rows}"
    what = "" if found is None else f"a charuco of {found.columns} × {found.rows} squares, with "
    say = f"name the board that was filmed, as --board {shape}:SQUARE_MM:MARKER_MM:{name}"
    return f", but {what}tags of {name} numbered up to {_highest(tags)}; {say}"
