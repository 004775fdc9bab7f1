"""The door for HDF5: a file that this process has not written itself is read in a child process.

HDF5 is C, and a forged file can crash it, fill the memory or keep it busy for ever. The child has limits of time and
memory, and hands plain arrays back; here they are checked like those of an NPZ.
"""

from __future__ import annotations

import os
from pathlib import Path

from twistcap.arrays import AnyArray
from twistcap.doors import _hdf5_dump
from twistcap.doors.child import arrays_by_child
from twistcap.errors import InputError

_SECONDS = 6  # of the child's processor time; more for large files
_RATE = 30 << 20  # bytes that it reads in one more
_MEMORY = 700 << 20  # bytes of address space; more for large files
_own: set[tuple[int, ...]] = set()


def trust(path: str | Path) -> None:
    """This process has just written this file: as long as nobody changes it, it is read without a child."""
    _own.add(_stamp(path))


def read_hdf5(path: str | Path) -> dict[str, AnyArray]:
    """Arrays by path ("frames/q") and attributes by path and name ("body@name").

    Raises InputError for a file that is missing, damaged, or holds what no result holds.
    """
    source = f"result file {path}"
    try:
        if not Path(path).is_file():
            absence = "is no file" if Path(path).exists() else "does not exist"
            raise InputError(f"{source} cannot be opened: it {absence}; check its path.")
        with open(path, "rb"):
            pass
        if _stamp(path) in _own:
            return _hdf5_dump.dumped(str(path))
        size = os.stat(path).st_size
        seconds, memory = _SECONDS + size // _RATE, _MEMORY + 4 * size
        return arrays_by_child(_hdf5_dump.__file__, Path(path), source, seconds, memory)
    except OSError as error:
        raise InputError(f"{source} cannot be read: {error.strerror or 'it is damaged'}.") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{source} cannot be read: {error}.") from error


def _stamp(path: str | Path) -> tuple[int, ...]:
    found = os.stat(path)
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size
