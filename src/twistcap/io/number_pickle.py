"""A pickle of numbers, text and NumPy arrays, read without building anything else.

A pickle is a program. This reader knows no other names than those of which NumPy's arrays are made, so that a
stranger's file can neither import nor call anything (Python's documentation of `pickle`, "Restricting Globals").
"""

from __future__ import annotations

import io
import pickle
import pickletools
import re
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.doors.text import read_bytes
from twistcap.errors import InputError

_LARGEST = 1 << 22  # bytes
_KINDS = "fiub"  # of arrays
_CODE = re.compile(r"[<>=|]?[fiub]\d{1,2}$")  # of a type of numbers
_STEPS = {
    "PROTO", "FRAME", "STOP", "MARK", "MEMOIZE", "PUT", "BINPUT", "LONG_BINPUT", "GET", "BINGET", "LONG_BINGET",
    "NONE", "NEWTRUE", "NEWFALSE", "INT", "LONG", "LONG1", "BININT", "BININT1", "BININT2", "FLOAT", "BINFLOAT",
    "STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8",
    "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST",
    "LIST", "APPEND", "APPENDS", "EMPTY_DICT", "DICT", "SETITEM", "SETITEMS", "GLOBAL", "STACK_GLOBAL", "REDUCE",
    "BUILD",
}  # fmt: skip


def _dtype(code: object, *rest: object) -> np.dtype[Any]:
    if not isinstance(code, str) or not _CODE.match(code):
        raise pickle.UnpicklingError(f"it holds an array of {code!r}")
    return np.dtype(code)


_BUILDERS: dict[tuple[str, str], Any] = {("numpy", "dtype"): _dtype, ("numpy", "ndarray"): "an array"}
for _core in ("core", "_core"):
    _BUILDERS[f"numpy.{_core}.multiarray", "_reconstruct"] = lambda kind, shape, code: np.zeros(0)  # its state follows
    _BUILDERS[f"numpy.{_core}.multiarray", "scalar"] = lambda kind, data: np.frombuffer(data, kind)[0]


class _Numbers(pickle.Unpickler):
    def find_class(self, module_name: str, global_name: str, /) -> Any:
        if (module_name, global_name) not in _BUILDERS:
            raise pickle.UnpicklingError(f"it would build {module_name}.{global_name}")
        return _BUILDERS[module_name, global_name]


def _check_steps(data: bytes) -> None:
    """Raises UnpicklingError for a step that no table of numbers needs, or a place in the memo that costs memory."""
    for step, argument, _ in pickletools.genops(data):
        far = step.name in ("PUT", "BINPUT", "LONG_BINPUT") and int(argument or 0) > len(data)
        if step.name not in _STEPS or far:
            raise pickle.UnpicklingError(f"it has the step {step.name}")


def read_number_pickle(path: Path) -> dict[str, Any]:
    """The table in a pickle, of numbers, text and numeric arrays.

    Raises InputError for a file that would build anything else, is damaged, or has no table.
    """
    data = read_bytes(path, _LARGEST)
    try:
        _check_steps(data)
        content = _Numbers(io.BytesIO(data)).load()
    except Exception as error:  # a damaged pickle fails in any way
        raise InputError(f"calibration {path} is no pickle of numbers, text and arrays alone ({error}).") from error
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(f"calibration {path} holds no table by names.")
    for key, value in content.items():
        array = isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in _KINDS
        if not (array or isinstance(value, (int, float, str, bool, list, tuple, type(None)))):
            raise InputError(f"calibration {path}: {key!r} is neither a number, text nor an array of numbers.")
    return content
