"""``twistcap prior``: pose priors, learned from motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twistcap.commands import terminal
from twistcap.errors import InputError

prior = typer.Typer(name="prior", help="Learn a pose prior from motion.", no_args_is_help=True)


@prior.callback()
def _group() -> None:  # with one command alone typer would leave out its name
    """Learn a pose prior from motion."""


@prior.command()
def train(
    out: Annotated[Path, typer.Argument(help="Prior to write, .npz.", metavar="OUT")],
    files: Annotated[list[Path], typer.Argument(help="Motions: .mot, .sto, result.h5, .npz.", metavar="FILE...")],
    every: Annotated[int, typer.Option(min=1, help="Take every n-th frame.")] = 1,
    sigma_deg: Annotated[float | None, typer.Option(help="Kernel width, degrees. Default: the paper's rule.")] = None,
    coordinates: terminal.Coordinates = None,
    scale: Annotated[
        list[str] | None, typer.Option(metavar="NAME=FACTOR", help="Divide a coordinate's differences by a factor.")
    ] = None,
    json: terminal.Json = False,
) -> None:
    """Train a pose prior on motions of any person. A session names it in `[prior] path`.

    The kernel width is the largest distance of a sample from its nearest neighbour, so one unusual pose makes it wide.
    If it is far above the median distance, remove that pose or give --sigma-deg.

    Examples:

      twistcap prior train walking.npz walk1.mot walk2.mot

      twistcap prior train legs.npz out/result.h5 --every 2 --coordinates hip_flexion_r,knee_angle_r
    """
    import numpy as np

    from twistcap.io.prior_file import trained_prior, write_prior

    terminal.output_file(out, "OUT", ".npz", files)
    names = terminal.names_in(coordinates)
    sigma = None if sigma_deg is None else float(np.radians(sigma_deg))
    made = trained_prior(files, every, names, sigma, _factors(scale or []))
    width, median = (float(np.degrees(angle)) for angle in (made.sigma, made.median_distance))
    document = {"id": "prior", "prior": write_prior(out, made), "samples": len(made.samples)}
    document |= {"sigma_deg": width, "median_distance_deg": median, "coordinates": list(made.names)}
    if json:
        terminal.emit(document)
        return
    spread = f"sigma {width:.2f} deg (median neighbour {median:.2f} deg)"
    terminal.words.print(f"{len(made.samples)} samples of {len(made.names)} coordinates, {spread}")
    terminal.words.print(", ".join(made.names))
    typer.echo(out)


def _factors(texts: list[str]) -> dict[str, float]:
    out: dict[str, float] = {}
    for text in texts:
        name, _, factor = text.partition("=")
        try:
            out[name.strip()] = float(factor)
        except ValueError:
            raise InputError(f"--scale is {text!r}; write NAME=FACTOR, such as pro_sup_r=2.") from None
    return out
