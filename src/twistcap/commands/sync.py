"""``twistcap sync``: clocks of cameras that were not started together, and of keypoints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words
from twistcap.errors import InputError, check, check_choice

if TYPE_CHECKING:
    from twistcap.adjust.clocks import Coarse, KeypointClock
    from twistcap.io.clocks import Clock

_PASSES = 10  # of tracking and estimating, at most, until the clocks settle
_FIRST = 100  # frames of the first pass; twice as many, and again, where the settled clocks are not known well
_AIM = 0.02  # frames, standard deviation of a clock that is known well
_SETTLED = 0.1  # frames by which clocks may move in the last pass; that is part of what is not known of them
_SURE = 0.1  # frames, of the standard deviation of a clock that is sure by itself
_CLEAR = 3.0  # standard deviations by which the session's clock is surely worse
_LOST = 0.1  # fraction of frames that may be lost, or without a camera, where clocks are sure
_LONGEST = 120.0  # s of each recording that are compared for the coarse offsets
_RATE = {"sound": 500.0, "motion": 240.0}  # 1/s, at which signals are compared
_AGREE = {"sound": 0.15, "motion": 0.3}  # correlation from which signals are believed
_MARGIN = 0.05  # of the correlation over that of the next different offset
_APART = 0.15  # s by which another offset differs
_KEPT = 0.07  # s by which coarse offsets may differ from the given ones that are kept
_KEYPOINTS = ""  # their name among those of the cameras: they have a clock too
_OWN_CLOCKS = "the session's clocks"
_Doubt = tuple[str | None, str]  # whose clock is not sure, None for all, and why


def sync(
    session: Annotated[Path, typer.Argument(help="Session TOML; sure clocks are written.", metavar="SESSION")],
    start: Annotated[str, typer.Option(help="auto, sound, motion, or given: where to begin.")] = "auto",
    count: Annotated[int, typer.Option("--frames", min=24, help="Most frames that are tracked.")] = 400,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say the clocks, and write nothing.")] = False,
    json: terminal.Json = False,
) -> None:
    """Find out how the clocks of the cameras differ, and write it into the session as [clocks].

    Coarsely by the sound (a clap) or by how much moves in each view, then finely by the tracked body. Where the session
    has keypoints, their clock is found too. A clock that is not sure is told, and stays as it is.

    Examples:

      twistcap sync walk/session.toml

      twistcap sync walk/session.toml --start given --dry-run
    """
    check_choice("--start", start, ("auto", "sound", "motion", "given"))
    terminal.finish(synchronise(session, start, count, not dry_run), json, tell)


@dataclass(frozen=True)
class _Pass:
    """What one pass of tracking and estimating found: clocks, and what is doubtful."""

    late: Any
    sigma: Any
    frame: float  # s from one frame to the next
    tracked: int  # frames
    doubts: tuple[_Doubt, ...]
    together: tuple[int, int]
    keypoints: KeypointClock | None


def synchronise(path: Path, start: str = "auto", count: int = 400, write: bool = True) -> dict[str, Any]:
    """Estimate the clocks of a session and write those that are sure; what ``--json`` prints."""
    from twistcap.io.clocks import Clock
    from twistcap.io.recording import rig_of
    from twistcap.io.session import load_session
    from twistcap.io.session_edit import write_clocks

    session = load_session(path)
    names = (rig := rig_of(session)).names
    alone = start == "given" and session.first_pose.keypoints is not None  # one camera, and the clock of its keypoints
    mend = "sync compares the clocks of two or more cameras; name a second one and its video"
    check(f"{path}: [videos]", len(rig) > 1 or alone, mend)
    given = {name: Clock(**session.clocks[name].model_dump()) if name in session.clocks else Clock() for name in names}
    clocks, way, coarse = _coarse(session, names, given, start)
    try:
        clocks, found = _settled(session, clocks, count)
    except InputError as error:
        if not coarse or clocks == given:
            raise
        words.print(f"with the clocks by {way}, which are not clear: {error} The session's clocks are tried.")
        way = _OWN_CLOCKS
        clocks, found = _settled(session, given, count)
    doubts = [*((None, why) for why in coarse), *found.doubts, *_vague(session, given, clocks, found)]
    sure = [name for name in (*names, _KEYPOINTS) if not any(of in (None, name) for of, _ in doubts)]
    stays = next((name for name in names if name in sure), names[0])
    first = clocks[stays].offset - given[stays].offset  # the clock of this camera stays
    clocks = {name: replace(clock, offset=round(clock.offset - first, 6)) for name, clock in clocks.items()}
    rows = [
        {"camera": name, "before_s": given[name].offset, "after_s": clocks[name].offset,
         "moved_frames": (clocks[name].offset - given[name].offset) / found.frame,
         "sigma_frames": float(s) / found.frame, "sure": name in sure}
        for name, s in zip(names, found.sigma, strict=True)
    ]  # fmt: skip
    span = _within(session.frames, found.together) if {*names} <= {*sure} else None
    keypoints = None if found.keypoints is None else round(found.keypoints.offset, 3)
    known = {n: clocks[n] if n in sure else given[n] for n in names if n in sure or n in session.clocks}
    known = known if len({*names} & {*sure}) > 1 else {}  # one clock alone says nothing
    offset = keypoints if _KEYPOINTS in sure else None
    if write := write and (bool(known) or offset is not None):
        write_clocks(path, known, span, offset)
    about = {"id": "sync", "session": path, "written": write, "began_with": way, "cameras": rows, "frames": span}
    if found.keypoints is not None and session.first_pose.keypoints is not None:
        before, sigma = session.first_pose.keypoints.offset, found.keypoints.sigma
        about |= {"keypoints": {"before": before, "after": keypoints, "sigma": sigma, "sure": offset is not None}}
    return about | {"unsure": [why for _, why in doubts]}


def _settled(session: Any, clocks: dict[str, Clock], count: int) -> tuple[dict[str, Clock], _Pass]:
    """Passes until the clocks stand still and are known well, or no frames are left."""
    n, frames = 0, min(_FIRST, count)
    while True:
        n, found = n + 1, _one_pass(session, clocks, frames)
        clocks = {
            k: replace(c, offset=c.offset + float(s)) for (k, c), s in zip(clocks.items(), found.late, strict=True)
        }
        moves, sigmas = (np.abs(s) / found.frame for s in (found.late, found.sigma))
        moved, sigma = moves.max(), sigmas.max()
        words.print(f"pass {n}, {found.tracked} frames: clocks moved by up to {moved:.2f} frames, known to {sigma:.3f}")
        moving = moves >= _SETTLED
        if moving.any() and n < _PASSES:
            continue
        if moving.any() or sigma <= _AIM or found.tracked < frames or frames == count:
            still = "the clock of {} still moved by {:.2f} frames in the last pass"
            doubts = tuple((k, still.format(k, by)) for k, by, m in zip(clocks, moves, moving, strict=True) if m)
            unsure = np.hypot(found.sigma, found.late)
            return clocks, replace(found, sigma=unsure, doubts=(*doubts, *found.doubts))
        n, frames = 0, min(2 * frames, count)


def _within(frames: tuple[int, int] | None, together: tuple[int, int]) -> tuple[int, int] | None:
    """The session's frames as far as all cameras have them; None where they need not change."""
    if frames is None or (together[0] <= frames[0] and frames[1] <= together[1]):
        return None
    return max(frames[0], together[0]), min(frames[1], together[1])


def _coarse(
    session: Any, names: tuple[str, ...], given: dict[str, Clock], start: str
) -> tuple[dict[str, Clock], str, tuple[str, ...]]:
    """Clocks to begin with, how they were found, and doubts: by the first way that is clear, else the clearest."""
    found: dict[str, Coarse] = {}
    for way in ("sound", "motion"):
        if start not in (way, "auto"):
            continue
        signals = _signals(session, names, given, way)
        if signals is None and start == way:
            raise InputError(
                f"--start is {way!r}, but not all cameras have a second of it; choose another, or leave it out."
            )
        if signals is not None:
            found[way] = _together(signals, way)
            if _clearness(way, found[way]) > 1.0:
                break
    if not found:
        return given, _OWN_CLOCKS, ()
    best = max(found, key=lambda way: _clearness(way, found[way]))
    doubts = () if _clearness(best, found[best]) > 1.0 else (_doubt(best, names, found),)
    offsets = np.array([given[name].offset for name in names])
    if np.abs(found[best].offsets - (offsets - offsets[0])).max() < _KEPT:
        ambiguous = found[best].correlation.min() > _AGREE[best]
        return given, _OWN_CLOCKS, doubts if ambiguous else ()
    moved = offsets[0] + found[best].offsets
    return {n: replace(given[n], offset=float(o)) for n, o in zip(names, moved, strict=True)}, best, doubts


def _together(signals: list[Any], way: str) -> Coarse:
    from twistcap.adjust.clocks import coincidence

    shared = min(5.0, 0.4 * min(s.times[-1] - s.times[0] for s in signals))
    return coincidence(signals, _RATE[way], shared, _APART)


def _clearness(way: str, found: Coarse) -> float:
    """How clearly signals agree at the offsets found, and nowhere else; they are believed above 1."""
    return float(min(found.correlation.min() / _AGREE[way], found.margin.min() / _MARGIN))


def _doubt(best: str, names: tuple[str, ...], found: dict[str, Coarse]) -> str:
    worst = names[int(np.argmin(found[best].margin))]
    chosen = f"; neither sound nor motion is clear, and the {best} is clearer" if len(found) > 1 else ""
    fits = f"the {best} of {worst} fits that of the others at several offsets"
    return f"{fits}{chosen}; film a clap that all cameras hear, or begin with rough [clocks], as --start given"


def _signals(session: Any, names: tuple[str, ...], given: dict[str, Clock], way: str) -> list[Any] | None:
    from twistcap.adjust.clocks import motion_signal, sound_signal
    from twistcap.io.clocks import image_times
    from twistcap.io.soundtrack import RATE, read_sound
    from twistcap.io.video import open_source

    out = list[Any]()
    with terminal.progress(f"comparing the {way}", len(names)) as advance:
        for name in names:
            if way == "sound":
                samples = read_sound(session.videos[name], _LONGEST)
                if samples is None:
                    return None
                out.append(sound_signal(samples, RATE))
            else:
                source = open_source(session.videos[name])
                times = image_times(source, replace(given[name], offset=0.0), session.fps)
                times = times[times <= _LONGEST]
                out.append(motion_signal(source.read(range(len(times))), times))
            advance(name)
    return out if min(len(s.times) for s in out) > 10 else None


def _one_pass(session: Any, clocks: dict[str, Clock], count: int) -> _Pass:
    """Track with these clocks, and estimate them anew."""
    from twistcap.adjust.clocks import estimate_clocks
    from twistcap.commands.track import session_tracker
    from twistcap.hindsight import Hindsight
    from twistcap.io.recording import open_recording
    from twistcap.io.session_tables import ClockTable

    tables = {name: ClockTable(offset=c.offset, rate=c.rate, fps=c.fps) for name, c in clocks.items()}
    session = session.model_copy(update={"clocks": tables})
    session, together = _window(session, count)
    recording = open_recording(session)
    views = recording.views
    tracker = session_tracker(session, recording.body, views)
    tracker.start(recording.first_pose, recording.first_time)
    estimates = list[Any]()
    with terminal.progress("tracking", len(views)) as advance:
        for estimate in Hindsight(tracker).through(views):
            estimates.append(estimate)
            advance("")
    timeline = views.timeline
    with terminal.status("estimating clocks") as report:
        body, rig, settings = recording.body, views.image_rig, session.tracker_settings
        own = [replace(e, left_out=e.swapped) for e in estimates]
        found = estimate_clocks(
            replace(views, moved=False), body, rig, own, views.lags, timeline.reference, settings, report=report
        )
    frame = timeline.intervals[timeline.reference]
    swapped = any(e.sources for e in estimates)  # then keypoints are not those of their cameras
    keypoints = (
        None
        if swapped
        else _keypoint_clock(session, recording, found.poses.poses, (views.lags + found.late[:, None]) / frame)
    )
    doubts = _doubts(rig.names, estimates)
    return _Pass(found.late, found.sigma, frame, len(estimates), doubts, together, keypoints)


def _window(session: Any, count: int) -> tuple[Any, tuple[int, int]]:
    """The session with frames to be tracked, and all frames that every camera has."""
    from twistcap.io.recording import rig_of, timeline_of

    together = timeline_of(session, rig_of(session)).together
    first = together[0] if session.frames is None else max(session.frames[0], together[0])
    last = min(together[-1] if session.frames is None else session.frames[1], together[-1], first + count - 1)
    return session.model_copy(update={"frames": (first, last), "step": 1}), (together[0], together[-1])


def _vague(session: Any, given: dict[str, Clock], clocks: dict[str, Clock], found: _Pass) -> list[_Doubt]:
    """Clocks that are not known well, and where the session's own may be as good."""
    news = np.array([clock.offset - given[name].offset for name, clock in clocks.items()])
    moved, sigmas = (news - news[np.argmin(found.sigma)]) / found.frame, found.sigma / found.frame
    known = [(name, f"clock of {name}", m, s) for name, m, s in zip(clocks, moved, sigmas, strict=True)]
    if (own := found.keypoints) is not None:
        moved_by = own.offset - session.first_pose.keypoints.offset
        known.append((_KEYPOINTS, "clock of the keypoints", moved_by, own.sigma))
    return [
        (of, f"the {what} is known to ± {s:.2f} frames only, and the session's fits as well")
        for of, what, m, s in known if s > _SURE and abs(m) < _CLEAR * s
    ]  # fmt: skip


def _doubts(names: tuple[str, ...], estimates: list[Any]) -> tuple[_Doubt, ...]:
    out = list[_Doubt]()
    lost = np.mean([e.lost for e in estimates])
    if lost > _LOST:
        out.append((None, f"the body was lost in {100 * lost:.0f} % of the frames"))
    for c, name in enumerate(names):
        without = np.mean([c in e.left_out for e in estimates])
        if without > _LOST:
            out.append((name, f"{name} contradicts the others in {100 * without:.0f} % of the frames"))
    return tuple(out)


def _keypoint_clock(session: Any, recording: Any, poses: tuple[Any, ...], lags: Any) -> KeypointClock | None:
    """The clock of the session's keypoints, None without enough of them; `lags` (C, F) of the images, in frames."""
    from twistcap.adjust.clocks import keypoint_clock
    from twistcap.io.recording import keypoints_of
    from twistcap.solve.blocks import PoseTrack

    table, views = session.first_pose.keypoints, recording.views
    if table is None:
        return None
    files = min((len(list(Path(folder).glob("*.json"))) for folder in table.folders.values()), default=0)
    numbers = [k for k in views.indices if k < files]
    if len(numbers) < 24:
        return None
    keypoints = keypoints_of(table.model_copy(update={"frames": tuple(numbers)}), recording.rig, views, first=False)
    track = PoseTrack(poses[: len(numbers)], np.arange(len(numbers), dtype=float))
    return keypoint_clock(recording.body, recording.rig, track, keypoints, lags[:, : len(numbers)])


def tell(document: dict[str, Any]) -> None:
    """The end of a run, for a person."""
    rows = [
        [r["camera"], f"{r['before_s']:.4f}", f"{r['after_s']:.4f}", f"{r['moved_frames']:+.2f}",
         f"{r['sigma_frames']:.3f}"]
        for r in document["cameras"]
    ]  # fmt: skip
    columns = ["camera", "before, s", "found, s", "frames", "± (1σ), frames"]
    terminal.show_table("clocks: offset of each camera", columns, rows, ["camera"])
    if "keypoints" in document:
        k = document["keypoints"]
        words.print(f"keypoints: offset {k['before']:g} before, {k['after']:g} ± {k['sigma']:.2f} frames found")
    if document["frames"]:
        words.print(f"frames = [{document['frames'][0]}, {document['frames'][1]}]: all cameras have these")
    for doubt in document["unsure"]:
        terminal.say(f"Not sure: {doubt}.")
    stay = [r["camera"] for r in document["cameras"] if not r["sure"]]
    if stay:
        take = f"to take what was found, write it as offset in [clocks.{stay[0]}]"
        terminal.say(f"The clocks stay of {', '.join(stay)}; {take}.")
    terminal.say(f"{'written into' if document['written'] else 'not written into'} {document['session']}")
