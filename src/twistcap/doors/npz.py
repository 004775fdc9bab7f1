"""The door for NPZ: what a file declares is held against its size before it is allocated; nothing is unpickled."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from twistcap.arrays import AnyArray
from twistcap.doors.schema import Schema, checked
from twistcap.doors.text import read_bytes
from twistcap.errors import InputError

_LARGEST = 1 << 30  # bytes of a file
_MOST = 4096  # arrays
_UNPACKED = 1 << 26  # bytes that any file may unpack to
_RATIO = 20  # times its size, that a large file may unpack to
_HEADERS: dict[tuple[int, int], Callable[[IO[bytes]], Any]] = {
    (1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0,
}  # fmt: skip
_DAMAGE = (OSError, ValueError, TypeError, EOFError, KeyError, SyntaxError, NotImplementedError, RuntimeError,
           RecursionError, OverflowError, TokenError, zipfile.BadZipFile, zlib.error)  # fmt: skip


def read_npz(path: str | Path, what: str, schema: Schema, mend: str = "give another file") -> dict[str, Any]:
    """The arrays of an NPZ that a schema names.

    `what` it is and what to do stand in messages. Raises InputError for a file that is missing, damaged, larger than it
    can be, or not as the schema says.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{what} {path} does not exist; check its path.")
    return checked(npz_arrays(read_bytes(path, _LARGEST), f"{what} {path}"), schema, f"{what} {path}", mend)


def npz_arrays(data: bytes, source: str) -> dict[str, AnyArray]:
    """All arrays of the bytes of an NPZ, which may be any; `source` they came from stands in messages."""
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            members = archive.infolist()
            allowed = _UNPACKED + _RATIO * len(data)
            if len(members) > _MOST or sum(member.file_size for member in members) > allowed:
                raise InputError(f"{source} would unpack to more than a file of its size can mean; make it anew.")
            return {member.filename.removesuffix(".npy"): _array(archive, member) for member in members}
    except _DAMAGE as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{source} cannot be read as NPZ: it is another kind of file, or damaged.") from error


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> AnyArray:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # the others unpack without a bound
        raise ValueError("an unknown compression")
    with archive.open(member) as file:
        content: Any = BytesIO(file.read(member.file_size))
    shape, fortran, dtype = _HEADERS[npy.read_magic(content)](content)
    count = 1
    for size in shape:
        count *= size
    if (
        dtype.hasobject
        or dtype.names
        or count < 0
        or count * dtype.itemsize != len(content.getbuffer()) - content.tell()
    ):
        raise ValueError("the array's header does not fit its bytes")
    flat = np.frombuffer(content.getbuffer()[content.tell() :], dtype) if count else np.zeros(0, dtype)
    return flat.reshape(shape, order="F" if fortran else "C").copy()
