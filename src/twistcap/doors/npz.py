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
_HEAD = 1 << 17  # bytes that hold any array's header
_PIECE = 1 << 20  # bytes that are unpacked at a time
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


def npz_arrays(data: bytes | Path, source: str) -> dict[str, AnyArray]:
    """All arrays of an NPZ's bytes, or of a file, which may be any; `source` they came from stands in messages."""
    try:
        held = BytesIO(data) if isinstance(data, bytes) else data
        size = len(data) if isinstance(data, bytes) else data.stat().st_size
        with zipfile.ZipFile(held) as archive:
            members = archive.infolist()
            allowed = _UNPACKED + _RATIO * size
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
    content = _content(archive, member)
    head: Any = BytesIO(memoryview(content)[:_HEAD])
    shape, fortran, dtype = _HEADERS[npy.read_magic(head)](head)
    count = 1
    for size in shape:
        count *= size
    if dtype.hasobject or dtype.names or count < 0 or count * dtype.itemsize != len(content) - head.tell():
        raise ValueError("the array's header does not fit its bytes")
    flat = np.frombuffer(content, dtype, offset=head.tell()) if count else np.zeros(0, dtype)
    return np.require(flat.reshape(shape, order="F" if fortran else "C"), requirements=("C", "A", "W"))


def _content(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytearray:
    """The bytes of a member, which are in memory but once. Raises ValueError where they are not as many as it says."""
    content, at = bytearray(member.file_size), 0
    with archive.open(member) as file:
        while piece := file.read(_PIECE):
            if at + len(piece) > len(content):
                raise ValueError("more bytes than declared")
            content[at : at + len(piece)] = piece
            at += len(piece)
    if at < len(content):
        raise ValueError("fewer bytes than declared")
    return content
