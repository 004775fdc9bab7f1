"""The accuracy tables, measured again on the studio's seeds: ``python -m reproduce studio``, `prior` or `harder`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace

import numpy as np

from reproduce.cases import STUDIO, SUITES, UNITS, Agreement, Bar, Case, Suite
from reproduce.running import Table, Tell, one_thread_processes
from reproduce.sequence import Outcome, run_scene
from twistcap.errors import InputError
from twistcap.evaluate.metrics import Row, row
from twistcap.studio import StudioConfig

QUICK_FRAMES = 12
QUICK = ("4-views-exact-direct", "4-views-exact-levelset", "stereo-exact", "first-pose", "direct-levelset-exact")
WORKERS = 2

Line = Case | Agreement
"""A line of a table."""

Outcomes = Mapping[str, Sequence[Outcome]]
"""One outcome per seed, by case."""


@dataclass(frozen=True)
class _Job:
    """Cases that look at the same scene of one seed; one process takes them together."""

    studio: StudioConfig
    seed: int
    cases: tuple[Case, ...]


def run(name: str, seeds: Sequence[int], quick: bool, progress: Tell, workers: int = WORKERS) -> Table:
    """Run a table, or one case of it.

    Args:
        name: id of a suite or of one of its lines.
        seeds: of the studio, not empty.
        quick: twelve frames and fewer cases.
        progress: is called each time a scene is done.
        workers: processes, each of one thread.

    Returns:
        the table; "seeds" of a row holds its value on every seed, in the order given.

    Raises:
        InputError: for a name that no suite and no line has.
    """
    suite = shortened(selected(name)) if quick else selected(name)
    return {"id": suite.id, "rows": rows_of(suite, outcomes_of(suite.cases, seeds, progress, workers))}


def selected(name: str) -> Suite:
    """The suite of a name, or what of it is needed for one line.

    Raises:
        InputError: for a name that nothing has.
    """
    for suite in SUITES:
        if name == suite.id:
            return suite
        for agreement in (a for a in suite.agreements if a.id == name):
            cases = tuple(c for c in suite.cases if c.id in (agreement.first, agreement.second))
            return Suite(agreement.id, agreement.says, cases, (agreement,))
        for case in (c for c in suite.cases if c.id == name):
            return Suite(case.id, case.says, (case,))
    raise InputError(f"there is no table and no line {name!r}; choose one of {', '.join(s.id for s in SUITES)}.")


def shortened(suite: Suite) -> Suite:
    """The suite with its first frames only; of the studio's table the quickest cases."""
    fewer = suite is STUDIO
    cases = [c for c in suite.cases if not fewer or c.id in QUICK]
    few = tuple(replace(c, frames=min(c.frames or QUICK_FRAMES, QUICK_FRAMES)) for c in cases)
    return replace(suite, cases=few, agreements=tuple(a for a in suite.agreements if not fewer or a.id in QUICK))


def outcomes_of(cases: Sequence[Case], seeds: Sequence[int], progress: Tell, workers: int = WORKERS) -> Outcomes:
    """Run every case on every seed, scenes in parallel; the numbers do not depend on the number of workers."""
    scenes = dict.fromkeys(case.studio for case in cases)
    jobs = [_Job(scene, seed, tuple(c for c in cases if c.studio == scene)) for seed in seeds for scene in scenes]
    found: dict[tuple[str, int], Outcome] = {}
    with one_thread_processes(min(workers, len(jobs))) as pool:
        waiting = {pool.submit(run_scene, job.studio, job.seed, job.cases): job for job in jobs}
        for done, future in enumerate(as_completed(waiting), 1):
            job = waiting[future]
            found.update(((c.id, job.seed), o) for c, o in zip(job.cases, future.result(), strict=True))
            progress(f"seed {job.seed}, {job.studio.views} views", done, len(jobs))
    return {case.id: [found[case.id, seed] for seed in seeds] for case in cases}


def rows_of(suite: Suite, outcomes: Outcomes) -> list[Row]:
    """The table's lines: every bar of every case, then the agreements."""
    rows = [_row(case, bar, outcomes[case.id]) for case in suite.cases for bar in case.bars]
    for agreement in suite.agreements:
        rows += _agreement_rows(agreement, outcomes[agreement.first], outcomes[agreement.second])
    return rows


def _row(case: Case, bar: Bar, outcomes: Sequence[Outcome]) -> Row:
    values = [outcome.values[bar.measure] for outcome in outcomes]
    value = {"mean": np.mean, "worst": np.max, "sum": np.sum}[bar.over](values)
    metric = bar.measure + (", worst seed" if bar.over == "worst" else "")
    lost = sum(outcome.lost for outcome in outcomes)
    return row(case.id, metric, float(value), UNITS[bar.measure], at_most=bar.at_most, seeds=values, lost=lost)


def _agreement_rows(agreement: Agreement, first: Sequence[Outcome], second: Sequence[Outcome]) -> list[Row]:
    """Difference of the two errors, seed by seed, and of the angles themselves."""
    pairs = list(zip(first, second, strict=True))
    errors = [abs(a.values["KHE"] - b.values["KHE"]) for a, b in pairs]
    angles = [float(np.mean(np.abs(a.angles_deg - b.angles_deg))) for a, b in pairs]
    lost, name = sum(a.lost or b.lost for a, b in pairs), agreement.id
    return [
        row(
            name, "difference of KHE", float(np.mean(errors)), "deg", at_most=agreement.at_most, seeds=errors, lost=lost
        ),
        row(name, "difference of the angles", float(np.mean(angles)), "deg", seeds=angles, lost=lost),
    ]
