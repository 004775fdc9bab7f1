"""``twistcap refine``: a whole track refined, with the lengths and joint centres of its body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.errors import InputError, check


def refine(
    result: terminal.ResultFile,
    out: Annotated[
        Path | None, typer.Option(help="Folder for all files. Default: `refined` in the folder of RESULT.")
    ] = None,
    frames: Annotated[str | None, typer.Option(help="FIRST:LAST, both included.")] = None,
    session: Annotated[Path | None, typer.Option(help="Session that names the videos, if they have moved.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting of docs/how-to/refine.md.")
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Track once more with the refined body, and refine that track.")
    ] = False,
    cameras: Annotated[
        bool, typer.Option("--cameras", help="Mend the cameras that were left out, in place of poses and body.")
    ] = False,
    camera: Annotated[
        list[str] | None,
        typer.Option("--camera", metavar="CAMERA", help="Mend this one, also where it was not left out."),
    ] = None,
    stature: Annotated[
        float | None, typer.Option(help="Height of the person, m: scale the cameras by it, in place of poses and body.")
    ] = None,
    json: terminal.Json = False,
) -> None:
    """Refine a track over all its frames together: poses, segment lengths, girths and joint centres.

    Writes refined.h5 (for view, export and evaluate), angles.png, the session's exports and overlay.mp4. With --cameras
    it finds out where bumped or badly calibrated cameras stand, and writes a new Calib.toml. With --stature that is the
    old one, scaled so that the person is so tall.

    Examples:

      twistcap refine out/walk/result.h5

      twistcap refine out/walk/result.h5 --again

      twistcap refine out/walk/result.h5 --frames 0:59 --set joint=0 --out out/walk-refined

      twistcap refine out/walk --cameras

      twistcap refine out/walk/refined/refined.h5 --stature 1.75
    """
    from twistcap.commands.track import parsed_settings
    from twistcap.io.session import load_session

    loaded = None if session is None else load_session(session)
    span, folder = terminal.frame_range(frames), out or result.parent / "refined"
    if stature is not None:
        _scale(result, folder, loaded, stature, bool(set_ or again or span or cameras or camera), json)
        return
    if cameras or camera:
        _mend(result, folder, loaded, camera or [], bool(set_ or again or span), json)
        return
    terminal.finish(run_refine(result, folder, loaded, parsed_settings(set_ or []), span, again), json, show)


def _mend(path: Path, folder: Path, session: Any, names: list[str], more: bool, json: bool) -> None:
    from twistcap.commands.cameras import mend_cameras, show
    from twistcap.io.result import read_result

    if more:
        raise InputError("--cameras goes without --frames, --set and --again; refine the poses after tracking again.")
    terminal.finish(mend_cameras(path, folder, session or _session(read_result(path), path), names), json, show)


def _scale(path: Path, folder: Path, session: Any, stature: float, more: bool, json: bool) -> None:
    from twistcap.commands.new import check_stature
    from twistcap.commands.scale import scaled_cameras, show
    from twistcap.io.result import read_result

    if more:
        raise InputError("--stature goes without --cameras, --frames, --set and --again; refine again after tracking.")
    check_stature(stature)
    session = session or _session(read_result(path), path)
    terminal.finish(scaled_cameras(path, folder, session, stature), json, show)


def run_refine(
    path: Path, out: Path, session: Any = None, settings: Mapping[str, Any] | None = None,
    span: tuple[int, int] | None = None, again: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Refine a result into a folder, with its own session or another; what ``--json`` prints."""
    from twistcap.adjust.refine import RefineConfig
    from twistcap.adjust.refine import refine as refined
    from twistcap.doors.strict import dataclass_from
    from twistcap.io.files import check_replaceable, keeping
    from twistcap.io.result import read_result
    from twistcap.report.words import result_in_words

    result = terminal.tracked(path)
    terminal.tell_range(path, result, span)
    config = dataclass_from(RefineConfig, settings or {}, "--set", "refine")
    session = session or _session(result, path)
    chosen = [e for e in result.estimates if span is None or span[0] <= e.index <= span[1]]
    views = _views(session, result.rig, [e.index for e in chosen], path)
    folder = terminal.output_folder(out)
    with keeping(path, session.model_dump(mode="json")):
        check_replaceable(folder / "refined.h5")  # before the work
    tracker, rig = session.tracker_settings, views.image_rig
    with terminal.status("refining") as report:
        refinement = refined(views, result.body, rig, chosen, config, tracker, report)
    if again:
        retracked = _tracked_again(session, refinement, views)
        with terminal.status("refining again") as report:
            body, shape = refinement.body, refinement.shape
            refinement = refined(views, body, rig, retracked, config, tracker, report, shape)
    about = {"id": "refine", "result": folder / "refined.h5", "frames": len(chosen)}
    about |= {"moved_mm": [1000.0 * step for step in refinement.moved], "helped": refinement.helped}
    about |= {"design_effect": refinement.design_effect, "joints_held": not refinement.joint_shifts}
    about |= _shape(result.body, refinement)
    about |= {"files": _written(result, refinement, session, views, folder)}
    return about | {"statements": result_in_words(read_result(folder / "refined.h5"))}


def _session(result: Any, path: Path) -> Any:
    """The session that the result was tracked with, as the file keeps it."""
    from twistcap.doors.strict import validated
    from twistcap.io.session import Session
    from twistcap.io.video import is_there

    data = {key: value for key, value in result.config.items() if key != "refined"}
    if "videos" not in data:
        raise InputError(f"{path} was not made from a session and names no videos; give a session with --session.")
    session = validated(Session, data, str(path), {"folder": Path()})
    for video in session.videos.values():
        if not is_there(video):
            raise InputError(f"{path}: its video {video} does not exist; if the recording has moved, give --session.")
    return session


def _views(session: Any, rig: Any, indices: list[int], path: Path) -> Any:
    """The frames of the estimates; InputError where there are few, or some are missing between them or in videos."""
    from twistcap.io.recording import views_of

    if len(indices) < 3:
        raise InputError(f"{path}: only {len(indices)} frames are chosen; refining needs at least 3 (see --frames).")
    steps = set(np.diff(indices).tolist())
    check(str(path), len(steps) <= 1, "its frames are not evenly spaced; choose evenly spaced ones with --frames")
    views = views_of(session.model_copy(update={"frames": (indices[0], indices[-1])}), rig)
    return replace(views, indices=range(indices[0], indices[-1] + 1, steps.pop()))


def _tracked_again(session: Any, refinement: Any, views: Any) -> list[Any]:
    """Estimates of the same frames, tracked with the refined body from its first pose."""
    from twistcap.commands.track import session_tracker
    from twistcap.hindsight import Hindsight

    tracker = session_tracker(session, refinement.body, views)
    tracker.start(refinement.estimates[0].pose, refinement.estimates[0].time)
    retracked: list[Any] = []
    with terminal.status("tracking again") as report:
        for estimate in Hindsight(tracker).through(views):
            retracked.append(estimate)
            report(f"frame {estimate.index}", len(retracked), len(views))
    return retracked


def _shape(before: Any, refinement: Any) -> dict[str, Any]:
    """How the body's shape changed: factors with their standard deviations, joint centres in mm."""
    from twistcap.body.shape import joint_distances

    def factors(given: Any, sigmas: Any) -> list[dict[str, Any]]:
        return [{"group": name, "factor": factor, "sigma": sigmas[name]} for name, factor in given.items()]

    new, shifts, sigmas = joint_distances(refinement.body), refinement.joint_shifts, refinement.joint_sigmas
    bones = [(name, 1000 * old, 1000 * new[name]) for name, old in joint_distances(before).items()]
    return {
        "lengths": factors(refinement.lengths, refinement.length_sigmas),
        "girths": factors(refinement.girths, refinement.girth_sigmas),
        "bones": [{"segment": name, "before_mm": old, "after_mm": now} for name, old, now in bones],
        "joints": [{"segment": n, "shift_mm": 1000 * s, "sigma_mm": 1000 * sigmas[n]} for n, s in shifts.items()],
    }


def _written(result: Any, refinement: Any, session: Any, views: Any, folder: Path) -> list[Path]:
    from twistcap.io.result import ResultWriter

    path = folder / "refined.h5"
    kept = {**result.config, "refined": {"moved_m": list(refinement.moved), "lengths": dict(refinement.lengths)}}
    with ResultWriter(path, refinement.body, result.rig, kept, room=len(refinement.estimates)) as writer:
        for estimate in refinement.estimates:
            writer.append(estimate)
    return [path, *_files(path, session, views)]


def write_again(path: Path, session: Any) -> None:
    """Write the files made of a refined result anew, as a session wants them."""
    from twistcap.io.result import read_result

    result = read_result(path)
    _files(path, session, _views(session, result.rig, result.indices.tolist(), path))


def _files(path: Path, session: Any, views: Any) -> list[Path]:
    from twistcap.commands import outputs
    from twistcap.io.files import keeping
    from twistcap.io.result import read_result

    read = keeping(session.model_dump(mode="json"))
    with words.status("writing plots, exports and the overlay"), read:
        return outputs.write_files(read_result(path), session, views, path.parent, f"{session.title} refined")


def show(document: dict[str, Any]) -> None:
    """Print the end of a run for a person."""
    lengths, girths = ({i["group"]: (f"{100 * (i['factor'] - 1):+.1f} %", f"{100 * i['sigma']:.1f} %")
                        for i in document[kind]} for kind in ("lengths", "girths"))  # fmt: skip
    rows = [[group, *lengths.get(group, ("", "")), *girths.get(group, ("", ""))] for group in lengths | girths]
    terminal.show_table("shape", ["segments", "length", "± (1σ)", "girth", "± (1σ)"], rows, ["segments"])
    for bone in document["bones"]:
        before, after = (f"{bone[key]:.0f} mm" for key in ("before_mm", "after_mm"))
        if before != after:
            words.print(f"{bone['segment']}: {before} before, {after} after")
    moved = ", ".join(f"{step:.1f}" for step in document["moved_mm"])
    words.print(f"{document['frames']} frames; the landmarks moved {moved} mm from round to round")
    if document["joints_held"]:
        why = "the surface is not quite the person's, so lengths and joint centres were held."
        words.print(f"Contours err together (design effect {document['design_effect']:.1f}): {why}")
    if not document["helped"]:
        words.print("The images agree less than before: refining did not help, and the track is kept as it was.")
    for sentence in document["statements"]:
        terminal.say(sentence)
    for path in document["files"]:
        typer.echo(path)
