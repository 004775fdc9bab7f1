"""``twistcap motions``: libraries of training motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, cast

import typer

from twistcap.commands import terminal

motions = typer.Typer(name="motions", help="Build a library of training motion, for frames without images.",
                      no_args_is_help=True)  # fmt: skip


@motions.command()
def build(
    out: Annotated[Path, typer.Argument(help="Library to write, .npz.", metavar="OUT")],
    files: Annotated[list[Path], typer.Argument(help="Motion files of any person.", metavar="FILE...")],
    fps: Annotated[float, typer.Option(min=1, help="Frame rate of the recording that you will track.")] = 60.0,
    variant: Annotated[str, typer.Option(help="Built-in body whose coordinates are used: full or legs.")] = "full",
    mirrored: Annotated[bool, typer.Option("--mirrored", help="Add the mirror image of each motion.")] = False,
    coordinates: terminal.Coordinates = None,
    skeleton: Annotated[
        Path | None, typer.Option(help="ASF of all AMC files. Default: the one in the folder of each.", metavar="ASF")
    ] = None,
    json: terminal.Json = False,
) -> None:
    """Build a library of training motion, with one clip for each file. No match crosses the end of a clip.

    Examples:

      twistcap motions build walking.npz walk1.bvh walk2.amc --fps 60 --mirrored

      twistcap motions build walking.npz 08_02.amc 08_04.amc --skeleton 01.asf
    """
    from twistcap.body.humanoid import humanoid
    from twistcap.io.motion_library import write_library
    from twistcap.io.motions import read_motion
    from twistcap.motion import MotionLibrary

    terminal.output_file(out, "OUT", ".npz", files, skeleton)
    body = humanoid(cast(Literal["full", "legs"], variant))  # which checks it
    names = terminal.names_in(coordinates)
    skeletons = [skeleton if path.suffix.lower() == ".amc" else None for path in files]
    clips = [read_motion(path, body, skeleton=its, rate=fps) for path, its in zip(files, skeletons, strict=True)]
    library = MotionLibrary.of(clips, fps, names, mirrored)
    write_library(out, library)
    _tell(out, library, json)


@motions.command()
def show(
    path: Annotated[Path, typer.Argument(help="Library, as twistcap motions build writes it.", metavar="LIBRARY")],
    json: terminal.Json = False,
) -> None:
    """Show what a library contains.

    Examples:

      twistcap motions show walking.npz
    """
    from twistcap.io.motion_library import read_library

    _tell(path, read_library(path), json)


def _tell(path: Path, library: Any, json: bool) -> None:
    clips = [
        {"name": name, "poses": int(n), "seconds": round((int(n) - 1) / library.rate, 3)}
        for name, n in zip(library.clip_names, library.lengths, strict=True)
    ]
    if json:
        terminal.emit({"id": "motions", "library": path, "rate": library.rate, "poses": len(library), "clips": clips,
                       "coordinates": list(library.names)})  # fmt: skip
        return
    noun = "clip" if len(clips) == 1 else "clips"
    terminal.words.print(f"{len(library)} poses at {library.rate:g} per second in {len(clips)} {noun}")
    for clip in clips:
        terminal.words.print(f"  {clip['name']}: {clip['poses']} poses, {clip['seconds']:.2f} s")
    terminal.words.print(", ".join(library.names))
    typer.echo(path)
