"""Libraries of training motion, kept as NPZ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twistcap.doors.npz import read_npz
from twistcap.doors.schema import Schema, real, whole, word
from twistcap.errors import check, naming
from twistcap.io.files import write_npz
from twistcap.motion import MotionLibrary

FORMAT = "twistcap-motions"
_KEYS: Schema = {
    "names": word("J"), "rate": real(), "clip_names": word("C"), "starts": whole("1+C", least=0, most=1 << 30),
    "q": real("N", "J"), "roots": real("N", 4, 4),
}  # fmt: skip


def write_library(path: str | Path, library: MotionLibrary) -> Path:
    """Write a library as NPZ: format, names, rate (1/s), clip_names, starts, q (rad, float32), roots (m)."""
    return write_npz(path, "motion library", format=FORMAT, **{key: getattr(library, key) for key in _KEYS})


def read_library(path: str | Path) -> MotionLibrary:
    """Read what `write_library` wrote. Raises InputError for a file that is missing, is no motion library, or holds
    what does not fit or is not finite.
    """
    mend = "it is no motion library; make one with twistcap motions build"
    data = read_npz(path, "motion library", {"format": word(), **_KEYS}, mend)
    check(str(path), str(data["format"]) == FORMAT, mend)
    with naming(path):
        return MotionLibrary(
            names=tuple(data["names"].tolist()), rate=float(data["rate"]),
            clip_names=tuple(data["clip_names"].tolist()), starts=data["starts"], q=data["q"].astype(np.float32),
            roots=data["roots"],
        )  # fmt: skip
