"""Files made of a result: motion formats, angle plot, overlay video and report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from twistcap.body import Posed
from twistcap.body.gltf_write import save_glb
from twistcap.camera import Rig
from twistcap.commands.follow import angle_sigmas, frame_rate
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.evaluate.load import Reference
from twistcap.io.bvh import write_bvh
from twistcap.io.markers import write_trc
from twistcap.io.motion_files import write_csv, write_mot
from twistcap.io.result import Result
from twistcap.io.session import ExportKind
from twistcap.report import Figure, Headline, angle_plot, joint_error_plot, overlay_video, write_report
from twistcap.report.plots import AngleSeries

FILE_NAMES: Mapping[str, str] = {
    "trc": "joints.trc",
    "mot": "angles.mot",
    "bvh": "motion.bvh",
    "csv": "angles.csv",
    "glb": "motion.glb",
}
ABOUT: Mapping[str, str] = {
    "result.h5": "everything, see docs/formats/result-file.md",
    "joints.trc": "joint centres (OpenSim, Mokka)",
    "angles.mot": "joint angles (OpenSim)",
    "motion.bvh": "skeleton and motion (Blender, MotionBuilder)",
    "angles.csv": "joint angles and their standard deviations",
    "motion.glb": "skinned body and motion (any glTF viewer)",
    "angles.png": "joint angles",
}


def export(result: Result, kind: str, path: str | Path) -> Path:
    """Write a result in another format.

    Raises:
        InputError: for an unknown format, a result without frames, or a file that cannot be written.
    """
    writers: dict[str, Callable[[Result, Path], Any]] = {
        "trc": _trc,
        "mot": lambda r, p: write_mot(p, r.body, r.times, r.poses),
        "bvh": lambda r, p: write_bvh(p, r.body, r.poses, frame_rate(r.times)),
        "csv": lambda r, p: write_csv(p, r.body, r.estimates),
        "glb": lambda r, p: save_glb(r.body, p, r.poses, frame_rate(r.times)),
    }
    if kind not in writers:
        raise InputError(f"--to is {kind!r}; it must be one of {', '.join(get_args(ExportKind))}.")
    if not len(result):
        raise InputError("the result has no frame; there is nothing to export.")
    try:
        writers[kind](result, Path(path))
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; choose another with --out.") from error
    return Path(path)


def _trc(result: Result, path: Path) -> None:
    points = np.stack([Posed(result.body, pose).landmarks for pose in result.poses])
    write_trc(path, result.times, result.body.landmarks.names, points)


def write_exports(result: Result, kinds: Iterable[str], folder: Path) -> list[Path]:
    """Each format under its usual name."""
    return [export(result, kind, folder / FILE_NAMES[kind]) for kind in kinds]


def write_angle_plot(result: Result, folder: Path, truth: Reference | None = None) -> Path:
    """``angles.png``: all joint angles with their uncertainty, and the truth where there is one."""
    series = AngleSeries(result.times, result.body.coordinate_names, result.q, angle_sigmas(result))
    dropped = np.array([status == "no_images" for status in result.statuses])
    known = truth is not None and bool(truth.coordinate_names)
    theirs = AngleSeries(truth.times, truth.coordinate_names, truth.angles) if truth is not None and known else None
    return angle_plot(folder / "angles.png", series, theirs, result.lost, dropped, "Joint angles")


def write_error_plot(times: Any, names: Sequence[str], errors_mm: Any, folder: Path) -> Path:
    """``joint_errors.png``."""
    return joint_error_plot(folder / "joint_errors.png", times, names, errors_mm)


def write_overlay(
    result: Result, frames: Iterable[Frame], image_rig: Rig, folder: Path, fps: float, title: str
) -> Path:
    """``overlay.mp4``: the body over every view, beside one another."""
    return overlay_video(folder / "overlay.mp4", frames, image_rig, result.estimates, result.body, fps, title)


def write_page(
    folder: Path, title: str, lead: str, headlines: Sequence[Headline], rows: Sequence[Any], plots: Mapping[Path, str]
) -> Path:
    """``report.html`` over what lies in the folder."""
    video = folder / "overlay.mp4"
    return write_report(
        folder,
        title,
        rows,
        lead=lead,
        headlines=headlines,
        figures=[Figure(path, caption) for path, caption in plots.items()],
        video=video if video.is_file() else None,
        files={folder / name: about for name, about in ABOUT.items() if (folder / name).is_file()},
    )
