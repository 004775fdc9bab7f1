"""Boards to film: ChArUco, chessboard and a grid of ArUco tags; where their points are, and how a board is named."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.doors.text import read_toml
from twistcap.errors import InputError, check, check_choice
from twistcap.ranges import Checked, Count, Positive

BoardKind = Literal["charuco", "chessboard", "aruco"]
DICTIONARIES = tuple(sorted(name.removeprefix("DICT_") for name in dir(cv2.aruco) if re.match(r"DICT_\dX", name)))
_SHORT = re.compile(r"(\w+):(\d+)x(\d+):([\d.]+)(?::([\d.]+))?(?::(?:DICT_)?(\w+))?$")
_HOW = "write KIND:COLUMNSxROWS:SQUARE_MM[:MARKER_MM[:DICTIONARY]], such as charuco:5x7:40:30:4X4_50, or a board.toml"


@dataclass(frozen=True)
class Board(Checked, where="the board"):
    """A flat board. Its points have x to the right, y down and z into the board, from its upper left corner, m.

    Attributes:
        kind: "charuco", "chessboard", or "aruco", a grid of tags.
        columns, rows: squares; of "aruco", tags.
        square: side of a square, m; of "aruco", from one tag to the next.
        marker: side of a tag, m; 0 for a chessboard.
        dictionary: of the tags, without ``DICT_``.
        legacy: the pattern of OpenCV before 4.6, which differs where `rows` is even.
        inverted: white and black are exchanged.
    """

    kind: BoardKind = "charuco"
    columns: Count = 5
    rows: Count = 7
    square: Positive = 0.04
    marker: float = 0.03
    dictionary: str = "4X4_50"
    legacy: bool = False
    inverted: bool = False

    def __post_init__(self) -> None:
        """Raises InputError for a board that cannot be."""
        super().__post_init__()
        check_choice("the board: kind", self.kind, get_args(BoardKind))
        least = 1 if self.kind == "aruco" else 3
        many = min(self.columns, self.rows) >= least and max(self.columns, self.rows) <= 100
        check("the board", many, f"it has {self.columns} × {self.rows} squares; it needs {least} to 100 of each")
        check("the board", 1e-3 <= self.square <= 2.0, f"a square of {1e3 * self.square:g} mm cannot be; write mm")
        if self.kind != "chessboard":
            check_choice("the board: dictionary", self.dictionary, DICTIONARIES)
            misfit = f"tags of {1e3 * self.marker:g} mm do not fit squares of {1e3 * self.square:g} mm"
            check("the board", 0.2 * self.square <= self.marker < self.square, misfit)
            tags = self.columns * self.rows // (2 if self.kind == "charuco" else 1)
            lack = f"it needs {tags} tags, and the dictionary {self.dictionary} has {len(self._dictionary.bytesList)}"
            check("the board", tags <= len(self._dictionary.bytesList), lack)

    @property
    def points(self) -> Float:
        """(P, 3) m, by id: inner corners row by row; for "aruco" the four corners of each tag, clockwise."""
        if self.kind == "aruco":
            return np.concatenate([np.asarray(o, float) for o in self.pattern.getObjPoints()])
        columns, rows = self.columns - 1, self.rows - 1
        y, x = np.divmod(np.arange(columns * rows), columns)
        return self.square * np.stack([x + 1.0, y + 1.0, np.zeros(len(x))], axis=1)

    @property
    def size(self) -> tuple[float, float]:
        """(width, height), m."""
        gap = self.square - self.marker if self.kind == "aruco" else 0.0
        return self.columns * self.square - gap, self.rows * self.square - gap

    @property
    def one_way(self) -> bool:
        """Whether its picture tells which way round it is: a chessboard of even and odd sides does."""
        return self.kind != "chessboard" or (self.columns + self.rows) % 2 == 1

    @property
    def _dictionary(self) -> Any:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))

    @cached_property
    def pattern(self) -> Any:
        """OpenCV's board of tags."""
        shape = (self.columns, self.rows)
        if self.kind == "aruco":
            return cv2.aruco.GridBoard(shape, self.marker, self.square - self.marker, self._dictionary)
        pattern = cv2.aruco.CharucoBoard(shape, self.square, self.marker, self._dictionary)
        pattern.setLegacyPattern(self.legacy)
        return pattern

    def image(self, pixels: int) -> AnyArray:
        """(H, W) uint8 picture without a margin, `pixels` for each square."""
        shape = tuple(round(side / self.square * pixels) for side in self.size)
        if self.kind == "chessboard":
            row, column = np.indices((self.rows, self.columns))
            image = np.kron(np.where((row + column) % 2, 255, 0), np.ones((pixels, pixels))).astype(np.uint8)
        else:
            image = np.asarray(self.pattern.generateImage(shape, marginSize=0))
        return 255 - image if self.inverted else image

    @property
    def words(self) -> str:
        """The board in words that a person can check."""
        what = f"{self.kind} of {self.columns} × {self.rows} squares of {1e3 * self.square:g} mm"
        if self.kind == "chessboard":
            return f"{what} ({self.columns - 1} × {self.rows - 1} inner corners)"
        return f"{what}, tags {self.dictionary} of {1e3 * self.marker:g} mm{self._variant}"

    @property
    def _variant(self) -> str:
        return (", legacy pattern" if self.legacy else "") + (", inverted" if self.inverted else "")

    @property
    def toml(self) -> str:
        """As `read_board` reads it."""
        lines = [f'kind = "{self.kind}"', f"columns = {self.columns}", f"rows = {self.rows}"]
        lines.append(f"square_mm = {1e3 * self.square:.10g}")
        if self.kind != "chessboard":
            lines += [f"marker_mm = {1e3 * self.marker:.10g}", f'dictionary = "{self.dictionary}"']
        lines += [f"{name} = true" for name in ("legacy", "inverted") if getattr(self, name)]
        return "\n".join(lines) + "\n"


def board_of(text: str) -> Board:
    """A board by a file (``board.toml``) or in short: ``charuco:5x7:40:30:4X4_50``, ``chessboard:8x5:60``.

    Columns and rows count squares, not inner corners; sides are mm. Raises InputError.
    """
    if text.endswith(".toml"):
        return read_board(Path(text))
    match = _SHORT.match(text)
    if match is None:
        raise InputError(f"the board {text!r} cannot be read; {_HOW}.")
    kind, columns, rows, square, marker, dictionary = match.groups()
    check_choice("the board: kind", kind, get_args(BoardKind))
    side = _millimetres(square, text)
    tag = _millimetres(marker, text) if marker else (0.0 if kind == "chessboard" else 0.75 * side)
    known: Any = kind
    return Board(known, int(columns[:6]), int(rows[:6]), side, tag, dictionary or "4X4_50")


def read_board(path: Path) -> Board:
    """The board that a ``board.toml`` of `twistcap board` says. Raises InputError."""
    table = read_toml(path, "board", "check --board")
    known = {"kind", "columns", "rows", "square_mm", "marker_mm", "dictionary", "legacy", "inverted"}
    for key in table:
        check_choice(f"board {path}: the field", key, known)
    for key in ("kind", "columns", "rows", "square_mm"):
        check(f"board {path}", key in table, f"the field '{key}' is missing; add it")
    numbers = {key: table.get(key, 0.0) for key in ("square_mm", "marker_mm")}
    for key, value in numbers.items():
        good = isinstance(value, (int, float)) and not isinstance(value, bool)
        check(f"board {path}", good, f"'{key}' must be a number, in millimetres")
    rest: dict[str, Any] = {key: table[key] for key in ("dictionary", "legacy", "inverted") if key in table}
    for key in ("legacy", "inverted"):
        check(f"board {path}", isinstance(rest.get(key, False), bool), f"'{key}' must be true or false")
    try:
        square, marker = 1e-3 * numbers["square_mm"], 1e-3 * numbers["marker_mm"]
        return Board(table["kind"], table["columns"], table["rows"], square, marker, **rest)
    except InputError as error:
        raise InputError(f"board {path}: {error}") from error


def _millimetres(text: str, whole: str) -> float:
    try:
        return 1e-3 * float(text)
    except ValueError as error:
        raise InputError(f"the board {whole!r}: {text!r} is no length in mm; {_HOW}.") from error
