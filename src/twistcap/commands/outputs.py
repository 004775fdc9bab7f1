"""Files made of a result: exports, angle plot, overlay video and report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from twistcap.body import Posed
from twistcap.camera import Rig
from twistcap.commands.gait_files import angle_sigmas, draw_cycles
from twistcap.errors import InputError
from twistcap.estimate import UNSEEN, Frame
from twistcap.evaluate.cycles import cycles_of, walking_angles
from twistcap.evaluate.filters import Filter, in_words
from twistcap.evaluate.gait import SIDES, gait_of
from twistcap.evaluate.load import Reference
from twistcap.evaluate.metrics import Row
from twistcap.io.coordinates import coordinates_of, opensim_angles
from twistcap.io.exports import FORMATS, ExportOptions, export, format_of, offered_formats, shared
from twistcap.io.files import check_replaceable
from twistcap.io.norms import Band
from twistcap.io.result import Result, read_result
from twistcap.io.session import Session
from twistcap.io.video import Views
from twistcap.report.overlay import bones_of, draw_mosaic, mosaic_for, overlay_video
from twistcap.report.page import Figure, Headline, write_report
from twistcap.report.plots import AngleSeries, angle_plot
from twistcap.report.verdict import camera_rows, chosen_rows, graded, verdict_of
from twistcap.report.words import result_in_words

_STRIDES = 2  # of each side, from which a walk has cycles


def own_files(folder: Path, exports: Iterable[str]) -> list[Path]:
    """What a track writes into its folder beside its result, some of it only where it is wanted."""
    formats = list(map(format_of, exports))
    names = [name for each in formats for name in (each.file_name, *each.beside)]
    return [folder / name for name in ("angles.png", "overlay.mp4", "cycles.png", "report.html", *names)]


def remove_older(path: Path, exports: Sequence[str]) -> None:
    """Remove the files that go with an older result, as it says and as new `exports` replace them; none that is read
    or read-only, no folder, and nothing else."""
    wrote = None
    with suppress(InputError):  # nobody knows what was beside it
        wrote = read_result(path).config.get("output")
    listed = wrote.get("exports") if isinstance(wrote, dict) else None
    kinds = [kind for kind in FORMATS.names() if kind in exports or (isinstance(listed, list) and kind in listed)]
    for file in filter(Path.is_file, own_files(path.parent, kinds)):
        with suppress(InputError):
            check_replaceable(file)
            file.unlink()


def write_files(result: Result, session: Session, views: Views, folder: Path, title: str) -> list[Path]:
    """Exports, angle plot and overlay, as the session wants them."""
    wanted = session.output
    options = ExportOptions(wanted.axes, wanted.angles, wanted.fill)
    files = [export(result, kind, folder, options=shared(options, kind)) for kind in wanted.exports]
    files.append(write_angle_plot(result, folder))
    if session.output.overlay:
        shown, fps = replace(views, indices=views.indices[: len(result)]), min(views.fps / session.step, 60.0)
        files.append(write_overlay(result, shown, views.image_rig, folder, fps, title))
    return files


def write_angle_plot(result: Result, folder: Path, truth: Reference | None = None) -> Path:
    """``angles.png``: all joint angles as exports have them, with their uncertainty, and the truth if there is one."""
    body, table = result.body, coordinates_of(result.body, result.poses, result.covariances, known=result.known)
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
    folder: Path, title: str, lead: str, headlines: Sequence[Headline], rows: Sequence[Row], plots: Mapping[Path, str],
    result: Result, stills: Sequence[Figure] = (), norms: Mapping[str, Band] | None = None,
    statements: Sequence[str] | None = None,
) -> Path:  # fmt: skip
    """``report.html`` about a result and the files of the folder: first a verdict, then what it rests on.

    `statements` are the sentences with which the run ended; what only the run knows of its cameras is in the verdict.
    """
    video = folder / "overlay.mp4"
    if (cycles := write_cycles(result, folder, norms or {})) is not None:
        plots = {**plots, cycles[0]: cycles[1]}
    about = {"result.h5": "everything, see docs/formats/result-file.md", "angles.png": "joint angles"}
    about |= {found.file_name: found.about for found in offered_formats()}
    files = {folder / name: words for name, words in about.items() if (folder / name).is_file()}
    known = result_in_words(result)
    doubts = [sentence for sentence in statements or () if sentence not in known]
    return write_report(
        folder, title, rows, lead=lead, verdict=verdict_of(result, doubts), statements=known,
        headlines=headlines, stills=stills, figures=[Figure(path, caption) for path, caption in plots.items()],
        cameras=camera_rows(result), video=video if video.is_file() else None, files=files,
    )  # fmt: skip


def write_cycles(result: Result, folder: Path, norms: Mapping[str, Band]) -> tuple[Path, str] | None:
    """``cycles.png`` and its caption: joint angles over 0 to 100 % of the gait cycle, before bands of published norms;
    None where no side has two strides."""
    try:
        found = gait_of(result.body, result.times, result.poses, known=result.known)
        walk = walking_angles(found, result, how := Filter())
    except InputError:  # too short, no feet, uneven times, no covariance: no walk to show
        return None
    if min(len(found.of(side)) for side in SIDES) < _STRIDES:
        return None
    curves = cycles_of(found, result.times, walk)
    caption = "Joint angles over the gait cycle, if this is a walk: mean ± standard deviation. "
    caption += in_words(how, {cycle.coordinate: cycle.cutoff for cycle in curves.values()})
    caption = " ".join([caption, *(statement.text for statement in graded(angle_sigmas(curves)))])
    return draw_cycles(folder, curves, norms), caption


def stills_of(result: Result, frames: Iterable[Frame], image_rig: Rig) -> list[Figure]:
    """The body over all views in the `frames` of `chosen_rows`, as JPEGs."""
    mosaic, bones, out = mosaic_for(image_rig), bones_of(result.body), list[Figure]()
    estimates = {estimate.index: estimate for estimate in result.estimates}
    for frame in frames:
        estimate = estimates[frame.index]
        picture = draw_mosaic(frame, Posed(result.body, estimate.pose), mosaic, "", estimate, bones)
        content = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82])[1].tobytes()
        out.append(Figure(content, f"Frame {frame.index}, {frame.time:.2f} s"))
    return out


def recorded_stills(result: Result, views: Views) -> list[Figure]:
    """`stills_of` frames that are read from the recording."""
    chosen = [int(result.indices[k]) for k in chosen_rows(result)]
    frames = [frame for index in chosen for frame in replace(views, indices=range(index, index + 1))]
    return stills_of(result, frames, views.image_rig)
