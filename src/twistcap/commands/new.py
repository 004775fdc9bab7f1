"""``twistcap new``: a session from videos and a calibration."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError, check_choice

Folder = Annotated[Path, typer.Argument(help="Folder for session.toml; created if missing.", metavar="DIR")]
CalibrationFile = Annotated[
    Path | None, typer.Option("--calibration", help="Calib.toml of `twistcap calibrate` or `convert`, or of Pose2Sim.")
]
Project = Annotated[
    Path | None, typer.Option(help="Folder of Pose2Sim, OpenCap, EasyMocap or FreeMoCap. Default: DIR itself.")
]
Trial = Annotated[str | None, typer.Option(help="Trial of the project, if it has several.")]
UpAxis = Annotated[
    str | None,
    typer.Option("--up", help="Axis of the calibration that is up: x, -x, y … Default: z; a project's is found."),
]
UnitName = Annotated[
    str | None,
    typer.Option("--unit", help="m or mm: unit of the calibration. Default: what it says, or its cameras tell."),
]
Stature = Annotated[float | None, typer.Option(help="Height of the person, m.")]
DetectorName = Annotated[
    str | None, typer.Option("--detector", help="Keypoint detector for the first pose: MODEL.onnx, or the name of one.")
]
People = Annotated[str | None, typer.Option(help="With --detector RTMPose: a YOLOX that finds people.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite an existing session.toml.")]


def new(
    folder: Folder, calibration: CalibrationFile = None, videos: terminal.Videos = None,
    more: terminal.MoreVideos = None, project: Project = None, trial: Trial = None, up: UpAxis = None,
    unit: UnitName = None, stature: Stature = None, detector: DetectorName = None, people: People = None,
    force: Force = False, json: terminal.Json = False,
) -> None:  # fmt: skip
    """Write a session.toml with comments, check videos and calibration, and list what is missing.

    Examples:

      twistcap new walk --calibration walk/Calib.toml --videos walk/videos

      twistcap new walk --calibration Calib.toml --videos *.mp4 --stature 1.82

      twistcap new walk --project pose2sim/Trial_1

      twistcap new walk --calibration Calib.toml --videos walk/videos --detector rtmo.onnx

      twistcap new walk --calibration Calib.toml --videos left=a.mp4 --videos right=b.mp4
    """
    path = folder / "session.toml"
    if path.exists() and not force:
        raise InputError(f"{path} exists; choose another folder, or overwrite it with --force.")
    check_stature(stature)
    if people is not None and detector is None:
        raise InputError("--people is for --detector; name both.")
    if detector is not None:
        from twistcap.io.detectors import check_detector

        check_detector(detector, people)
    given = [*(videos or []), *(more or [])]
    draft, known = _drafted(folder, calibration, given, project, trial, up, unit)
    draft = replace(draft, detector=detector, people=people)
    if not force:
        _check_converted(draft)
    _tell(_written(draft, path, stature or known), json)


def _check_converted(draft: Any) -> None:
    """Raises InputError where another calibration is in the place of the one that is to be written."""
    path, text = draft.calibration, draft.converted
    if text is not None and path.exists() and path.read_bytes() != text.encode():
        fact = f"{path} exists, and is not the project's calibration"
        raise InputError(f"{fact}; choose another folder, or overwrite it with --force.")


def check_stature(stature: float | None) -> None:
    """Raises InputError for a height, m, that nobody has."""
    if stature is not None and not 0.3 < stature < 3.0:
        raise InputError(f"--stature is {stature}; it is the person's height in metres, such as 1.75.")


@dataclass(frozen=True)
class _Written:
    """A session that is written, and what is to be said of it."""

    path: Path
    found: list[str]
    missing: list[str]
    then: list[str]  # what comes next
    report: Any  # on the first pose, if there is one


def _drafted(
    folder: Path, calibration: Path | None, videos: list[str], project: Path | None, trial: str | None,
    up: str | None, unit: str | None,
) -> tuple[Any, float | None]:  # fmt: skip
    """The draft of calibration and videos, or of another program's project, and the person's stature if that has it."""
    from twistcap.io.cameras.axes import Up
    from twistcap.io.cameras.units import session_unit
    from twistcap.io.new_session import draft_session
    from twistcap.io.projects import draft_project, found_project

    if up is not None:
        check_choice("--up", up, get_args(Up))
    if calibration is not None and videos:
        for option, value in (("--project", project), ("--trial", trial)):
            if value is not None:
                raise InputError(f"{option} is for the folder of another program; leave it away, or the videos.")
        return draft_session(videos, calibration, session_unit(unit), cast(Up | None, up)), None
    if calibration is not None or videos:
        raise InputError("give both --calibration and --videos, or neither for the folder of another program.")
    found = found_project(project or folder, trial)
    return draft_project(found, folder, unit, cast(Up | None, up)), found.stature


def _written(draft: Any, path: Path, stature: float | None) -> _Written:
    """Write the session, read it as `track` would, and fit the first pose if it has keypoints."""
    from twistcap.io.new_session import findings, missing, next_steps, session_lines
    from twistcap.io.recording import open_recording, rig_of, views_of
    from twistcap.io.session import load_session

    terminal.output_folder(path.parent)
    with _as_it_was_if_refused(path, draft.calibration):
        if draft.converted is not None:
            draft.calibration.write_text(draft.converted, encoding="utf-8")
        path.write_text(session_lines(draft, path.parent, stature), encoding="utf-8")
        session = load_session(path)
        views_of(session, rig_of(session))
    lacks, report, has_keypoints = missing(draft, path, stature), None, bool(draft.keypoints or draft.detector)
    if has_keypoints:
        try:
            with terminal.words.status("fitting the first pose"):
                report = open_recording(session).report
        except InputError as error:
            lacks.append(f"A first pose: the keypoints give none ({str(error).rstrip('.')}).")
    return _Written(path, findings(draft), lacks, next_steps(draft, path, has_keypoints and report is None), report)


@contextmanager
def _as_it_was_if_refused(*paths: Path) -> Generator[None]:
    before = {path: path.read_bytes() if path.exists() else None for path in paths}
    try:
        yield
    except (InputError, OSError):
        for path, content in before.items():
            if content is None:
                path.unlink(missing_ok=True)
            elif path.read_bytes() != content:
                path.write_bytes(content)
        raise


def _tell(made: _Written, json: bool) -> None:
    from twistcap.commands.start import show_start, start_document

    if json:
        about = {"id": "new", "session": made.path, "found": made.found, "missing": made.missing, "next": made.then}
        terminal.emit(about | {"first_pose": start_document(made.report)})
        return
    typer.echo(made.path)
    for sentence in made.found:
        typer.echo(sentence, err=True)
    typer.echo("Still missing:" if made.missing else "Nothing is missing.", err=True)
    for sentence in made.missing:
        typer.echo(f"- {sentence}", err=True)
    show_start(made.report)
    for sentence in made.then:
        typer.echo(sentence, err=True)
