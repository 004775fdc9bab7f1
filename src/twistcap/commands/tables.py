"""``twistcap reproduce`` and ``twistcap bench``: the figures we claim, measured again."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError

Case = Annotated[str | None, typer.Argument(help="Table or case to run; all by default.", metavar="[CASE]")]
Seeds = Annotated[str, typer.Option(help="FIRST-LAST or a list such as 0,3,5.")]
Quick = Annotated[bool, typer.Option("--quick", help="Fewer cases and seeds, under a minute.")]


def reproduce(
    case: Case = None,
    seeds: Seeds = "0-7",
    quick: Quick = False,
    names: Annotated[bool, typer.Option("--list", help="Say what there is to run, and stop.")] = False,
    json: terminal.Json = False,
) -> None:
    """Run the accuracy tables again, on the studio's seeds.

    Examples:

      twistcap reproduce --list

      twistcap reproduce studio --quick

      twistcap reproduce studio --seeds 0-7 --json
    """
    from twistcap.evaluate import reproduce as table

    if names:
        _print_list(table.listed(), json)
        return
    with terminal.telling("reproduce") as told:
        found = table.run(case, parsed_seeds(seeds), quick, told)
    _print(found, json)


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
