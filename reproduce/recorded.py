"""Recorded motions that experiments track and learn from; they are not part of the package."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from twistcap.body import Body
from twistcap.errors import InputError
from twistcap.io.motions import read_motion
from twistcap.motion import MotionClip

_CMU_SKELETON = "motions/cmu/01.asf"  # those of 07 and 08 are not published with them
_OWN_SKELETON = ("motions/cmu/01_01.amc", "motions/cmu/11_01.amc")


@dataclass(frozen=True)
class Recording:
    """Poses of a motion file.

    Attributes:
        file: in the folder that TWISTCAP_DATA names.
        first, last: of the poses at the wanted rate; `last` is left out, None takes all.
        every: 2 takes every second pose: twice the speed.
        cycles: how often a clip that ends as it began is played.
    """

    file: str
    first: int = 0
    last: int | None = None
    every: int = 1
    cycles: int = 1

    def clip(self, body: Body, rate: float) -> MotionClip:
        """It in a body's coordinates.

        Raises:
            InputError: where TWISTCAP_DATA does not have the file.
        """
        amc = self.file.endswith(".amc") and self.file not in _OWN_SKELETON
        skeleton = data_file(_CMU_SKELETON) if amc else None
        whole = read_motion(data_file(self.file), body, skeleton=skeleton, rate=rate)
        part = slice(self.first, self.last, self.every)
        return replace(whole, roots=whole.roots[part], q=whole.q[part]).looped(self.cycles)


def data_file(name: str) -> Path:
    """A file of the folder that the environment variable TWISTCAP_DATA names.

    Raises:
        InputError: where it is not there.
    """
    folder = os.environ.get("TWISTCAP_DATA")
    if folder is None:
        raise InputError(f"this experiment needs {name}: set TWISTCAP_DATA to the folder that holds it.")
    path = Path(folder) / name
    if not path.exists():
        raise InputError(
            f"this experiment needs {path}, which is not there; set TWISTCAP_DATA to the folder that has it."
        )
    return path
