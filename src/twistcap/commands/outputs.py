"""Files made of a result: exports, angle plot, overlay video and report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.camera import Rig
from twistcap.estimate import UNSEEN, Frame
from twistcap.evaluate.load import Reference
from twistcap.io.coordinates import coordinates_of, opensim_angles
from twistcap.io.exports import FORMATS, ExportOptions, export, format_of
from twistcap.io.result import Result
from twistcap.io.session import Session
from twistcap.io.video import Views
from twistcap.report import Figure, Headline, angle_plot, overlay_video, write_report
from twistcap.report.plots import AngleSeries


def write_files(result: Result, session: Session, views: Views, folder: Path, title: str) -> list[Path]:
    """Exports, angle plot and overlay, as the session wants them."""
    wanted = session.output
    options = ExportOptions(wanted.axes, wanted.angles, wanted.fill)
    files = [export(result, kind, folder, options=options) for kind in wanted.exports]
    files.append(write_angle_plot(result, folder))
    if session.output.overlay:
        shown, fps = replace(views, indices=views.indices[: len(result)]), min(views.fps / session.step, 60.0)
        files.append(write_overlay(result, shown, views.image_rig, folder, fps, title))
    return files


def write_angle_plot(result: Result, folder: Path, truth: Reference | None = None) -> Path:
    """``angles.png``: all joint angles as exports have them, with their uncertainty, and the truth if there is one."""
    body, table = result.body, coordinates_of(result.body, result.poses, result.covariances)
    k = [table.names.index(name) for name in body.coordinate_names]
    series = AngleSeries(result.times, body.coordinate_names, table.values[:, k], table.sigmas[:, k])
    dropped = np.array([status in UNSEEN for status in result.statuses])
    theirs = None
    if truth is not None and truth.coordinate_names:
        angles = opensim_angles(body, truth.coordinate_names, truth.angles)
        theirs = AngleSeries(truth.times, truth.coordinate_names, angles)
    return angle_plot(folder / "angles.png", series, theirs, result.lost, dropped, "Joint angles")


def write_overlay(
    result: Result, frames: Iterable[Frame], image_rig: Rig, folder: Path, fps: float, title: str
) -> Path:
    """``overlay.mp4``: the body over every view, side by side."""
    return overlay_video(folder / "overlay.mp4", frames, image_rig, result.estimates, result.body, fps, title)


def write_page(
    folder: Path, title: str, lead: str, headlines: Sequence[Headline], rows: Sequence[Any], plots: Mapping[Path, str],
    told: Sequence[str],
) -> Path:  # fmt: skip
    """``report.html`` about the files of the folder; `told` says what is doubtful."""
    video = folder / "overlay.mp4"
    about = {"result.h5": "everything, see docs/formats/result-file.md", "angles.png": "joint angles"}
    about |= {found.file_name: found.about for found in map(format_of, FORMATS.names())}
    files = {folder / name: words for name, words in about.items() if (folder / name).is_file()}
    figures = [Figure(path, caption) for path, caption in plots.items()]
    shown = video if video.is_file() else None
    return write_report(
        folder, title, rows, lead=lead, told=told, headlines=headlines, figures=figures, video=shown, files=files
    )
