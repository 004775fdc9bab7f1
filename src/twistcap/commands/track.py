"""``twistcap track``: a person in a calibrated recording, from a session file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.doors.text import toml_value
from twistcap.errors import InputError

if TYPE_CHECKING:
    from twistcap.commands.follow import Timing


def track(
    session: Annotated[Path, typer.Argument(help="Session TOML, see docs/formats/session.md.", metavar="SESSION")],
    out: Annotated[Path | None, typer.Option(help="Folder for everything that is written.")] = None,
    method: Annotated[str | None, typer.Option(help="direct, levelset or differential.")] = None,
    frames: Annotated[str | None, typer.Option(help="FIRST:LAST, both included.")] = None,
    scale: Annotated[float | None, typer.Option(help="Resize the images by this factor.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the last saved state of OUT/result.h5, with its body.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the frames of an older OUT/result.h5.")
    ] = False,
    videos_changed: Annotated[
        bool, typer.Option("--videos-changed", help="With --resume: videos that were copied or mended show the same.")
    ] = False,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Any key of the session.")
    ] = None,
    json: terminal.Json = False,
) -> None:
    """Track a person through the recording that SESSION describes.

    Writes result.h5, overlay.mp4, angles.png, joints.trc, angles.csv and report.html.

    Examples:

      twistcap track examples/balance_4view.toml --out out/balance

      twistcap track walk.toml --method levelset --frames 0:59 --scale 0.5

      twistcap track walk.toml --out out/walk --resume

      twistcap track walk.toml --out out/walk --overwrite

      twistcap track walk.toml --set tracker.surface_sigma=0.006 --set 'body.girths.torso=1.1'
    """
    from twistcap.io.session import load_session

    said = {"tracker.method": method, "frames": terminal.frame_range(frames), "scale": scale}
    loaded = load_session(session, said | parsed_settings(set_ or []))
    folder = terminal.output_folder(out or loaded.output.folder or Path("out") / loaded.title)
    terminal.finish(run_session(loaded, folder, Begin(resume, overwrite, videos_changed)), json, tell)


@dataclass(frozen=True)
class Begin:
    """What to do with a result that is there; by default it is left alone.

    Attributes:
        resume: go on with it.
        overwrite: replace it.
        videos_changed: go on, although the videos' files are others.
    """

    resume: bool = False
    overwrite: bool = False
    videos_changed: bool = False

    def __post_init__(self) -> None:
        if self.resume and self.overwrite:
            raise InputError("--resume and --overwrite exclude each other; give one.")
        if self.videos_changed and not self.resume:
            raise InputError("--videos-changed is for --resume; give both.")


def run_session(session: Any, folder: Path, begin: Begin = Begin()) -> dict[str, Any]:
    """Track a session into a folder; what ``--json`` prints."""
    from twistcap.commands.cameras import mend_in_words, places_and_clocks
    from twistcap.commands.clocks import clocks_in_words, suspects
    from twistcap.commands.outputs import own_files
    from twistcap.io.exports import check_installed
    from twistcap.io.files import check_replaceable, keeping
    from twistcap.io.lock import WriteLock
    from twistcap.io.result import read_result
    from twistcap.report.words import beside_in_words, result_in_words

    path = folder / "result.h5"
    norms = session.output.gait_norms  # a file that cannot be read is refused before the work
    check_installed(session.output.exports)
    terminal.tell_compiling()
    unread = {"first_pose"} if begin.resume else None
    with WriteLock(path) as lock, keeping(session.model_dump(mode="json", exclude=unread)):
        check_replaceable(path, *own_files(folder, session.output.exports))  # before the work
        views, timing, watched = _tracked(session, path, begin, lock)
        result = read_result(path)
        with words.status("comparing the cameras' clocks"):
            apart = clocks_in_words(session, views, result, watched)
        wrong = places_and_clocks(mend_in_words(result, path, suspects(watched)), apart)
        given = timing.given if len(result) else None
        beside = [] if given is None else beside_in_words(result.body, given, result.estimates[0])
        statements = [*result_in_words(result), *beside, *wrong]
        files = [path, *_outputs(session, views, result, folder, timing, norms, statements)]
    lost = result.indices[result.lost].tolist()
    out, turned, swapped = (
        {name: result.indices[each].tolist() for name, each in zip(result.rig.names, rows.T, strict=True)}
        for rows in (result.left_out, np.any(result.bumps, axis=2), result.swapped)
    )
    about = {"id": "track", "result": path, "frames": len(result), "lost": lost, "left_out": out, "turned": turned}
    about |= {"swapped": swapped, "corrected": sorted(timing.corrected), "statements": statements}
    return about | {"ms_per_frame": timing.median, "files": files}


def _tracked(session: Any, path: Path, begin: Begin, lock: Any) -> tuple[Any, Timing, Any]:
    """The views, how long it took, and what was watched of the cameras."""
    from twistcap.commands.clocks import watched_by
    from twistcap.commands.follow import held
    from twistcap.commands.outputs import remove_older
    from twistcap.commands.start import show_start
    from twistcap.io.provenance import made_of
    from twistcap.io.recording import body_in_words, open_recording, rate_in_words
    from twistcap.io.result import ResultWriter

    done = held(path, begin.overwrite)
    if done is not None and begin.resume:
        return _resumed(session, path, done, begin, lock)
    if done is not None:
        mend = "go on with --resume, replace them with --overwrite, or choose another --out"
        raise InputError(f"{path} holds {len(done)} tracked frames; {mend}.")
    if begin.resume:
        terminal.say(f"{path} holds no tracked frame: there is nothing to resume, and tracking begins anew")
    with words.status("reading the session, fitting the first pose"):
        if said := body_in_words(session):  # first, since it may be why there is no first pose
            terminal.say(said)
        recording = open_recording(session)
        views, made = recording.views, made_of(session, recording.views)
    for source in views.sources:
        if source.note:
            terminal.say(f"{source.note}.")
    for said in filter(None, (rate_in_words(session, views), recording.note)):
        terminal.say(said)
    show_start(recording.report)
    tracker = session_tracker(session, recording.body, views, watch=True)
    tracker.start(recording.first_pose, recording.first_time)
    config = session.model_dump(mode="json")
    if path.exists():
        remove_older(path, session.output.exports)
    with ResultWriter(path, recording.body, recording.rig, config, made, len(views), lock) as writer:
        kept = _kept(_shown(session, views), tracker, writer, path, given=recording.first_pose)
        return views, kept, watched_by(tracker)


def _resumed(session: Any, path: Path, done: Any, begin: Begin, lock: Any) -> tuple[Any, Timing, Any]:
    """Go on with the body of the file: a resumed track is one track."""
    from twistcap.commands.clocks import watched_by
    from twistcap.commands.follow import Timing, resumed
    from twistcap.io.provenance import check_same, made_of
    from twistcap.io.recording import rig_of, views_of
    from twistcap.io.result import ResultWriter, read_result

    rig = rig_of(session)
    if rig.names != done.rig.names:
        had, has = ", ".join(done.rig.names), ", ".join(rig.names)
        raise InputError(f"{path} was tracked with cameras {had}, the session has {has}; track anew with --overwrite.")
    views = views_of(session, rig)
    check_same(path, done.recording, made_of(session, views), begin.videos_changed)
    tracker = session_tracker(session, done.body, views, watch=True)
    count, corrected = resumed(tracker, path)
    if corrected:  # the run before may have ended while it wrote them
        with ResultWriter.resume(path, count, len(views), lock) as writer:
            writer.correct(corrected)
        done = read_result(path)
    rest = views.starting_at(int(done.indices[count - 1]) + 1) if count else views
    if not len(rest):
        words.print(f"all {count} frames are tracked: there is nothing to do but to write the files anew")
        return views, Timing(), watched_by(tracker)
    words.print(f"going on after {count} frames: {len(rest)} frames to go")
    passed = _passed(_shown(session, views), done.estimates[:count])
    with ResultWriter.resume(path, count, len(views), lock) as writer:
        return views, _kept(_shown(session, rest), tracker, writer, path, passed), watched_by(tracker)


def session_tracker(session: Any, body: Any, views: Any, watch: bool = False) -> Any:
    """The session's tracker, with a watch on the cameras' clocks or without.

    Training motion is brought to the rate of the frames that are read; keypoints help to find a body that is lost.
    """
    from twistcap.adjust.refinding import with_keypoints
    from twistcap.build import of_method
    from twistcap.commands.clocks import watching
    from twistcap.io.keypoint_source import KeypointSource
    from twistcap.track import Model, Tracker

    library = session.motion_library
    motions = None if library is None else library.resampled(views.fps / session.step)
    model = of_method(body, views.image_rig, session.tracker_settings, session.pose_prior, motions)
    if session.keypoints != "start" and session.keypoint_table is not None and isinstance(model, Model):
        model = with_keypoints(model, views.rig, KeypointSource(session.keypoint_table, views))
    return Tracker(watching(model) if watch else model)


def _shown(session: Any, views: Any) -> Any:
    """The frames, with their keypoints where these are a cue."""
    from twistcap.io.keypoint_source import KeypointSource

    if session.keypoints != "cue":
        return views
    return replace(views, keypoints=KeypointSource(session.keypoint_table, views))


def _passed(views: Any, estimates: Sequence[Any]) -> Iterator[Any]:
    """The last frames that have been tracked, which may be looked at again."""
    from twistcap.hindsight import LookBack, Passed

    last = estimates[-LookBack().frames :]
    if last:
        yield from map(Passed, views.starting_at(last[0].index), last)


def _kept(views: Any, tracker: Any, writer: Any, path: Path, passed: Iterable[Any] = (), given: Any = None) -> Timing:
    from twistcap.commands.follow import follow

    try:
        return follow(views, len(views), tracker, writer, passed, given)
    except (KeyboardInterrupt, SystemError) as error:  # numba's kernels make the second of the first
        if not terminal.by_ctrl_c(error):
            raise
        kept = f"the first {len(writer)} frames are kept in {path}; go on with --resume"
        terminal.say(f"interrupted: {kept if len(writer) else 'no frame was tracked yet; begin anew'}")
        raise typer.Exit(130) from None


def _outputs(
    session: Any, views: Any, result: Any, folder: Path, timing: Timing, norms: Any, statements: list[str]
) -> list[Path]:
    from twistcap.commands import outputs
    from twistcap.report.page import Headline

    lost = int(np.sum(result.lost))
    with words.status("writing plots, exports and the overlay"):
        files = outputs.write_files(result, session, views, folder, session.title)
        if session.output.report:
            headlines = [
                Headline("frames tracked", str(len(result))),
                Headline("frames lost", str(lost), good=lost == 0),
                Headline("per frame, decoding apart", f"{timing.median:.0f}" if timing.ms else "–", "ms"),
            ]
            size = "of full size" if session.scale == 1.0 else f"scaled by {session.scale:g}"
            lead = f"{len(views.rig)} cameras, {views.fps:g} fps, images {size}."
            plots = {folder / "angles.png": "Joint angles, ± 2σ"}
            stills = outputs.recorded_stills(result, views)
            page = (folder, session.title, lead, headlines, [], plots, result, stills, norms, statements)
            files.append(outputs.write_page(*page))
    return files


def tell(document: dict[str, Any]) -> None:
    """The end of a run, for a person."""
    speed = document["ms_per_frame"]
    pace = "nothing left to track" if np.isnan(speed) else f"{speed:.1f} ms each (median)"
    words.print(f"{document['frames']} frames, {pace}")
    if corrected := len(document["corrected"]):
        terminal.say(f"frames corrected or doubted by what was found later: {corrected}")
    for sentence in document["statements"]:
        terminal.say(sentence)
    for path in document["files"]:
        typer.echo(path)


def parsed_settings(settings: list[str]) -> dict[str, Any]:
    """``key=value`` pairs, the values as TOML (bare words are strings). Raises InputError for one without ``=``."""
    out: dict[str, Any] = {}
    for text in settings:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise InputError(f"--set is {text!r}; write KEY=VALUE, such as tracker.surface_sigma=0.006.")
        out[key.strip()] = toml_value(value)
    return out
