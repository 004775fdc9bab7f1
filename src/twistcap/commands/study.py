"""``twistcap study``: many subjects and trials, on this machine or on a Dask cluster, into one table."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words

if TYPE_CHECKING:
    from concurrent.futures import Future

    from twistcap.commands.study_engine import Engine
    from twistcap.commands.study_jobs import Outcome
    from twistcap.io.study import Study, Trial

_SHOWN = 10  # failed trials that are listed


def study(
    study: Annotated[Path, typer.Argument(help="Study TOML, see docs/formats/study.md.", metavar="STUDY")],
    out: Annotated[Path | None, typer.Option(help="Folder for everything that is written.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Trials at a time here. Default: one a core.")] = None,
    cluster: Annotated[str | None, typer.Option(help="Run on this Dask scheduler (tcp://HOST:8786), not here.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Do all steps once more.")] = False,
    json: terminal.Json = False,
) -> None:
    """Fit a body for each subject, track, refine and export all trials, and write one table of all angles.

    The same command goes on where it was stopped. A trial that fails is listed, and the others go on; the exit code is
    then 1. Writes trials.csv, angles.csv, angles.parquet (extra twistcap[study]) and SUBJECT/TRIAL/….

    Examples:

      twistcap study gait.toml --out out/gait

      twistcap study gait.toml --out out/gait --workers 4

      twistcap study gait.toml --out out/gait --cluster tcp://10.0.0.5:8786
    """
    from twistcap.io.study import load_study

    loaded = load_study(study)
    folder = terminal.output_folder(out or loaded.about.output.folder or Path("out") / study.stem).resolve()
    document = run_study(loaded, folder, workers or os.cpu_count() or 1, cluster, overwrite)
    terminal.finish(document, json, _show)
    raise typer.Exit(1 if document["failed"] else 0)


def run_study(
    study: Study, folder: Path, workers: int = 1, cluster: str | None = None, overwrite: bool = False
) -> dict[str, Any]:
    """Run a study into a folder; what ``--json`` prints."""
    from twistcap.commands.study_engine import here, on_cluster
    from twistcap.io.lock import WriteLock

    terminal.tell_compiling()
    with WriteLock(folder / "trials.csv"):
        if overwrite:
            _forget(study, folder)
        outcomes: dict[Any, Outcome] = {}
        try:
            with here(workers) if cluster is None else on_cluster(cluster) as engine:
                outcomes.update(_outcomes(study, folder, engine))
        except KeyboardInterrupt:
            _list(study, folder, outcomes)
            raise
        return _tables(study, folder, outcomes)


def _forget(study: Study, folder: Path) -> None:
    from twistcap.commands.study_jobs import forget
    from twistcap.io.study import BODY

    for subject in study.subjects:
        forget(folder / subject / BODY)
    for trial in study.trials:
        forget(trial.folder(folder))


def _outcomes(study: Study, folder: Path, engine: Engine) -> Iterator[tuple[Trial | str, Outcome]]:
    """What came of each trial, and of the body of each subject, as they end; a subject's trials wait for its body."""
    from twistcap.commands.study_jobs import Outcome, fit_subject, run_trial

    jobs = Jobs(engine)
    with terminal.progress("trials", len(study.trials)) as advance:
        for subject, trials in study.subjects.items():
            if study.about.body.fit:
                jobs.begin(subject, fit_subject, trials, study.about, folder)
            else:
                jobs.begin_all(trials, run_trial, study.about, folder)
        for key, outcome in jobs.ended():
            yield key, outcome
            if not isinstance(key, str):
                _tell(key.name, outcome, advance)
                continue
            trials = study.subjects[key]
            if not outcome.message:
                jobs.begin_all(trials, run_trial, study.about, folder)
                continue
            for trial in trials:
                failed = Outcome(f"the body of {key} could not be fitted: {outcome.message}")
                yield trial, failed
                _tell(trial.name, failed, advance)


class Jobs:
    """Jobs that an engine runs, and what came of them in the order in which they end."""

    def __init__(self, engine: Engine) -> None:
        self._engine, self._ended = engine, SimpleQueue[Any]()
        self._running: dict[Future[Outcome], Trial | str] = {}

    def begin(self, key: Trial | str, job: Callable[..., Outcome], *arguments: Any) -> None:
        future = self._engine.submit(job, *arguments)
        self._running[future] = key
        future.add_done_callback(self._ended.put)

    def begin_all(self, trials: tuple[Trial, ...], job: Callable[..., Outcome], *arguments: Any) -> None:
        for trial in trials:
            self.begin(trial, job, trial, *arguments)

    def ended(self) -> Iterator[tuple[Trial | str, Outcome]]:
        """Until nothing runs, what is begun meanwhile among it."""
        from twistcap.commands.study_jobs import Outcome

        while self._running:
            future = self._ended.get()
            key, error = self._running.pop(future), future.exception()
            yield key, future.result() if error is None else Outcome(f"{type(error).__name__}: {error}")


def _tell(name: str, outcome: Outcome, advance: terminal.Advance) -> None:
    if outcome.message:
        terminal.say(f"{name} failed: {outcome.message}")
    if outcome.note:
        terminal.say(f"{name}: {outcome.note}")
    advance(name)


def _tables(study: Study, folder: Path, outcomes: dict[Any, Outcome]) -> dict[str, Any]:
    """The list of trials and the table of all that are done, in the order of the study."""
    from twistcap.commands.study_jobs import rows_of
    from twistcap.io import tidy

    done = [trial for trial in study.trials if not outcomes[trial].message]
    head = tidy.FRAME if study.about.output.over == "frame" else tidy.CYCLE
    files = [folder / "trials.csv", folder / "angles.csv"]
    with terminal.status("writing the tables"):
        _list(study, folder, outcomes)
        tidy.join(files[1], head, (rows_of(trial, folder) for trial in done))
        if find_spec("pyarrow") is not None:
            files.append(tidy.to_parquet(files[1]))
        else:
            words.print("angles.parquet is not written: pip install 'twistcap[study]' brings what it needs.")
    seconds = Counter[str]()
    for outcome in outcomes.values():
        seconds.update(outcome.seconds)
    failed = {trial.name: outcomes[trial].message for trial in study.trials if outcomes[trial].message}
    about = {"id": "study", "trials": len(study.trials), "done": len(done), "failed": failed}
    return about | {"seconds": dict(seconds), "files": files}


def _list(study: Study, folder: Path, outcomes: dict[Any, Outcome]) -> None:
    """``trials.csv``: what came of each trial so far."""
    from twistcap.io import tidy

    head = "subject", "trial", "status", "frames", "lost", "message"
    tidy.write_rows(folder / "trials.csv", head, _lines(study, outcomes))


def _lines(study: Study, outcomes: dict[Any, Outcome]) -> Iterator[tuple[Any, ...]]:
    from twistcap.commands.study_jobs import INTERRUPTED, Outcome

    for trial in study.trials:
        outcome = outcomes.get(trial, Outcome(INTERRUPTED))
        status = "open" if outcome.message == INTERRUPTED else "failed" if outcome.message else "done"
        yield trial.subject, trial.trial, status, outcome.frames, outcome.lost, outcome.message or outcome.note


def _show(document: dict[str, Any]) -> None:
    spent = ", ".join(f"{step} {seconds:.0f} s" for step, seconds in document["seconds"].items())
    words.print(f"{document['done']} of {document['trials']} trials are done. {spent}")
    failed = list(document["failed"].items())
    for name, message in failed[:_SHOWN]:
        terminal.say(f"failed: {name}: {message}")
    if len(failed) > _SHOWN:
        words.print(f"and {len(failed) - _SHOWN} more, see trials.csv")
    for path in document["files"]:
        typer.echo(path)
