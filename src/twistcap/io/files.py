"""Text, JSON, TOML and NPZ, in and out; what cannot be had is an `InputError` in one sentence."""

from __future__ import annotations

import json
import os
import tomllib
import zipfile
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray
from twistcap.errors import InputError


@contextmanager
def replacing(path: str | Path) -> Generator[Path]:
    """A path beside, to be written; it takes the place of `path` when it is whole. If not, an older file stays."""
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():  # such as /dev/stdout
        yield path
        return
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


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
    """A text file, each line ended."""
    try:
        with replacing(path) as part:
            part.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error


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
    path = Path(path)
    try:
        with replacing(path) as part, part.open("wb") as file:  # a path without .npz would be given one
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise InputError(f"{what} {path} cannot be written: {error.strerror}; choose another path.") from error
    return path
