"""``twistcap board``: a board to print and to film."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twistcap.commands import terminal
from twistcap.errors import check, check_choice


def board(
    path: Annotated[Path, typer.Argument(help="PDF to write; a .toml of the same name says what it is.")],
    kind: Annotated[
        str, typer.Option("--board", help="KIND:COLUMNSxROWS:SQUARE_MM[:MARKER_MM[:DICTIONARY]], or a board.toml.")
    ] = "charuco:5x7:36:27:4X4_50",
    paper: Annotated[str, typer.Option(help="a4, a3, a2, a1, a0, letter, or fit: as large as needed.")] = "a4",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an older PDF and its .toml.")] = False,
    json: terminal.Json = False,
) -> None:
    """Print a board at true size, with a ruler: a PDF, and the .toml that `twistcap calibrate --board` reads.

    Examples:

      twistcap board board.pdf

      twistcap board big.pdf --board charuco:9x6:80:60:5X5_100 --paper a1
    """
    from twistcap.calibrate.board import board_of
    from twistcap.io.files import pasted
    from twistcap.report.board import PAPERS, write_board

    check_choice("--paper", paper, (*PAPERS, "fit"))
    check(str(path), path.suffix.lower() == ".pdf", "the board is a PDF; name a file that ends in .pdf")
    made = board_of(kind)
    about = path.with_suffix(".toml")
    terminal.check_free(path, about, overwrite=overwrite)
    terminal.output_folder(path.parent)
    write_board(made, path, paper)
    about.write_text(made.toml, encoding="utf-8")
    if not made.one_way:
        alike = "This board looks the same upside down: it does for one camera, or for lenses"
        typer.echo(f"{alike}. For several cameras print one of an even and an odd side.", err=True)
    if json:
        terminal.emit({"id": "board", "file": path, "about": about, "board": made.words})
        return
    typer.echo(path)
    typer.echo(f"{made.words}. Calibrate with --board {pasted(about)}; measure the ruler after printing.", err=True)
