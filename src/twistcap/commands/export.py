"""``twistcap export``: a result in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twistcap.commands import terminal


def export(
    result: Annotated[Path, typer.Argument(help="result.h5 of a track.", metavar="RESULT")],
    to: Annotated[str, typer.Option(help="trc, mot, bvh, csv, glb, or a format of an installed package.")],
    out: Annotated[Path | None, typer.Option(help="File to write. Default: in the folder of the result.")] = None,
    json: terminal.Json = False,
) -> None:
    """Write a result as markers (trc), OpenSim angles (mot), animation (bvh, glb) or a table (csv).

    Examples:

      twistcap export out/result.h5 --to trc

      twistcap export out/result.h5 --to bvh --out walk.bvh
    """
    from twistcap.io.exports import export as written
    from twistcap.io.result import read_result

    path = written(read_result(result), to, result.parent, out)
    if json:
        terminal.emit({"id": "export", "format": to, "file": path})
    else:
        typer.echo(path)
