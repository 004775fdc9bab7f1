"""`twistcap reproduce`: the accuracy tables, measured again on the studio's seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace

import numpy as np

from twistcap.errors import InputError
from twistcap.evaluate.cases import SUITES, UNITS, Agreement, Bar, Case, Suite
from twistcap.evaluate.experiments import EXPERIMENTS
from twistcap.evaluate.metrics import Row, row
from twistcap.evaluate.parallel import Table, Tell, one_thread_processes
from twistcap.evaluate.sequence import Outcome, run_scene
from twistcap.studio import StudioConfig

QUICK_FRAMES, QUICK_SEEDS = 12, 2
QUICK = ("4-views-exact-direct", "4-views-exact-levelset", "stereo-exact", "first-pose", "direct-levelset-exact")
WORKERS = 2

Outcomes = Mapping[str, Sequence[Outcome]]
"""One outcome per seed, by case."""


@dataclass(frozen=True)
class _Job:
    """Cases that look at the same scene of one seed; one process takes them together."""

    studio: StudioConfig
    seed: int
    cases: tuple[Case, ...]


def run(case: str | None, seeds: Sequence[int], quick: bool, progress: Tell, workers: int = WORKERS) -> Table:
    """Run a table, or one case of it.

    Args:
        case: id of a suite or of one of its lines (`listed`); everything by default.
        seeds: of the studio.
        quick: two seeds, twelve frames and fewer cases, under a minute.
        progress: is told each time a scene is done.
        workers: processes, each of one thread.

    Returns:
        the table; "seeds" of a row holds its value on every seed, in the order given.

    Raises:
        InputError: for a name that no suite and no case has, or no seeds.
    """
    if not seeds:
        raise InputError("reproduce: no seed was given; write --seeds 0-7.")
    suite = shortened(selected(case)) if quick else selected(case)
    seeds = tuple(seeds)[:QUICK_SEEDS] if quick else tuple(seeds)
    return {"id": suite.id, "rows": rows_of(suite, outcomes_of(suite.cases, seeds, progress, workers))}


def listed() -> list[dict[str, str]]:
    """Id and one line of every case."""
    tables = [item for suite in SUITES for item in (*suite.cases, *suite.agreements)]
    return [{"id": item.id, "says": item.says} for item in (*tables, *EXPERIMENTS)]


def selected(name: str | None) -> Suite:
    """The suite of a name, or what of it is needed for one line.

    Raises:
        InputError: for a name that nothing has.
    """
    for suite in SUITES:
        if name in (None, suite.id):
            return suite
        for agreement in (a for a in suite.agreements if a.id == name):
            cases = tuple(c for c in suite.cases if c.id in (agreement.first, agreement.second))
            return Suite(agreement.id, cases, (agreement,))
        for case in (c for c in suite.cases if c.id == name):
            return Suite(case.id, (case,))
    names = ", ".join([suite.id for suite in SUITES] + [item["id"] for item in listed()])
    raise InputError(f"reproduce: there is no case {name!r}; choose one of {names}.")


def shortened(suite: Suite) -> Suite:
    """The suite with its first frames only; a whole table keeps its quickest cases."""
    whole = any(suite is known for known in SUITES)
    cases = [c for c in suite.cases if not whole or c.id in QUICK]
    few = tuple(replace(c, frames=min(c.frames or QUICK_FRAMES, QUICK_FRAMES)) for c in cases)
    return replace(suite, cases=few, agreements=tuple(a for a in suite.agreements if not whole or a.id in QUICK))


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
