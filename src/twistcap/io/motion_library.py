"""Libraries of training motion, kept as NPZ."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from twistcap.errors import InputError
from twistcap.motion import MotionLibrary

FORMAT = "twistcap-motions"
_KEYS = ("names", "rate", "clip_names", "starts", "q", "roots")


def write_library(path: str | Path, library: MotionLibrary) -> Path:
    """Write a library as NPZ: format, names, rate (1/s), clip_names, starts, q (rad, float32), roots (m).

    Raises InputError where the file cannot be written.
    """
    path = Path(path)
    try:
        with path.open("wb") as file:  # a path without .npz would be given one
            np.savez_compressed(
                file, format=FORMAT, names=np.array(library.names), rate=library.rate,
                clip_names=np.array(library.clip_names), starts=library.starts, q=library.q, roots=library.roots,
            )  # fmt: skip
    except OSError as error:
        raise InputError(f"motion library {path} cannot be written: {error.strerror}; choose another path.") from error
    return path


def read_library(path: str | Path) -> MotionLibrary:
    """Read what `write_library` wrote.

    Raises InputError for a file that is missing, is no motion library, or holds what does not fit or is not finite.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            data = dict(file)
    except FileNotFoundError as error:
        raise InputError(f"motion library {path} does not exist; check its path.") from error
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"motion library {path} cannot be read: it is another kind of file, or damaged.") from error
    if str(data.get("format", "")) != FORMAT or not set(_KEYS) <= data.keys():
        raise InputError(f"{path} is no motion library; make one with twistcap motions build.")
    try:
        return MotionLibrary(
            names=tuple(str(name) for name in np.atleast_1d(data["names"])),
            rate=float(data["rate"]),
            clip_names=tuple(str(name) for name in np.atleast_1d(data["clip_names"])),
            starts=np.asarray(data["starts"], dtype=np.int32),
            q=np.asarray(data["q"], dtype=np.float32),
            roots=np.asarray(data["roots"], dtype=float),
        )
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error
