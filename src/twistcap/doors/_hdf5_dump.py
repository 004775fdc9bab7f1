"""Everything in an HDF5 file as plain arrays. Run as a script, it is the child process in which strangers' files are
read: HDF5 is C, and a forged file can crash it. It needs only numpy and h5py.

    python _hdf5_dump.py FILE OUT.npz SECONDS BYTES

What is refused goes to stderr, with exit code 2.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MOST = 2000  # groups and datasets
_DEEPEST = 4
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
_UNPACKED = 1 << 26  # bytes that any file may unpack to
_RATIO = 20  # times its size, that a large file may unpack to
_WORD = 4096  # characters of a word in a dataset


def dumped(path: str) -> dict[str, Any]:
    """Arrays by path ("frames/q"), and attributes by path and name ("body@name").

    Raises ValueError, in words for the user, for links out of the file, data that is stored elsewhere, filters, types
    and sizes that we never write; and whatever h5py raises for damage.
    """
    with open(path, "rb") as raw:
        if raw.read(len(_SIGNATURE)) != _SIGNATURE:
            raise ValueError("it is no HDF5 file")
    allowed, out = _UNPACKED + _RATIO * Path(path).stat().st_size, dict[str, Any]()
    with h5py.File(path, "r", locking=False) as file:  # unlocked: a running track may be looked at
        for name, node in _nodes(file):
            if isinstance(node, h5py.Dataset):
                allowed -= _size(name, node)
                if allowed < 0:
                    raise ValueError(f"{name} is declared larger than a file of its size can mean")
                out[name] = _values(name, node)
            for key in node.attrs:
                out[f"{name}@{key}"] = _attribute(f"{name}@{key}", node.attrs[key])
    return out


def _nodes(file: Any) -> Iterator[tuple[str, Any]]:
    """Path and object of the file itself, and of all that hangs below by hard links, once each."""
    waiting, seen = [("", file)], 0
    while waiting:
        name, node = waiting.pop()
        yield name, node
        for key in node if isinstance(node, h5py.Group) else ():
            below, seen = f"{name}/{key}".lstrip("/"), seen + 1
            if not isinstance(node.get(key, getlink=True), h5py.HardLink):
                raise ValueError(f"{below} is a link to elsewhere")
            if seen > _MOST or below.count("/") >= _DEEPEST:
                raise ValueError("it holds more groups than a result")
            waiting.append((below, node[key]))


def _size(name: str, dataset: Any) -> int:
    """Bytes that a dataset unpacks to, once its storage is found to be such as we write."""
    plan = dataset.id.get_create_plist()
    if dataset.is_virtual or plan.get_external_count():
        raise ValueError(f"{name} is stored in another file")
    if not {plan.get_filter(k)[0] for k in range(plan.get_nfilters())} <= _FILTERS:
        raise ValueError(f"{name} has an unknown filter")
    text = h5py.check_string_dtype(dataset.dtype)
    if (dataset.dtype.kind not in "biufS" and text is None) or dataset.shape is None:
        raise ValueError(f"{name} is of the type {dataset.dtype}, which no result has")
    return int(np.prod([float(size) for size in dataset.shape])) * (dataset.dtype.itemsize if text is None else 16)


def _values(name: str, dataset: Any) -> Any:
    values = dataset[()]
    if h5py.check_string_dtype(dataset.dtype) is None or dataset.dtype.kind == "S":
        return np.asarray(values)
    words = np.asarray(values, dtype=object)
    longest = max((len(word) for word in words.flat), default=0)
    if longest > _WORD or longest * words.size > _UNPACKED:
        raise ValueError(f"{name} holds a word of {longest} characters")
    return words.astype(f"S{max(longest, 1)}")


def _attribute(name: str, value: Any) -> Any:
    array = np.asarray(value)
    if array.dtype.kind not in "biufSU":
        raise ValueError(f"{name} is of a type that no result has")
    return array


def main(dumped: Callable[[str], dict[str, Any]]) -> int:
    """What the child does, with limits of time and memory: `dumped` (path) gives the arrays."""
    path, out, seconds, most = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, ValueError, OSError):  # not on this system
        pass
    try:
        np.savez(out, **dumped(path))
    except Exception as error:  # whatever h5py makes of damage; the parent says it in one sentence
        print(error if type(error) is ValueError else "it is damaged", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(dumped))
