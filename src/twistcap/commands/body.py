"""``twistcap body``: bodies of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import words

body = typer.Typer(name="body", help="Make a body of the person who is tracked.", no_args_is_help=True)


@body.callback()
def common() -> None:
    """Make a body of the person who is tracked."""


@body.command()
def keyviews(
    views: Annotated[Path, typer.Argument(help="The key views.", metavar="KEYVIEWS.toml")],
    out: Annotated[Path, typer.Option(help="Folder for everything that is written.")] = Path("body"),
) -> None:
    """Build a rigged body from four calibrated key views: front, side, from above, and elbows bent.

    Writes body.glb, which a session takes ([body] kind = "glb"), and steps.png, which shows every step.

    Examples:

      twistcap body keyviews anna.toml --out anna
    """
    from twistcap.body.gltf import save_glb
    from twistcap.io.keyviews import read_key_views
    from twistcap.keyviews.build import build
    from twistcap.keyviews.measure import measure
    from twistcap.report.keyviews import draw_silhouettes, draw_steps

    found, line = read_key_views(views)
    folder = terminal.output_folder(out)
    page = draw_silhouettes(found, folder / "steps.png")  # what there is to see if a later step fails
    acquired = build(measure(found, line))
    page = draw_steps(found, acquired, folder / "steps.png")
    save_glb(acquired.body, folder / "body.glb")
    words.print(f"stature {acquired.measured.stature:.3f} m; wrote {folder / 'body.glb'}; look at {page}")
