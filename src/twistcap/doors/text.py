"""The door for text: lines, numbers, JSON and TOML, of bounded size, depth and digits."""

from __future__ import annotations

import codecs
import json
import tomllib
import zlib
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import Float
from twistcap.errors import InputError

LARGEST = 1 << 26  # bytes of a text file, unpacked
_DEEPEST = 40  # tables and lists in one another
_GREATEST = 1 << 53  # whole numbers beyond it are none that we count or measure
_BACKSLASH = "write / for \\, or the text in single quotes"
_QUOTES = "a text ends on its line, with the quote that it began with"
_TOML_MENDS = {
    "Invalid value": "write texts in quotes, true and false in small letters, and 0.5 for .5",
    "Unescaped": _BACKSLASH,
    "Invalid hex value": _BACKSLASH,
    "Escaped character": _BACKSLASH,
    "Illegal character": _QUOTES,
    "Unterminated": _QUOTES,
    "Found invalid character": _QUOTES,
    "Expected newline": "write one value, texts in quotes, and 1.5 for 1,5",
    "Cannot": "each key and each table may stand once",
    "Expected '='": "write key = value, and keys with other characters than letters, digits, - and _ in quotes",
}
"""Words of a fault that the parser tells, and what its users most often meant."""


def read_bytes(path: Path, most: int = LARGEST) -> bytes:
    """All bytes of a regular file. Raises InputError for one that cannot be read, or has more than `most`."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path} cannot be read: it is no file; check its path.")
        with path.open("rb") as file:
            data = file.read(most + 1)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a path with a null byte
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{path} cannot be read: {why}; check its path.") from error
    if len(data) > most:
        raise InputError(f"{path} is larger than {most >> 20} MB; it is not the kind of file that belongs here.")
    return data


def read_text(path: Path, lenient: bool = False) -> str:
    """A text file in UTF-8, or in UTF-16 that says so, unpacked where it ends in .gz; `lenient` replaces what is
    neither. Raises InputError.
    """
    data = read_bytes(path)
    try:
        if path.suffix == ".gz":
            data = _unpacked(path, data)
        wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return data.decode("utf-16" if wide else "utf-8-sig", "replace" if lenient else "strict")
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} cannot be unpacked: {error}.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file in UTF-8; save it with that encoding in an editor.") from error


def read_lines(path: Path) -> list[str]:
    """Lines of a text file; bytes that are no UTF-8 are replaced. Raises InputError as `read_text`."""
    return read_text(path, lenient=True).splitlines()


def finite_number(word: Any, where: str) -> float:
    """The finite number that a word or a value of JSON says; `where` it stands begins the message of an InputError."""
    try:
        if isinstance(word, bool) or (isinstance(word, str) and "_" in word):
            raise ValueError
        value = float(word)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: {brief(word)} is no number; write a finite number.") from error
    if not np.isfinite(value):
        raise InputError(f"{where}: {brief(word)} is not a finite number.")
    return value


def number_array(value: Any, shape: tuple[int | None, ...], where: str) -> Float:
    """Nested lists of finite numbers as an array; None in the shape stands for any length. Raises InputError."""
    try:
        out = np.asarray(value)
        fits = out.dtype.kind in "iuf" or out.size == 0
    except (ValueError, OverflowError):
        out, fits = np.zeros(0), False
    wanted = len(out.shape) == len(shape) and all(w in (None, h) for w, h in zip(shape, out.shape, strict=True))
    if not (fits and wanted):
        size = " × ".join("any" if n is None else str(n) for n in shape)
        raise InputError(f"{where} must hold {size} numbers.")
    if not np.all(np.isfinite(out)):
        raise InputError(f"{where} holds a value that is not a finite number.")
    return out.astype(np.float64)


def read_json_table(path: Path) -> dict[str, Any]:
    """`parsed_json` of a file whose top is a table."""
    content = parsed_json(read_text(path), str(path))
    if not isinstance(content, dict):
        raise InputError(f"{path}: it must be a table, {{…}}, at its top.")
    return content


def parsed_json(text: str | bytes, source: str) -> Any:
    """What a JSON text holds: no key twice, finite numbers, not nested without end. `source` it came from stands in
    messages. Raises InputError.
    """
    try:
        content = json.loads(text, object_pairs_hook=_without_doubles)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: not a JSON file ({_reason(error)}).") from error
    _check(content, source)
    return content


def read_toml(path: Path, what: str, mend: str = "check the path") -> dict[str, Any]:
    """The tables of a TOML file; `what` it is and how to `mend` its absence stand in messages. Raises InputError."""
    if not path.is_file():
        why = "it is no file" if path.exists() else "No such file or directory"
        raise InputError(f"{what} {path} cannot be read: {why}; {mend}.".lstrip())
    try:
        text = read_text(path)
    except InputError as error:
        raise InputError(f"{str(error).rstrip('.')}; if it is no {what or 'TOML file'}, {mend}.") from error
    return parsed_toml(text, f"{what} {path}".strip())


def parsed_toml(text: str, source: str) -> dict[str, Any]:
    """`read_toml` of a text; `source` it came from stands in messages."""
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        reason = _reason(error)
        mend = next((mend for fault, mend in _TOML_MENDS.items() if fault in reason), "mend it there")
        raise InputError(f"{source} is not valid TOML: {reason}; {mend}.") from error
    _check(content, source)
    return content


def toml_value(text: str) -> Any:
    """A value as TOML writes it; what is none is itself, a bare word."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def _unpacked(path: Path, data: bytes) -> bytes:
    unpacker = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    out = unpacker.decompress(data, LARGEST + 1)
    if len(out) > LARGEST:
        raise InputError(f"{path} unpacks to more than {LARGEST >> 20} MB; it is not the kind of file for here.")
    if not unpacker.eof:
        raise EOFError("it ends too early")
    return out


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {brief(next(n for n in names if names.count(n) > 1))} is given twice")
    return table


def _check(content: Any, source: str) -> None:
    """Raises InputError at a value that is nested too deep, or a number that is not finite or too great."""
    for path, value in _leaves(content, source):
        bad = isinstance(value, float) and not isfinite(value)
        if bad or (isinstance(value, int) and abs(value) > _GREATEST):
            where = ".".join(map(str, path))
            raise InputError(f"{source}: {brief(where)} is {brief(value)}; write a finite number.")


def _leaves(content: Any, source: str) -> Iterator[tuple[tuple[Any, ...], Any]]:
    waiting: list[tuple[tuple[Any, ...], Any]] = [((), content)]
    while waiting:
        path, value = waiting.pop()
        if len(path) > _DEEPEST:
            raise InputError(f"{source}: it is nested deeper than {_DEEPEST} tables and lists.")
        if isinstance(value, dict):
            waiting.extend(((*path, key), item) for key, item in value.items())
        elif isinstance(value, list):
            waiting.extend(((*path, k), item) for k, item in enumerate(value) if not isinstance(item, str))
        else:
            yield path, value


def _reason(error: Exception) -> str:
    if isinstance(error, UnicodeDecodeError):
        return "it is no text in UTF-8"
    return "it is nested too deep" if isinstance(error, RecursionError) else str(error)


def brief(value: Any) -> str:
    """A value in a message; the digits of an integer too great to print are not printed."""
    if isinstance(value, int) and abs(value) > 10**30:
        return "a number of more than 30 digits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:40]}…{text[-10:]}"
