"""``twistcap new``: a session from videos and a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError, check_choice


def new(
    folder: Annotated[Path, typer.Argument(help="Folder for session.toml; created if missing.", metavar="DIR")],
    calibration: Annotated[Path, typer.Option(help="Calib.toml in the format of aniposelib or Pose2Sim.")],
    videos: Annotated[
        list[str], typer.Option(help="A video, a folder, or images. Write CAMERA=PATH if the name is not enough.")
    ],
    more: Annotated[
        list[str] | None, typer.Argument(help="More videos, as for --videos.", metavar="[VIDEO]...")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="m or mm: unit of the calibration, if it does not say.")] = None,
    stature: Annotated[float | None, typer.Option(help="Height of the person, m.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing session.toml.")] = False,
    json: terminal.Json = False,
) -> None:
    """Write a session.toml with comments, check videos and calibration, and list what is missing.

    Examples:

      twistcap new walk --calibration walk/Calib.toml --videos walk/videos

      twistcap new walk --calibration Calib.toml --videos *.mp4 --stature 1.82

      twistcap new walk --calibration Calib.toml --videos left=a.mp4 --videos right=b.mp4
    """
    from twistcap.io.calibration import Unit
    from twistcap.io.new_session import draft_session, findings, missing, session_lines
    from twistcap.io.recording import rig_of, views_of
    from twistcap.io.session import load_session

    path = folder / "session.toml"
    if path.exists() and not force:
        raise InputError(f"{path} exists; choose another folder, or overwrite it with --force.")
    if stature is not None and not 0.3 < stature < 3.0:
        raise InputError(f"--stature is {stature}; it is the person's height in metres, such as 1.75.")
    if unit is not None:
        check_choice("--unit", unit, ("m", "mm"))
    draft = draft_session([*videos, *(more or [])], calibration, cast(Unit | None, unit))
    terminal.output_folder(folder)
    path.write_text(session_lines(draft, folder, stature), encoding="utf-8")
    session = load_session(path)  # what was written must be what `track` reads
    views_of(session, rig_of(session))
    facts, lacks = findings(draft), missing(draft, path, stature)
    if json:
        terminal.emit({"id": "new", "session": path, "found": facts, "missing": lacks})
        return
    typer.echo(path)
    for sentence in facts:
        typer.echo(sentence, err=True)
    typer.echo("Still missing:" if lacks else "Nothing is missing.", err=True)
    for sentence in lacks:
        typer.echo(f"- {sentence}", err=True)
