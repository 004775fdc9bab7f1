"""``python -m reproduce ID``: the figures we claim, measured again; bad input ends with one sentence, exit code 2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from reproduce import catalogue
from twistcap.commands import terminal
from twistcap.errors import InputError

app = typer.Typer(
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def reproduce(
    name: Annotated[str | None, typer.Argument(help="Table, line, experiment or timing to run.", metavar="ID")] = None,
    seeds: Annotated[
        str | None,
        typer.Option(help="FIRST-LAST or a list such as 0,3,5.  [default: 0-7; 0 for timings, 0-54 for faults]"),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer cases, frames and seeds.")] = False,
    names: Annotated[bool, typer.Option("--list", help="Say what there is to run, and stop.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the pictures of an experiment.")] = None,
    json: terminal.Json = False,
) -> None:
    """Run our accuracy tables, the papers' experiments and the timings again, on scenes of the studio.

    Examples:

      python -m reproduce --list

      python -m reproduce studio --quick

      python -m reproduce C-3 --seeds 40-43 --out out/C-3 --json

      python -m reproduce bench --seeds 0-3
    """
    if names:
        _print_list(json)
        return
    if name is None:
        raise InputError("name what to run, such as studio or C-3; --list says what there is.")
    catalogue.check(name, pictures=out is not None)
    chosen = parsed_seeds(catalogue.default_seeds(name) if seeds is None else seeds)
    folder = None if out is None else terminal.output_folder(out)
    with terminal.status("reproduce") as tell:
        table = catalogue.run(name, chosen, quick, tell, folder)
    if json:
        terminal.emit(table)
        return
    if "text" in table:
        typer.echo(table["text"])
    else:
        terminal.show_rows(table["id"], table["rows"])
    if folder is not None:
        typer.echo(str(folder))


def parsed_seeds(text: str) -> tuple[int, ...]:
    """``0-7`` or ``0,3,5`` as numbers, each once.

    Raises:
        InputError: where it reads otherwise, or names none.
    """
    first, dash, last = text.partition("-")
    if dash and first.isdecimal() and last.isdecimal() and int(first) <= int(last):
        return tuple(range(int(first), int(last) + 1))
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise InputError(f"--seeds is {text!r}; write FIRST-LAST or a list such as 0,3,5.")
    return tuple(dict.fromkeys(int(part) for part in parts))


def _print_list(json: bool) -> None:
    entries = catalogue.listed()
    if json:
        terminal.emit({"id": "cases", "cases": entries})
        return
    width = max(len(entry["id"]) for entry in entries)
    for entry in entries:
        typer.echo(f"{entry['id']:{width}}  {entry['says']}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point; `arguments` default to the process's own."""
    terminal.run_command(app, "reproduce", arguments, "python -m reproduce")


if __name__ == "__main__":
    main()
