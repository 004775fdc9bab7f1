"""``twistcap studio``: a synthetic recording on disk, as a laboratory would have it, with the true motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from twistcap.commands import terminal
from twistcap.errors import check, check_choice


def studio(
    out: Annotated[Path, typer.Argument(help="Folder to write.", metavar="OUT")],
    seed: Annotated[int, typer.Option(min=0, help="Number that chooses person, room and walk.")] = 0,
    views: Annotated[int, typer.Option(min=1, max=8, help="Cameras on the ring.")] = 4,
    frames: Annotated[int, typer.Option(min=1, help="Number of frames.")] = 60,
    fps: Annotated[float, typer.Option(help="Frames per second.")] = 60.0,
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels.")] = "384x280",
    condition: Annotated[str, typer.Option(help="exact, or mismatch: body, cameras, first pose wrong.")] = "exact",
    hard: Annotated[bool, typer.Option("--hard", help="Person and room have nearly the same greys.")] = False,
    one_colour: Annotated[bool, typer.Option("--one-colour", help="Clothes, skin and hair in one colour.")] = False,
    grey: Annotated[bool, typer.Option("--grey", help="Grey images.")] = False,
    speed: Annotated[float, typer.Option(help="Factor on the speed of the walk.")] = 1.0,
    drop: Annotated[list[str] | None, typer.Option(help="FIRST:LAST frames without images.")] = None,
    noise: Annotated[float, typer.Option(min=0, max=1, help="Fraction of the pixels that become uniform noise.")] = 0.0,
    rectangles: Annotated[int, typer.Option(min=0, help="Number of random rectangles painted over each image.")] = 0,
    occluders: Annotated[int, typer.Option(min=0, help="Number of things in front of the person.")] = 0,
    blur: Annotated[int, typer.Option(min=1, help="Number of sub-frames for motion blur.")] = 1,
    json: terminal.Json = False,
) -> None:
    """Render a synthetic recording: videos, Calib.toml, body.glb, masks, truth, and a session.toml to track.

    Examples:

      twistcap studio /tmp/walk

      twistcap studio /tmp/hard --condition mismatch --hard --seed 3

      twistcap studio /tmp/gap --drop 20:24 && twistcap track /tmp/gap/session.toml
    """
    from twistcap.io.files import pasted
    from twistcap.io.synthetic import write_session
    from twistcap.studio import StudioConfig, capture
    from twistcap.studio.config import Condition

    check_choice("--condition", condition, ("exact", "mismatch"))
    for option, value in (("--fps", fps), ("--speed", speed)):
        check(option, 0 < value < float("inf"), f"it is {value:g}; give a number above 0")
    spans = [span for text in drop or [] if (span := terminal.frame_range(text, "--drop"))]
    for _, last in spans:
        check("--drop", last < frames, f"it ends at {last}, but the last frame is {frames - 1}")
    config = StudioConfig(
        seed=seed, views=views, size=terminal.image_size(size), frames=frames, fps=fps, hard=hard,
        condition=cast(Condition, condition), one_colour=one_colour, colour=not grey, speed_factor=speed,
        dropped=tuple(spans), uniform_noise=noise, rectangles=rectangles, occluders=occluders,
        motion_blur=blur,
    )  # fmt: skip
    terminal.output_folder(out)
    with terminal.progress("rendering", frames) as advance:
        session = write_session(capture(config), out, progress=lambda done, total: advance(""))
    if json:
        said = {"folder": out, "frames": frames, "views": views, "seed": seed}
        terminal.emit({"id": "studio", "session": session, **said})
    else:
        terminal.say(f"Now run: twistcap track {pasted(session)}")
