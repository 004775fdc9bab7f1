"""``twistcap convert``: calibrations of other programs."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from twistcap.commands import terminal
from twistcap.errors import check_choice

if TYPE_CHECKING:
    from twistcap.camera import Rig
    from twistcap.io.cameras import CameraFormat


def convert(
    source: Annotated[Path, typer.Argument(help="Calibration file, or a folder of them.", metavar="IN")],
    out: Annotated[Path, typer.Argument(help="File or folder to write.", metavar="OUT")],
    to: Annotated[str, typer.Option(help="Format of OUT: see below.")] = "toml",
    of: Annotated[str | None, typer.Option("--format", help="Format of IN, if its name does not say.")] = None,
    unit: Annotated[
        str | None,
        typer.Option(help="Unit of IN: m, cm, mm, or its length in m. Default: what IN says, or its cameras tell."),
    ] = None,
    up: Annotated[str | None, typer.Option(help="Axis of IN that is up: x, -x, y, -y, z or -z.")] = None,
    size: Annotated[str | None, typer.Option(help="Size of the images, if IN lacks it, as 1920x1080.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace older files of OUT.")] = False,
    json: terminal.Json = False,
) -> None:
    """Read a calibration of another program, and write it in the format of another, z up and in metres.

    Formats: toml (Pose2Sim, aniposelib), caliscope, opencv, easymocap, qualisys, vicon, opencap, colmap, projections.

    Examples:

      twistcap convert Calib.qca.txt Calib.toml

      twistcap convert opencap/Videos Calib.toml --format opencap --up -y

      twistcap convert matrices/ Calib.toml --size 1920x1080
    """
    from twistcap.io.cameras import FORMATS, Asked, read_cameras
    from twistcap.io.cameras.axes import Up
    from twistcap.io.cameras.formats import floor_doubt
    from twistcap.io.cameras.units import unit_of

    check_choice("--to", to, FORMATS)
    axis: Any = up
    if up is not None:
        check_choice("--up", up, get_args(Up))
    asked = Asked(None if unit is None else unit_of(unit), None if size is None else terminal.image_size(size))
    rig, statements = read_cameras(source, of, asked, axis)
    _check_out(source, out, FORMATS[to])
    statements += _written(rig, out, to, floor_doubt(source, of), overwrite)
    if json:
        centres = {camera.name: camera.centre for camera in rig}
        about = {"id": "convert", "file": out, "centres_m": centres}
        terminal.emit(about | {"up": statements[0], "statements": statements})
        return
    typer.echo(out)
    for statement in statements:
        typer.echo(statement, err=True)
    for camera in rig:
        x, y, z = camera.centre
        typer.echo(
            f"Camera {camera.name}: at ({x:.3f}, {y:.3f}, {z:.3f}) m, {camera.size[0]}×{camera.size[1]} px.", err=True
        )


def _written(rig: Rig, out: Path, to: str, doubt: str, overwrite: bool) -> list[str]:
    """As `write_cameras`, elsewhere first: its files take their places once all are written and all places are free."""
    from twistcap.io.cameras import write_cameras
    from twistcap.io.files import replacing

    with TemporaryDirectory() as folder:
        draft = Path(folder) / "out"
        statements = write_cameras(rig, draft, to, doubt)
        goals = {out / file.relative_to(draft): file for file in (draft, *draft.rglob("*")) if file.is_file()}
        terminal.check_free(*goals, overwrite=overwrite)
        for goal, file in goals.items():
            terminal.output_folder(goal.parent)
            with replacing(goal, "calibration") as part:
                part.write_bytes(file.read_bytes())
    return statements


def _check_out(source: Path, out: Path, kind: CameraFormat) -> None:
    """See that OUT is a place for the format, and not the calibration that was read."""
    if kind.folder:
        terminal.output_folder(out)
        return
    terminal.output_file(out, "OUT", kind.ending, source)
