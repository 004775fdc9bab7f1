"""A board to print: one PDF page at true size, with a ruler that tells whether the printer kept it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twistcap.calibrate.board import Board
from twistcap.errors import InputError
from twistcap.io.files import replacing

PAPERS: Mapping[str, tuple[float, float]] = {
    "a4": (210, 297), "a3": (297, 420), "a2": (420, 594), "a1": (594, 841), "a0": (841, 1189), "letter": (215.9, 279.4),
}  # fmt: skip
"""Width and height, mm."""
_MARGIN, _FOOT, _RULER = 8.0, 22.0, 100  # mm
_INCH = 25.4


def write_board(board: Board, path: Path, paper: str = "a4") -> Path:
    """Write the board as a PDF; `paper` is one of `PAPERS`, turned if that fits better, or "fit", as large as needed.

    Raises InputError where the paper is too small, or the file cannot be written.
    """
    width, height = _page(board, paper)
    figure = Figure(figsize=(width / _INCH, height / _INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, width), ylim=(0, height))
    axes.set_axis_off()
    across, down = (1e3 * side for side in board.size)
    left, low = 0.5 * (width - across), _FOOT + 0.5 * (height - _FOOT - down)
    pixels = int(np.clip(round(20e3 * board.square), 60, 1200))  # about 500 dpi
    extent = (left, left + across, low, low + down)
    picture = np.repeat(board.image(pixels)[..., None], 3, axis=2)  # a map of colours would take twice the time
    axes.imshow(picture, extent=extent, interpolation="none", aspect="auto")
    axes.set(xlim=(0, width), ylim=(0, height))
    _foot(axes, board)
    with replacing(path, "board") as part:
        figure.savefig(part, format="pdf", metadata={"Title": board.words, "CreationDate": None})
    return path


def _page(board: Board, paper: str) -> tuple[float, float]:
    """Width and height, mm."""
    needed = (1e3 * board.size[0] + 2 * _MARGIN, 1e3 * board.size[1] + _FOOT + _MARGIN)
    if paper == "fit":
        return max(needed[0], _RULER + 2 * _MARGIN), needed[1]
    wide, high = PAPERS[paper]
    for page in ((wide, high), (high, wide)):
        if page[0] >= needed[0] and page[1] >= needed[1]:
            return page
    mend = 'choose a larger paper, "fit", or smaller squares'
    raise InputError(f"the board needs {needed[0]:.0f} × {needed[1]:.0f} mm with margins; {paper} is smaller; {mend}.")


def _foot(axes: Axes, board: Board) -> None:
    """The ruler, and what to check."""
    y = _MARGIN + 4.0
    for mm in range(_RULER + 1):
        tick = 4.0 if mm % 10 == 0 else 2.5 if mm % 5 == 0 else 1.5
        axes.plot([_MARGIN + mm] * 2, [y, y + tick], color="black", linewidth=0.35)
    for mm in range(0, _RULER + 1, 10):
        axes.text(_MARGIN + mm, y + 4.6, str(mm), fontsize=5, ha="center", va="bottom")
    axes.plot([_MARGIN, _MARGIN + _RULER], [y, y], color="black", linewidth=0.35)
    axes.text(_MARGIN, y - 1.2, f"twistcap: {board.words}", fontsize=6, va="top")
    advice = "Print at 100 %, glue it on something flat and stiff, and measure this ruler: 100 mm."
    axes.text(_MARGIN, y - 4.4, advice, fontsize=6, va="top")
