"""``twistcap export``: a result in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from twistcap.commands import terminal
from twistcap.errors import check_choice

if TYPE_CHECKING:
    from twistcap.io.coordinates import Angles
    from twistcap.io.markers import WorldAxes


def export(
    result: terminal.ResultFile,
    to: Annotated[
        str, typer.Option(help="trc, mot, bvh, csv, glb, usd, c3d, opensim, or a format of an installed package.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="File to write (opensim: folder). Default: beside the result.")
    ] = None,
    axes: Annotated[str, typer.Option(help="World of the file: opensim (y up), pose2sim (y up), z_up.")] = "opensim",
    angles: Annotated[str, typer.Option(help="Definition of joint angles: opensim, isb.")] = "opensim",
    fill: Annotated[bool, typer.Option("--fill", help="Write predicted poses where the body was lost.")] = False,
    fps: Annotated[
        float | None,
        typer.Option(help="Frames per second of bvh, glb and usd. Default: the recording's."),
    ] = None,
    into: Annotated[
        Path | None, typer.Option(help="The rigged GLB that was tracked: glb and bvh then have its own bones.")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig file of --into, where none is beside it.")] = None,
    frames: terminal.Frames = None,
    json: terminal.Json = False,
) -> None:
    """Write a result as markers (trc, c3d), joint angles (mot, csv), animation (bvh, glb, usd), or an OpenSim model.

    Examples:

      twistcap export out/result.h5 --to trc

      twistcap export out/result.h5 --to mot --angles isb

      twistcap export out/result.h5 --to bvh --out walk.bvh

      twistcap export out/result.h5 --to bvh --fps 24

      twistcap export out/result.h5 --to glb --into hero.glb --out hero-walk.glb
    """
    from twistcap.io.coordinates import ANGLES
    from twistcap.io.exports import ExportOptions, format_of
    from twistcap.io.exports import export as written
    from twistcap.io.files import keeping
    from twistcap.io.markers import TO_FILE

    check_choice("--axes", axes, TO_FILE)
    check_choice("--angles", angles, ANGLES)
    options = ExportOptions(cast("WorldAxes", axes), cast("Angles", angles), fill, fps, into, rig)
    if out is not None:
        terminal.output_file(out, "--out", Path(format_of(to).file_name).suffix)
    tracked = terminal.tracked(result, frames)
    with keeping(result, into, rig, tracked.config):
        path = written(tracked, to, result.parent, out, options)
    if json:
        terminal.emit({"id": "export", "format": to, "file": path})
    else:
        typer.echo(path)
