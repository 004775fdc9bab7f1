"""The two jobs of a study: the body of a subject, and a trial. A finished step is marked, and not done again."""

from __future__ import annotations

import hashlib
import json
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.commands import terminal
from twistcap.commands.bodyfit import fit_sessions
from twistcap.commands.gait_files import Wishes, run_gait
from twistcap.commands.refine import run_refine, write_again
from twistcap.commands.track import Begin, run_session
from twistcap.doors.text import read_json_table
from twistcap.errors import InputError
from twistcap.evaluate.filters import Filter
from twistcap.io import tidy
from twistcap.io.coordinates import coordinates_of
from twistcap.io.files import write_lines
from twistcap.io.result import Result, read_result
from twistcap.io.session import Session
from twistcap.io.session_tables import GlbBody
from twistcap.io.start_report import other_frame_in_words
from twistcap.io.study import BODY, StudyFile, StudyOutput, Trial

INTERRUPTED = "interrupted; the same command goes on"
STEPS = ("fit", "track", "refine", "files", "rows")


@dataclass(frozen=True)
class Outcome:
    """What came of a job; `message` says why it failed, `note` what is to be said of one that did not."""

    message: str = ""
    frames: int = 0
    lost: int = 0
    seconds: Mapping[str, float] = field(default_factory=dict[str, float])  # by step, of those that ran
    note: str = ""


class Steps:
    """The steps of a job in one folder, each made from the one before."""

    def __init__(self, folder: Path, *made_from: Any) -> None:
        self.folder, self.seconds = folder, dict[str, float]()
        self._digest = _digest(made_from)

    def once(self, name: str, makes: Path, work: Callable[[bool], Any], *made_from: Any) -> Any:
        """What the work gives (as JSON), now or when it was done before from the same.

        It is called with whether it has been begun from the same, and is marked as begun before, as finished after.
        A mark is written beside and then renamed: a kill leaves the one before.
        """
        self._digest = _digest([self._digest, *made_from])
        path, mark = _mark(self.folder, name), dict[str, Any]()
        with suppress(InputError):  # there is none, or the machine went down while it was written
            mark = read_json_table(path)
        begun = mark.get("made_from") == self._digest
        if begun and "gave" in mark and makes.is_file():
            return mark["gave"]
        write_lines(path, [json.dumps({"made_from": self._digest})])
        start = time.perf_counter()
        gave = work(begun)
        self.seconds[name] = time.perf_counter() - start
        write_lines(path, [json.dumps({"made_from": self._digest, "gave": gave})])
        return gave


def forget(folder: Path) -> None:
    """Let the steps in a folder be done once more."""
    for name in STEPS:
        _mark(folder, name).unlink(missing_ok=True)


def rows_of(trial: Trial, study: Path) -> Path:
    """The rows of a trial."""
    return trial.folder(study) / "rows.csv"


def _mark(folder: Path, step: str) -> Path:
    return folder / f".{step}.json"


def _digest(values: Any) -> str:
    return hashlib.blake2b(json.dumps(values, sort_keys=True).encode(), digest_size=16).hexdigest()


def fit_subject(trials: Sequence[Trial], about: StudyFile, study: Path) -> Outcome:
    """Fit the body of a subject to its first trials, into a folder of its own. Nothing is raised: see `Outcome`."""

    def work(folder: Path) -> Outcome:
        sessions = [trial.read(about.session) for trial in trials[: about.body.trials]]
        steps = Steps(folder, [_plain(session) for session in sessions], about.body.frames)

        def fit(_: bool) -> None:
            fit_sessions(sessions, trials[0].session, folder, about.body.frames)

        steps.once("fit", folder / "body.glb", fit)
        return Outcome(seconds=steps.seconds)

    return _reported(study / trials[0].subject / BODY, work)


def run_trial(trial: Trial, about: StudyFile, study: Path) -> Outcome:
    """Track, refine and export one trial, and write its rows. Nothing is raised: see `Outcome`."""

    def work(folder: Path) -> Outcome:
        session, fitted = trial.read(about.session), ""
        if about.body.fit:
            body = study / trial.subject / BODY / "body.glb"
            session, fitted = _with_body(session, body), hashlib.blake2b(body.read_bytes()).hexdigest()
        session = session.model_copy(update={"output": about.output.model_copy(update={"folder": None})})
        steps = Steps(folder, _plain(session), fitted)
        result = _tracked(session, about, steps)
        rows = rows_of(trial, study)
        gave = steps.once("rows", rows, lambda _: _write_rows(rows, trial, read_result(result), about.output))
        return Outcome("", gave["frames"], gave["lost"], steps.seconds, other_frame_in_words(session))

    return _reported(trial.folder(study), work)


def _plain(session: Session) -> dict[str, Any]:
    """What a track is made of: what is written of it may change without tracking again."""
    return session.model_dump(mode="json", exclude={"output"})


def _with_body(session: Session, body: Path) -> Session:
    """The session with the fitted body, whose lengths and girths hold."""
    pose = session.first_pose.model_copy(update={"fit_lengths": False})
    fitted = GlbBody(kind="glb", path=str(body.resolve()))
    return session.model_copy(update={"body": fitted, "first_pose": pose, "fit_girths": None})


def _tracked(session: Session, about: StudyFile, steps: Steps) -> Path:
    """The result of a trial: tracked, and refined where that is wanted; the last of the two writes the exports."""
    result, refined = steps.folder / "result.h5", steps.folder / "refined" / "refined.h5"
    last, track = result, session
    if about.refine is not False:
        output = session.output.model_copy(update={"exports": (), "overlay": False})
        last, track = refined, session.model_copy(update={"output": output})
    made = {"track"} if last == result else {"track", "refine"}

    def follow(begun: bool) -> None:
        run_session(track, steps.folder, Begin(resume=begun, overwrite=not begun))

    def refine(_: bool) -> None:
        run_refine(result, refined.parent, session, about.refine if isinstance(about.refine, dict) else {})

    def write(_: bool) -> None:
        if steps.seconds.keys() >= made:  # just now, with their files
            return
        run_session(track, steps.folder, Begin(resume=True, videos_changed=True))
        if last == refined:
            write_again(refined, session)

    steps.once("track", result, follow)
    if last == refined:
        steps.once("refine", refined, refine, about.refine)
    steps.once("files", last, write, about.output.model_dump(mode="json"))
    return last


def _write_rows(path: Path, trial: Trial, result: Result, output: StudyOutput) -> dict[str, int]:
    if output.over == "frame":
        tidy.write_rows(path, tidy.FRAME, _frame_rows(trial, result, output))
    else:
        tidy.write_rows(path, tidy.CYCLE, _cycle_rows(trial, result, output, path.parent))
    return {"frames": len(result), "lost": int(np.sum(~result.known))}


def _frame_rows(trial: Trial, result: Result, output: StudyOutput) -> Iterator[tuple[Any, ...]]:
    shown = result.known | output.fill
    table = coordinates_of(result.body, result.poses, result.covariances, output.angles, output.axes, shown)
    values, sigmas = table.in_degrees
    values[~shown] = sigmas[~shown] = np.nan
    times = [repr(float(time)) for time in result.times]
    for n, flag in enumerate(tidy.flags(result)):
        at = trial.subject, trial.trial, int(result.indices[n]), times[n]
        for name, unit, cells in zip(table.names, table.units, tidy.cells(values[n], sigmas[n]), strict=True):
            yield (*at, name, unit, *cells, flag)


def _cycle_rows(trial: Trial, result: Result, output: StudyOutput, folder: Path) -> Iterator[tuple[Any, ...]]:
    """Of strides, in which all frames are known; the files of ``twistcap gait`` are written too."""
    from twistcap.evaluate.cycles import own_angles
    from twistcap.evaluate.gait import SIDES, cycles
    from twistcap.io.norms import PERCENT

    how = Filter(output.filter, output.cutoff)
    measured = run_gait(result, folder, Wishes(how, output.angles, output.gait_norms))
    found, walk = measured.gait, measured.walk
    if not found.strides:
        raise InputError('no stride is whole and in sight; film longer, or write over = "frame" in [output].')
    table = walk.table
    for side in SIDES:
        own = own_angles(table, side)
        curves, spreads = (cycles(found, result.times, columns[:, own], side) for columns in (walk.values, walk.sigmas))
        for stride, percent, c in np.ndindex(curves.shape):
            ((value, sigma),) = tidy.cells(curves[stride, percent, c : c + 1], spreads[stride, percent, c : c + 1])
            at = trial.subject, trial.trial, side, stride, f"{PERCENT[percent]:.0f}"
            yield (*at, table.names[own[c]], table.units[own[c]], value, sigma, "ok")


def _reported(folder: Path, work: Callable[[Path], Outcome]) -> Outcome:
    """Whatever goes wrong is the outcome; what nobody expects is kept in ``error.txt`` too."""
    trace = folder / "error.txt"
    try:
        terminal.output_folder(folder)
        trace.unlink(missing_ok=True)
        with _silent():
            return work(folder)
    except InputError as error:
        return Outcome(str(error))
    except Exception as error:
        if terminal.by_ctrl_c(error):
            return Outcome(INTERRUPTED)
        with suppress(InputError):
            write_lines(trace, traceback.format_exc().splitlines())
        return Outcome(f"{type(error).__name__}: {error}; see {trace}")


@contextmanager
def _silent() -> Generator[None]:
    """Bars and words of single trials are not shown: many run at once."""
    before, terminal.words.quiet = terminal.words.quiet, True
    try:
        yield
    finally:
        terminal.words.quiet = before
