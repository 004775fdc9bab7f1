"""The door for C3D: read by ezc3d in a child process, then checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twistcap.doors import _c3d_dump
from twistcap.doors.child import arrays_by_child
from twistcap.doors.schema import Schema, checked, real, whole, word
from twistcap.errors import InputError

_SECONDS = 30
_MEMORY, _TIMES = 1 << 30, 60  # bytes of address space, and more for each byte of the file
_C3D: Schema = {
    "points": real("N", "P", 3, gaps=True), "labels": word("P"), "rate": real(least=1e-3),
    "first": whole(least=0, most=1 << 31), "unit": word(), "start": real(least=-1e11, most=1e11, needed=False),
    "matrices": real("N", "R", 4, 4, gaps=True, needed=False), "segments": word("R", needed=False),
}  # fmt: skip


def read_c3d_arrays(path: str | Path) -> dict[str, Any]:
    """`points` (N, P, 3) with `labels` (P), `rate` 1/s, `first` frame, `unit`; the `start` (s) of a file of ours; where
    there are segments, `matrices` (N, R, 4, 4) with `segments` (R).

    Raises InputError for a file that is missing, damaged, or no C3D.
    """
    path, source = Path(path), f"the C3D {path}"
    if not path.is_file():
        raise InputError(f"{source} does not exist; check its path.")
    with path.open("rb") as file:
        if file.read(2)[1:] != b"\x50":
            raise InputError(f"{source} is no C3D file; check its path.")
    memory = _MEMORY + _TIMES * path.stat().st_size
    arrays = arrays_by_child(_c3d_dump.__file__, path, source, _SECONDS, memory)
    return checked(arrays, _C3D, source, "export it again")
