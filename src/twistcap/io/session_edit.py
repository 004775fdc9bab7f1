"""Clocks written into a session file; everything else in it, comments too, stays as it is."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

from twistcap.doors.text import read_text
from twistcap.errors import InputError
from twistcap.io.clocks import Clock
from twistcap.io.files import replacing
from twistcap.io.session import load_session

_HEADER = re.compile(r"^\s*\[+\s*([^\]]+?)\s*\]+")


def write_clocks(
    path: Path, clocks: Mapping[str, Clock], frames: tuple[int, int] | None = None, keypoints: float | None = None
) -> None:
    """Put ``[clocks]`` into a session file, in place of the one there.

    `frames` replaces the session's own ``frames = …``, or is put before its first table; `keypoints` is ``offset`` of
    [first_pose.keypoints]. Raises InputError, and leaves the file, where the result would not be a session with these
    values.
    """
    before = read_text(path)
    text = before
    if clocks:
        lines, had = _without(before.splitlines(), "clocks"), load_session(path).clocks
        tables = (_table(n, c, n not in had or Clock(**had[n].model_dump()) != c) for n, c in clocks.items())
        text = "\n".join(lines).rstrip() + "\n" + "".join(tables)
    if frames is not None:
        text = _with_frames(text, frames)
    if keypoints is not None:
        text = _with_offset(text, keypoints)
    trial = path.with_name(f".{path.name}.trial")
    try:
        trial.write_text(text, encoding="utf-8")
        session = load_session(trial)
        written = {name: Clock(**table.model_dump()) for name, table in session.clocks.items()}
        table = session.first_pose.keypoints
        held = all(written.get(name) == clock for name, clock in clocks.items())
        held = held and (frames is None or session.frames == frames)
        if not held or (keypoints is not None and (table is None or table.offset != keypoints)):
            raise InputError("the values do not stand where they are looked for")
    except InputError as error:
        mend = "remove its clocks, or write them as tables [clocks.CAM]"
        raise InputError(f"session {path} cannot be changed ({str(error).rstrip('.')}); {mend}.") from error
    finally:
        trial.unlink(missing_ok=True)
    with replacing(path, "session") as part:
        Path(part).write_text(text, encoding="utf-8")


def _table(name: str, clock: Clock, new: bool) -> str:
    key = name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)
    rate = f"rate = {clock.rate!r}\n" if clock.rate != 1.0 else ""
    fps = f"fps = {clock.fps!r}\n" if clock.fps is not None else ""
    found = "  # s, by twistcap sync" if new else ""
    return f"\n[clocks.{key}]\noffset = {clock.offset!r}{found}\n{rate}{fps}"


def _with_frames(text: str, frames: tuple[int, int]) -> str:
    lines, line = text.splitlines(), f"frames = [{frames[0]}, {frames[1]}]"
    first = next((k for k, line in enumerate(lines) if _HEADER.match(line)), len(lines))
    head, tables = "\n".join(lines[:first]), "\n".join(lines[first:])
    changed, count = re.subn(r"(?m)^\s*frames\s*=\s*\[[^\]]*\]", line, head, count=1)
    return "\n".join([changed if count else f"{line}\n{head}".rstrip("\n"), tables]) + "\n"


def _without(lines: list[str], table: str) -> list[str]:
    """The lines less those of a table and of its sub-tables; what is said above the next table stays."""
    out, aside, inside = list[str](), list[str](), False
    for line in lines:
        header = _HEADER.match(line)
        if header:
            inside = header[1].split(".")[0].strip() == table
        if inside:
            aside = [*aside, line] if not header and line.strip()[:1] in ("", "#") else []
        else:
            out, aside = [*out, *aside, line], []
    return out


def _with_offset(text: str, offset: float) -> str:
    """The `offset` of the keypoints replaced, or put first into their table."""
    lines, start, inside = text.splitlines(), None, False
    for k, line in enumerate(lines):
        if header := _HEADER.match(line):
            inside = header[1].replace(" ", "") == "first_pose.keypoints"
            start = k if inside else start
        elif inside and re.match(r"\s*offset\s*=", line):
            lines[k] = f"offset = {offset!r}"
            return "\n".join(lines) + "\n"
    if start is not None:
        lines.insert(start + 1, f"offset = {offset!r}")
    return "\n".join(lines) + "\n"
