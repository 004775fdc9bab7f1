"""Everything that ``python -m reproduce`` can run, by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

from reproduce import bench, tables
from reproduce.arms import Experiment
from reproduce.experiments import EXPERIMENTS, FAULTS
from reproduce.pictures import experiment_picture, seed_picture
from reproduce.running import Table, Tell
from twistcap.errors import InputError

QUICK_SEEDS = 2


class Entry(TypedDict):
    """A name and one line about it."""

    id: str
    says: str


def listed() -> list[Entry]:
    """All tables, their lines, the experiments and the timings."""
    timings = [Entry(id=bench.ID, says="milliseconds per frame by stage, one thread"), *map(_entry, bench.BENCHES)]
    suites = [Entry(id=suite.id, says=suite.says) for suite in tables.SUITES]
    lines = [_entry(line) for suite in tables.SUITES for line in (*suite.cases, *suite.agreements)]
    return [*suites, *lines, *map(_entry, EXPERIMENTS), *timings]


def _entry(line: tables.Line | Experiment | bench.Bench) -> Entry:
    return Entry(id=line.id, says=line.says)


def check(name: str, pictures: bool = False) -> None:
    """Refuse what cannot be run.

    Args:
        name: one of `listed`.
        pictures: whether pictures are asked for, which only experiments draw.

    Raises:
        InputError: for an unknown name, or pictures of what draws none.
    """
    names = [entry["id"] for entry in listed()]
    if name not in names:
        raise InputError(f"there is no case {name!r}; choose one of {', '.join(names)}.")
    if pictures and not any(experiment.id == name for experiment in EXPERIMENTS):
        raise InputError(f"--out: {name} draws no picture, only experiments (C-1, C-2, …) do; leave it out.")


def default_seeds(name: str) -> str:
    """The seeds where none are asked for."""
    return "0-54" if name == FAULTS.id else "0" if _is_timing(name) else "0-7"


def _is_timing(name: str) -> bool:
    return name == bench.ID or any(b.id == name for b in bench.BENCHES)


def run(name: str, seeds: Sequence[int], quick: bool, tell: Tell, out: Path | None = None) -> Table:
    """Measure a table, one of its lines, an experiment or a timing.

    Args:
        name: one of `listed`.
        seeds: of the studio, not empty.
        quick: two seeds, and for tables and timings few frames and cases.
        tell: is called with how far it is.
        out: folder for the pictures of an experiment.

    Raises:
        InputError: as `check`.
    """
    check(name, out is not None)
    if _is_timing(name):
        return bench.run(None if name == bench.ID else name, seeds, quick, tell)
    chosen = seeds[:QUICK_SEEDS] if quick else seeds
    for experiment in EXPERIMENTS:
        if experiment.id == name:
            return _run_experiment(experiment, chosen, tell, out)
    return tables.run(name, chosen, quick, tell)


def _run_experiment(experiment: Experiment, seeds: Sequence[int], tell: Tell, out: Path | None) -> Table:
    findings = experiment.run(seeds, tell, out)
    if out is not None and findings.quantity:
        experiment_picture(out / f"{experiment.id}.png", experiment, findings)
        for seed in dict.fromkeys(trace.seed for trace in findings.traces):
            seed_picture(out / f"{experiment.id}-seed-{seed}.png", experiment, findings, seed)
    table: Table = {"id": experiment.id, "rows": findings.rows}
    if findings.text:
        table["text"] = findings.text
    return table
