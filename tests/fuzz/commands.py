"""Damaged result files through the commands: view, export, evaluate, refine and track --resume."""

from __future__ import annotations

import contextlib
import io
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz.hunt import Fault, through
from tests.fuzz.targets import Target
from twistcap.cli import main
from twistcap.errors import InputError
from twistcap.io.synthetic import write_session
from twistcap.studio import StudioConfig, capture

FRAMES = 5
COMMANDS = ("view", "export", "evaluate", "refine", "resume")


def command(name: str, result: Path, walk: Path) -> list[str]:
    """The command line of one command on a damaged result."""
    folder, session = result.parent, str(walk / "session.toml")
    kind = random.Random(str(result)).choice(("trc", "mot", "bvh", "csv", "glb"))
    return {
        "view": ["view", str(result), "--save", str(folder / "page.html"), "--session", session, "--width", "64"],
        "export": ["export", str(result), "--to", kind],
        "evaluate": ["evaluate", str(result), "--reference", str(walk / "truth.npz"), "--json"],
        "refine": ["refine", str(result), "--session", session, "--set", "rounds=1", "--set", "points=20",
                   "--out", str(folder / "refined")],
        "resume": ["track", session, "--out", str(folder), "--resume", "--set", "output.overlay=false"],
    }[name]  # fmt: skip


def run(arguments: list[str]) -> Any:
    """A command line in this process; its one sentence as an InputError."""
    told = io.StringIO()
    with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
        try:
            main(arguments)
        except SystemExit as done:
            if done.code == 2:
                raise InputError(told.getvalue().strip().splitlines()[-1].removeprefix("twistcap: ")) from done
            if done.code:
                raise RuntimeError(f"exit code {done.code}") from done


def hunt_commands(count: int, seed: int, folder: Path, told: Callable[[str], None]) -> list[Fault]:
    """`count` damaged result files, each through one command after the other."""
    walk = folder / "walk"
    write_session(capture(StudioConfig(seed=1, views=3, size=(96, 72), frames=FRAMES)), walk, masks=False)
    run(["track", str(walk / "session.toml"), "--out", str(folder / "whole"), "--set", "output.overlay=false",
         "--frames", f"0:{FRAMES - 2}"])  # fmt: skip
    found: list[Fault] = []
    for name in COMMANDS:
        target = Target(folder / "whole" / "result.h5", lambda path, name=name: run(command(name, path, walk)))
        faults = through(f"command {name}", target, range(count), seed, folder)
        told(f"{name}: {count} files, {len(faults)} faults")
        found += faults
    return found
