"""Text and NPZ out; what cannot be written is an `InputError` in one sentence. What comes in: see `twistcap.doors`."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from twistcap.errors import InputError

_kept: ContextVar[tuple[str, ...]] = ContextVar("kept", default=())  # what `keeping` was given


@contextmanager
def keeping(*read: Any) -> Generator[None]:
    """Meanwhile no file is replaced that is read: paths, or whatever files are named in the JSON data of a session."""
    token = _kept.set((*_kept.get(), *_texts(read)))
    try:
        yield
    finally:
        _kept.reset(token)


def _texts(data: Any) -> Iterator[str]:
    if isinstance(data, (str, Path)):
        yield str(data)
    elif isinstance(data, Iterable):
        for one in data.values() if isinstance(data, Mapping) else data:
            yield from _texts(one)


def check_replaceable(*paths: Path) -> None:
    """Raises InputError for a file that is read, see `keeping`, or that nobody may write, as its owner has said."""
    for path in filter(Path.is_file, paths):
        if any(_same(path, read) for read in _kept.get()):
            fact = "it is one of the files that this command reads, or that its session names"
            raise InputError(f"{path} is not replaced: {fact}; choose another place.")
        if not path.stat().st_mode & stat.S_IWUSR:
            raise InputError(f"{path} is not replaced: it is read-only; choose another place, or allow writing to it.")


def _same(path: Path, other: str) -> bool:
    with suppress(OSError, ValueError):  # it is not there, or no path at all
        return os.path.samefile(path, other)
    return False


@contextmanager
def replacing(path: str | Path, what: str = "") -> Generator[Path]:
    """A path beside, to be written; it takes the place of `path` when it is whole. If not, an older file stays.

    Raises InputError, which says `what` it is, instead of any OSError of its writing, and as `check_replaceable`.
    """
    check_replaceable(Path(path))
    special = Path(path).exists() and not Path(path).is_file()  # such as /dev/stdout
    goal = Path(path if special else os.path.realpath(path))
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


def pasted(path: str | Path) -> str:
    """A path as a shell takes it, for commands in messages: blanks and brackets do not split it."""
    return quote(str(path))


def write_at(descriptor: int, data: bytes | memoryview, offset: int) -> None:
    """Write all of it at a place of an open file. Raises OSError."""
    left = memoryview(data)
    while left:
        done = os.pwrite(descriptor, left, offset)
        left, offset = left[done:], offset + done


def write_lines(path: Path, lines: Sequence[str]) -> None:
    """A text file, each line ended. Raises InputError if it cannot be written."""
    with replacing(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_npz(path: str | Path, what: str, **arrays: Any) -> Path:
    """A compressed NPZ at that very path; `what` it is stands in messages."""
    with replacing(path, what) as part, part.open("wb") as file:  # a path without .npz would be given one
        np.savez_compressed(file, **arrays)
    return Path(path)
