"""Libraries of training motion, kept as NPZ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twistcap.errors import InputError
from twistcap.io.files import read_npz, write_npz
from twistcap.motion import MotionLibrary

FORMAT = "twistcap-motions"
_KEYS = {"names", "rate", "clip_names", "starts", "q", "roots"}


def write_library(path: str | Path, library: MotionLibrary) -> Path:
    """Write a library as NPZ: format, names, rate (1/s), clip_names, starts, q (rad, float32), roots (m)."""
    return write_npz(path, "motion library", format=FORMAT, **{key: getattr(library, key) for key in _KEYS})


def read_library(path: str | Path) -> MotionLibrary:
    """Read what `write_library` wrote. Raises InputError for a file that is missing, is no motion library, or holds
    what does not fit or is not finite.
    """
    data = read_npz(path, "motion library")
    if str(data.get("format", "")) != FORMAT or not data.keys() >= _KEYS:
        raise InputError(f"{path} is no motion library; make one with twistcap motions build.")
    try:
        return MotionLibrary(
            names=tuple(map(str, np.atleast_1d(data["names"]))),
            rate=float(data["rate"]),
            clip_names=tuple(map(str, np.atleast_1d(data["clip_names"]))),
            starts=np.asarray(data["starts"], dtype=np.int32),
            q=np.asarray(data["q"], dtype=np.float32),
            roots=np.asarray(data["roots"], dtype=float),
        )
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error
