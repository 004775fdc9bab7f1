"""``twistcap new``: a session from videos and a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast, get_args

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError, check_choice


def new(
    folder: Annotated[Path, typer.Argument(help="Folder for session.toml; created if missing.", metavar="DIR")],
    calibration: Annotated[
        Path | None, typer.Option(help="Calib.toml in the format of aniposelib or Pose2Sim.")
    ] = None,
    videos: Annotated[
        list[str] | None,
        typer.Option(help="A video, a folder, or images. Write CAMERA=PATH if the name is not enough."),
    ] = None,
    more: Annotated[
        list[str] | None, typer.Argument(help="More videos, as for --videos.", metavar="[VIDEO]...")
    ] = None,
    project: Annotated[
        Path | None, typer.Option(help="Folder of Pose2Sim, OpenCap, EasyMocap or FreeMoCap. Default: DIR itself.")
    ] = None,
    trial: Annotated[str | None, typer.Option(help="Trial of the project, if it has several.")] = None,
    up: Annotated[str | None, typer.Option(help="Axis of a project's calibration that is up: x, -x, y …")] = None,
    unit: Annotated[str | None, typer.Option(help="m or mm: unit of the calibration, if it does not say.")] = None,
    stature: Annotated[float | None, typer.Option(help="Height of the person, m.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing session.toml.")] = False,
    json: terminal.Json = False,
) -> None:
    """Write a session.toml with comments, check videos and calibration, and list what is missing.

    Examples:

      twistcap new walk --calibration walk/Calib.toml --videos walk/videos

      twistcap new walk --calibration Calib.toml --videos *.mp4 --stature 1.82

      twistcap new walk --project pose2sim/Trial_1

      twistcap new walk --calibration Calib.toml --videos left=a.mp4 --videos right=b.mp4
    """
    from twistcap.commands.start import show_start, start_document
    from twistcap.io.calibration import Unit
    from twistcap.io.cameras.axes import Up
    from twistcap.io.new_session import draft_session, findings, missing, session_lines
    from twistcap.io.projects import draft_project, found_project
    from twistcap.io.recording import open_recording, rig_of, views_of
    from twistcap.io.session import load_session

    path = folder / "session.toml"
    if path.exists() and not force:
        raise InputError(f"{path} exists; choose another folder, or overwrite it with --force.")
    if stature is not None and not 0.3 < stature < 3.0:
        raise InputError(f"--stature is {stature}; it is the person's height in metres, such as 1.75.")
    if unit is not None:
        check_choice("--unit", unit, ("m", "mm"))
    if up is not None:
        check_choice("--up", up, get_args(Up))
    if calibration is not None and videos:
        draft = draft_session([*videos, *(more or [])], calibration, cast(Unit | None, unit))
    elif calibration is None and not videos:
        found = found_project(project or folder, trial)
        draft = draft_project(found, folder, cast(Unit | None, unit), cast(Up | None, up))
        stature = stature or found.stature
    else:
        raise InputError("give both --calibration and --videos, or neither for the folder of another program.")
    terminal.output_folder(folder)
    path.write_text(session_lines(draft, folder, stature), encoding="utf-8")
    session = load_session(path)  # what was written must be what `track` reads
    views_of(session, rig_of(session))
    facts, lacks = findings(draft), missing(draft, path, stature)
    report = None
    try:
        report = open_recording(session).report if draft.keypoints else None
    except InputError as error:
        lacks.append(f"A first pose: the keypoints give none ({str(error).rstrip('.')}).")
    if json:
        start = start_document(report)
        terminal.emit({"id": "new", "session": path, "found": facts, "missing": lacks, "first_pose": start})
        return
    typer.echo(path)
    for sentence in facts:
        typer.echo(sentence, err=True)
    typer.echo("Still missing:" if lacks else "Nothing is missing.", err=True)
    for sentence in lacks:
        typer.echo(f"- {sentence}", err=True)
    show_start(report)
    typer.echo(f"Next:  twistcap track {path}", err=True)
