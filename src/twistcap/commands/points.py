"""Measured points that are clicked in the browser, for ``twistcap calibrate --click``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from twistcap.commands import terminal
from twistcap.commands.view import serve
from twistcap.errors import InputError

if TYPE_CHECKING:
    from twistcap.pages.pointing import Pointing


def clicked(points: Path, scene: Mapping[str, Any], alone: Mapping[str, Any], port: int) -> Path:
    """Let points be clicked in a picture of each camera; the file with the clicks. Ends the command, with a sentence,
    where the page is left without Calibrate. Raises InputError for what cannot be clicked.
    """
    from twistcap.pages.assemble import page

    pointing = pointing_of(points, scene, alone)
    terminal.say(f"Save writes {pointing.target}.")
    serve(page("points", f"Points of {points.name}", pointing.document()), pointing.answers, port, pointing.done)
    if pointing.done.is_set():
        return pointing.target
    kept = f"the clicks are in {pointing.target}; the same command goes on with them"
    terminal.say(f"Not calibrated: {kept if pointing.saved else 'nothing was saved'}.")
    raise typer.Exit


def pointing_of(points: Path, scene: Mapping[str, Any], alone: Mapping[str, Any]) -> Pointing:
    """What the page serves: the middle picture of each camera's recording of the scene. Raises InputError."""
    from twistcap.pages.pointing import Pointing, clicked_beside, read_table

    table = read_table(points)
    if set(scene) != set(alone):
        names = " and ".join(", ".join(sorted(each)) for each in (scene, alone))
        raise InputError(f"--click and --lens-of must name the same cameras, not {names}; write CAMERA=PATH.")
    for name, source in scene.items():
        if source.size != alone[name].size:
            sizes = " and ".join(f"{w}×{h}" for w, h in (source.size, alone[name].size))
            raise InputError(f"camera {name}: its scene and its lens pictures differ in size ({sizes} pixels).")
    images = {name: next(iter(scene[name].read([len(scene[name]) // 2]))) for name in alone}
    return Pointing(table, images, clicked_beside(points))
