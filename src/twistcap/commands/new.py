"""``twistcap new``: a session from videos and a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError


def new(
    folder: Annotated[Path, typer.Argument(help="Folder for session.toml; made if need be.", metavar="DIR")],
    calibration: Annotated[Path, typer.Option(help="Calib.toml of the aniposelib / Pose2Sim family.")],
    videos: Annotated[
        list[str], typer.Option(help="A video, a folder, or images; CAMERA=PATH where the name does not tell.")
    ],
    more: Annotated[
        list[str] | None, typer.Argument(help="More videos, as for --videos.", metavar="[VIDEO]...")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="m or mm: unit of the calibration, where it does not say.")] = None,
    stature: Annotated[float | None, typer.Option(help="Height of the person, m.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a session.toml that exists.")] = False,
    json: terminal.Json = False,
) -> None:
    """Write a commented session.toml, check that videos and calibration fit, and say what is missing.

    Examples:

      twistcap new walk --calibration walk/Calib.toml --videos walk/videos

      twistcap new walk --calibration Calib.toml --videos *.mp4 --stature 1.82

      twistcap new walk --calibration Calib.toml --videos left=a.mp4 --videos right=b.mp4
    """
    from twistcap.io.new_session import draft_session, findings, missing, session_lines
    from twistcap.io.recording import rig_of, views_of
    from twistcap.io.session import load_session

    path = folder / "session.toml"
    if path.exists() and not force:
        raise InputError(f"{path} exists; choose another folder, or write over it with --force.")
    if stature is not None and not 0.3 < stature < 3.0:
        raise InputError(f"--stature is {stature}; it is the person's height in metres, such as 1.75.")
    draft = draft_session([*videos, *(more or [])], calibration, _unit(unit))
    terminal.output_folder(folder)
    path.write_text(session_lines(draft, folder, stature), encoding="utf-8")
    session = load_session(path)  # what was written must be what `track` reads
    views_of(session, rig_of(session))
    found, lacks = findings(draft), missing(draft, path, stature)
    if json:
        terminal.emit({"id": "new", "session": path, "found": found, "missing": lacks})
        return
    typer.echo(path)
    for sentence in found:
        typer.echo(sentence, err=True)
    typer.echo("Still missing:" if lacks else "Nothing is missing.", err=True)
    for sentence in lacks:
        typer.echo(f"- {sentence}", err=True)


def _unit(text: str | None) -> Literal["m", "mm"] | None:
    if text not in (None, "m", "mm"):
        raise InputError(f"--unit is {text!r}; it must be m or mm.")
    return text
