"""The command line: ``twistcap COMMAND``. Bad input ends with one sentence on stderr and exit code 2."""

from __future__ import annotations

import os
from collections.abc import Sequence

import typer

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads cost small systems more than they save

from twistcap.commands.board import board
from twistcap.commands.body import body
from twistcap.commands.calibrate import calibrate
from twistcap.commands.convert import convert
from twistcap.commands.demo import demo
from twistcap.commands.evaluate import evaluate
from twistcap.commands.export import export
from twistcap.commands.gait import gait
from twistcap.commands.init import init
from twistcap.commands.motions import motions
from twistcap.commands.new import new
from twistcap.commands.prior import prior
from twistcap.commands.refine import refine
from twistcap.commands.session import session
from twistcap.commands.studio import studio
from twistcap.commands.study import study
from twistcap.commands.sync import sync
from twistcap.commands.terminal import run_command
from twistcap.commands.track import track
from twistcap.commands.view import view

app = typer.Typer(
    name="twistcap",
    help="Markerless motion capture with a body model: calibrated video in, joint angles out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
_COMMANDS = (
    demo, board, calibrate, convert, new, session, sync, init, track, refine, study, view, studio, evaluate, gait,
    export,
)  # fmt: skip
for command in _COMMANDS:
    app.command()(command)
app.add_typer(body)
app.add_typer(prior)
app.add_typer(motions)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"twistcap {version('twistcap')}")
        raise typer.Exit


@app.callback()
def common(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Markerless motion capture with a body model: calibrated video in, joint angles out.

    Begin with `twistcap demo`.
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point; `arguments` default to the process's own."""
    run_command(app, "twistcap", arguments)


if __name__ == "__main__":
    main()
