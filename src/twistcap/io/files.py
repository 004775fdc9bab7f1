"""Text, JSON, TOML and NPZ, in and out; what cannot be had is an `InputError` in one sentence."""

from __future__ import annotations

import errno
import json
import os
import tomllib
import zipfile
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray
from twistcap.errors import InputError


@contextmanager
def replacing(path: str | Path, what: str = "") -> Generator[Path]:
    """A path beside, to be written; it takes the place of `path` when it is whole. If not, an older file stays.

    Raises InputError, which says `what` it is, instead of any OSError of its writing.
    """
    goal = Path(os.path.realpath(path))
    special = goal.exists() and not goal.is_file()  # such as /dev/stdout
    part = goal if special else goal.with_name(f".{goal.stem}.part{goal.suffix}")
    try:
        yield part
        if not special:
            part.replace(goal)
    except OSError as error:
        raise unwritable(path, error, what) from error
    finally:
        if not special:
            with suppress(OSError):
                part.unlink()


def unwritable(path: str | Path, error: OSError, what: str = "") -> InputError:
    """The sentence for a file that cannot be written."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    mend = "make room, or choose another place" if full else "choose another place"
    return InputError(f"{what} {path} cannot be written: {error.strerror or error}; {mend}.".lstrip())


def write_at(descriptor: int, data: bytes | memoryview, offset: int) -> None:
    """Write all of it at a place of an open file. Raises OSError."""
    left = memoryview(data)
    while left:
        done = os.pwrite(descriptor, left, offset)
        left, offset = left[done:], offset + done


def read_lines(path: Path) -> list[str]:
    """Lines of a text file; bytes that are no UTF-8 are replaced."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error


def write_lines(path: Path, lines: Sequence[str]) -> None:
    """A text file, each line ended. Raises InputError if it cannot be written."""
    with replacing(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """What a JSON file holds."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except ValueError as error:
        raise InputError(f"{path}: not a JSON file ({error}).") from error


def read_toml(path: Path, what: str, mend: str = "check the path") -> dict[str, Any]:
    """The tables of a TOML file; `what` it is and how to `mend` its absence stand in messages."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{what} {path} cannot be read: {error.strerror}; {mend}.") from error
    except ValueError as error:
        raise InputError(f"{what} {path} is not valid TOML: {error}.") from error


def read_npz(path: str | Path, what: str) -> dict[str, AnyArray]:
    """The arrays of an NPZ; `what` it is stands in messages."""
    try:
        with np.load(path, allow_pickle=False) as data:
            return dict(data)
    except FileNotFoundError as error:
        raise InputError(f"{what} {path} does not exist; check its path.") from error
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{what} {path} cannot be read as NPZ: it is another kind of file, or damaged.") from error


def write_npz(path: str | Path, what: str, **arrays: Any) -> Path:
    """A compressed NPZ at that very path; `what` it is stands in messages."""
    with replacing(path, what) as part, part.open("wb") as file:  # a path without .npz would be given one
        np.savez_compressed(file, **arrays)
    return Path(path)
