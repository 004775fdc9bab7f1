"""In which unit a calibration's lengths are, where its file does not say: told by how far its cameras are apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from twistcap.arrays import Float
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.io.calibration import Unit, parsed_rig, says_unit
from twistcap.io.files import pasted
from twistcap.io.plausible import camera_distances, span_in_words

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}  # m
_NAMES: dict[Unit, str] = {
    "m": "metres",
    "mm": "millimetres",
}  # not centimetres: in squares of a board rooms are as large
_NEAREST: dict[Unit, float] = {"m": 0.3, "mm": 1.0}  # m between the cameras that are farthest apart
_FARTHEST = 30.0  # m, and from the world's origin
_SAY = "say it: --unit mm, or its length in metres, as --unit 0.06"


def unit_of(text: str) -> float:
    """m of one unit: ``m``, ``cm``, ``mm``, or a length in m, such as 0.06. Raises InputError for another text."""
    try:
        length = UNITS[text] if text in UNITS else float(text)
    except ValueError:
        length = np.nan
    if not 1e-6 < length < 1e6:
        raise InputError(f"--unit is {text!r}; write m, cm, mm, or the length of one unit in m, such as 0.06.")
    return length


def session_unit(text: str | None) -> Unit | None:
    """The unit of a calibration that a session reads itself. Raises InputError for another than ``m`` and ``mm``."""
    if text is not None and text not in ("m", "mm"):
        raise InputError(f"--unit is {text!r}; a session reads m and mm only: use twistcap convert for this one.")
    return text


def toml_unit(path: Path, unit: Unit | None, key: str) -> tuple[Unit | None, str]:
    """The unit of a Calib.toml: as said, None where its file names it, else that of `taken_unit`; and that sentence.

    `key` is what names the file, for messages. Raises InputError as `parsed_rig` and `taken_unit`.
    """
    rig = parsed_rig(path, "m", key)
    known = unit is not None or says_unit(path)
    convert = f"twistcap convert {pasted(path)} metres.toml --unit 0.01"
    mend = f"say --unit mm, or convert it with the length of its unit in m:  {convert}"
    return (unit, "") if known else taken_unit(rig, f"calibration {path}", mend)


def taken_unit(rig: Rig, source: str, mend: str = _SAY) -> tuple[Unit, str]:
    """The unit that the distances of cameras allow, which were read as if in metres, and a sentence that says so.

    Raises InputError where neither metres nor millimetres make a room in which people are filmed.
    """
    apart = camera_distances(rig)
    away = float(np.max([np.linalg.norm(camera.centre) for camera in rig]))
    fitting: list[Unit] = [u for u in _NAMES if _possible(apart * UNITS[u], away * UNITS[u], _NEAREST[u])]
    if not fitting:
        far = f"{span_in_words(apart, '')} apart" if len(apart) else f"{away:.3g} from the origin"
        neither = f"cameras are {far}, which fits neither metres nor millimetres (is one unit a square of the board?)"
        raise InputError(f"{source}: {neither}; {mend}.")
    unit = fitting[0]
    where = f"cameras are {span_in_words(apart * UNITS[unit])} apart" if len(apart) else "the file does not say it"
    return unit, f"The calibration is taken to be in {_NAMES[unit]}: {where}. If it is not, give --unit."


def scaled(rig: Rig, factor: float) -> Rig:
    """The rig with all its lengths times a factor, about the world's origin."""
    places = [camera.T_cam_world.copy() for camera in rig]
    for place in places:
        place[:3, 3] *= factor
    return replace(rig, cameras=tuple(replace(c, T_cam_world=T) for c, T in zip(rig, places, strict=True)))


def _possible(apart: Float, away: float, nearest: float) -> bool:
    return bool(np.all(apart <= _FARTHEST)) and away <= _FARTHEST and (not len(apart) or apart.max() >= nearest)
