"""``twistcap reproduce`` and ``twistcap bench``: the figures we claim, measured again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError

if TYPE_CHECKING:
    from twistcap.evaluate.experiments import Experiment

Case = Annotated[str | None, typer.Argument(help="Table or case to run; all by default.", metavar="[CASE]")]
Seeds = Annotated[str, typer.Option(help="FIRST-LAST or a list such as 0,3,5.")]
Quick = Annotated[bool, typer.Option("--quick", help="Fewer cases and seeds, under a minute.")]


def reproduce(
    case: Case = None,
    seeds: Seeds = "0-7",
    quick: Quick = False,
    names: Annotated[bool, typer.Option("--list", help="Say what there is to run, and stop.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the pictures of an experiment.")] = None,
    json: terminal.Json = False,
) -> None:
    """Run the accuracy tables and the papers' experiments again, on the studio's seeds.

    Examples:

      twistcap reproduce --list

      twistcap reproduce studio --quick

      twistcap reproduce studio --seeds 0-7 --json

      twistcap reproduce C-3 --out out/C-3
    """
    from twistcap.evaluate import reproduce as table
    from twistcap.evaluate.experiments import EXPERIMENTS

    if names:
        _print_list(table.listed(), json)
        return
    for experiment in (e for e in EXPERIMENTS if e.id == case):
        _experiment(experiment, parsed_seeds(seeds)[: 2 if quick else None], out, json)
        return
    if out is not None:
        raise InputError("--out: only an experiment (C-1, C-2, …) draws a picture; leave it out.")
    with terminal.telling("reproduce") as told:
        found = table.run(case, parsed_seeds(seeds), quick, told)
    _print(found, json)


def _experiment(experiment: Experiment, seeds: tuple[int, ...], out: Path | None, json: bool) -> None:
    from twistcap.report.experiment import experiment_picture, seed_picture

    folder = None if out is None else terminal.output_folder(out)
    with terminal.telling("reproduce") as told:
        findings = experiment.run(seeds, told, folder)
    if folder is not None and findings.quantity:
        experiment_picture(folder / f"{experiment.id}.png", experiment, findings)
        for seed in dict.fromkeys(trace.seed for trace in findings.traces):
            seed_picture(folder / f"{experiment.id}-seed-{seed}.png", experiment, findings, seed)
    _print({"id": experiment.id, "rows": findings.rows}, json)
    if folder is not None and not json:
        typer.echo(str(folder))


def bench(case: Case = None, seeds: Seeds = "0", quick: Quick = False, json: terminal.Json = False) -> None:
    """Measure milliseconds per frame by stage, for stereo and four views and both methods.

    Examples:

      twistcap bench

      twistcap bench --quick --json
    """
    from twistcap.evaluate import bench as table

    with terminal.telling("bench") as told:
        found = table.run(case, parsed_seeds(seeds), quick, told)
    _print(found, json)


def parsed_seeds(text: str) -> tuple[int, ...]:
    """``0-7`` or ``0,3,5`` as numbers.

    Raises:
        InputError: where it reads otherwise.
    """
    first, dash, last = text.partition("-")
    if dash and first.isdigit() and last.isdigit():
        return tuple(range(int(first), int(last) + 1))
    parts = text.split(",")
    if not all(part.strip().isdigit() for part in parts):
        raise InputError(f"--seeds is {text!r}; write FIRST-LAST or a list such as 0,3,5.")
    return tuple(int(part) for part in parts)


def _print_list(cases: list[dict[str, str]], json: bool) -> None:
    if json:
        terminal.emit({"id": "cases", "cases": cases})
        return
    width = max(len(item["id"]) for item in cases)
    for item in cases:
        typer.echo(f"{item['id']:{width}}  {item['says']}")


def _print(table: Any, json: bool) -> None:
    if json:
        terminal.emit(table)
    else:
        terminal.show_rows(table["id"], table["rows"])
