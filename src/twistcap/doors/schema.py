"""The schema of files of arrays: names, shapes with named sizes, kinds, finiteness and ranges.

A schema is a mapping from the name of an array to an `Entry`. Sizes are whole numbers, or names: "J" is the same
wherever it stands in one file, and "6+J" is six more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from twistcap.arrays import AnyArray
from twistcap.errors import InputError

Kind = Literal["real", "whole", "flag", "word"]
_KINDS: Mapping[str, tuple[str, Any]] = {
    "real": ("fiu", np.float64), "whole": ("iu", np.int32), "flag": ("bui", np.bool_), "word": ("SU", np.str_),
}  # fmt: skip
_GREATEST = 1e6  # of a number, unless its entry says otherwise: m, rad, s or counts
_LONGEST = 300  # characters of a word


@dataclass(frozen=True)
class Entry:
    """What one array must be.

    Attributes:
        kind: of its values.
        shape: its sizes.
        least, most: bounds of its values.
        below: the size that its values, which are indices, must stay below.
        gaps: whether real numbers may be NaN, for what is not known.
        needed: whether the file must hold it.
    """

    kind: Kind
    shape: tuple[int | str, ...] = ()
    least: float = -_GREATEST
    most: float = _GREATEST
    below: str | None = None
    gaps: bool = False
    needed: bool = True


Schema = Mapping[str, Entry]


def real(*shape: int | str, **bounds: Any) -> Entry:
    """Real numbers, float64 once read."""
    return Entry("real", shape, **bounds)


def whole(*shape: int | str, **bounds: Any) -> Entry:
    """Whole numbers, int32 once read."""
    return Entry("whole", shape, **bounds)


def flag(*shape: int | str, **bounds: Any) -> Entry:
    """True or false."""
    return Entry("flag", shape, **bounds)


def word(*shape: int | str, **bounds: Any) -> Entry:
    """Words of printable Unicode."""
    return Entry("word", shape, **bounds)


def checked(arrays: Mapping[str, AnyArray], schema: Schema, source: str, mend: str) -> dict[str, Any]:
    """Those arrays that a schema names, in its kinds.

    `source` is the file, for messages; `mend` says where a whole one comes from. Raises InputError for the first array
    that is missing or is not as the schema says.
    """
    out, sizes = dict[str, Any](), dict[str, int]()
    for name, entry in schema.items():
        if name not in arrays:
            if entry.needed:
                raise InputError(f"{source}: {name} is missing; {mend}.")
            continue
        fault = _fault(arrays[name], entry, sizes)
        if fault:
            raise InputError(f"{source}: {name} {fault}; {mend}.")
        out[name] = arrays[name]
    for name, array in out.items():
        fault = _out_of_range(array, schema[name], sizes)
        if fault:
            raise InputError(f"{source}: {name} {fault}; {mend}.")
        out[name] = _words(array) if array.dtype.kind == "S" else array.astype(_KINDS[schema[name].kind][1])
    return out


def _fault(array: AnyArray, entry: Entry, sizes: dict[str, int]) -> str | None:
    """What is wrong with an array's kind or shape; learns the sizes that it is the first to name."""
    if array.dtype.kind not in _KINDS[entry.kind][0]:
        return f"holds {array.dtype}, not {'a ' if entry.kind in ('flag', 'word') else ''}{entry.kind} values"
    if entry.kind == "word" and not all(w.isprintable() and len(w) <= _LONGEST for w in _words(array).flat):
        return f"holds a word that is not printable text of {_LONGEST} characters at most"
    pairs = zip(array.shape, entry.shape, strict=False)
    if len(array.shape) == len(entry.shape) and all(_fits(held, size, sizes) for held, size in pairs):
        return None
    wanted = ", ".join(f"{size}={sizes[size]}" if size in sizes else str(size) for size in map(str, entry.shape))
    return f"has shape {array.shape}, not ({wanted})"


def _fits(held: int, size: int | str, sizes: dict[str, int]) -> bool:
    if isinstance(size, int):
        return held == size
    more, _, name = size.rpartition("+")
    return held == sizes.setdefault(name, held - int(more or 0)) + int(more or 0)


def _words(array: AnyArray) -> AnyArray:
    return np.char.decode(array, "utf-8", "replace") if array.dtype.kind == "S" else array


def _out_of_range(values: AnyArray, entry: Entry, sizes: Mapping[str, int]) -> str | None:
    if entry.kind not in ("real", "whole") or not values.size:
        return None
    known = values if not entry.gaps else values[~np.isnan(values)]
    if not np.all(np.isfinite(known)):
        return "holds a value that is not finite"
    most = entry.most if entry.below is None else sizes[entry.below] - 1
    if np.any((known < entry.least) | (known > most)):
        return f"holds a value out of its range, {entry.least:g} to {most:g}"
    return None
