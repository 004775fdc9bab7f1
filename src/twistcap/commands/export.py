"""``twistcap export``: a result in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError


def export(
    result: Annotated[Path, typer.Argument(help="result.h5 of a track.", metavar="RESULT")],
    to: Annotated[str, typer.Option(help="trc, mot, bvh, csv or glb.")],
    out: Annotated[Path | None, typer.Option(help="File to write. Default: in the folder of the result.")] = None,
    json: terminal.Json = False,
) -> None:
    """Write a result as markers (trc), OpenSim angles (mot), animation (bvh, glb) or a table (csv).

    Examples:

      twistcap export out/result.h5 --to trc

      twistcap export out/result.h5 --to bvh --out walk.bvh
    """
    from twistcap.commands import outputs
    from twistcap.io.result import read_result

    if to not in outputs.FILE_NAMES:
        raise InputError(f"--to is {to!r}; it must be one of {', '.join(outputs.FILE_NAMES)}.")
    path = outputs.export(read_result(result), to, out or result.parent / outputs.FILE_NAMES[to])
    if json:
        terminal.emit({"id": "export", "format": to, "file": path})
    else:
        typer.echo(path)
