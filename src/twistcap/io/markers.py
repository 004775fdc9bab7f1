"""Point trajectories: TRC marker files, and 3D keypoints as npz.

Files do not say how their world lies in ours; who reads one must know. "opensim" writes our world point (x, y, z) as
(x, z, −y), y up, and is the default of all files of points and angles. Pose2Sim writes it as (y, z, x), y up. "z_up" is
our own world, as laboratories often have it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from twistcap.arrays import Float, even_clock
from twistcap.doors.npz import read_npz
from twistcap.doors.schema import Schema, real, word
from twistcap.doors.text import finite_number, read_lines
from twistcap.errors import InputError, check, check_choice
from twistcap.io.files import write_lines
from twistcap.io.keypoints import LAYOUTS

WorldAxes = Literal["opensim", "pose2sim", "z_up"]
TO_FILE: Mapping[str, Float] = {  # (3, 3) from our world (z up) to the file's axes
    "opensim": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "pose2sim": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "z_up": np.eye(3),
}
CLOCK: Schema = {"times": real("N", least=-1e11, most=1e11, needed=False), "fps": real(least=1e-3, needed=False)}
_POINTS: Schema = {"X": real("N", "P", 3, gaps=True), "names": word("P", needed=False), **CLOCK}
UNITS: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}


@dataclass(frozen=True)
class Markers:
    """Named points over time: `names` (M), `times` (N,) s, `points` (N, M, 3) world z up, m, NaN where unseen."""

    names: tuple[str, ...]
    times: Float
    points: Float


def write_trc(path: Path | str, times: Float, names: Sequence[str], points: Float, axes: WorldAxes = "opensim") -> None:
    """Writes a TRC in m; NaN becomes an empty field.

    `times` (N,) are in s, `points` (N, M, 3) in the world, z up, m. For `axes` see the head of this module. Raises
    InputError for shapes that do not fit each other, or if the file cannot be written.
    """
    check_choice("write_trc: axes", axes, TO_FILE)
    path, points = Path(path), np.asarray(points, dtype=float)
    if points.shape != (len(times), len(names), 3):
        raise InputError(f"{path}: points are {points.shape}, but there are {len(times)} times and {len(names)} names.")
    values = points @ TO_FILE[axes].T
    rate = f"{frame_rate(np.asarray(times)):.10g}"
    labels = [f"{axis}{m + 1}" for m in range(len(names)) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        "\t".join([rate, rate, str(len(times)), str(len(names)), "m", rate, "1", str(len(times))]),
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(labels),
        "",
    ]
    for n, (time, row) in enumerate(zip(times, values.reshape(len(values), -1), strict=True), start=1):
        fields = ["" if np.isnan(v) else f"{v:.6f}" for v in row]
        last = fields.pop() if fields else ""  # OpenSim does not count an empty field at the end of a line
        lines.append("\t".join([str(n), repr(float(time)), *fields, last or " "]))
    write_lines(path, lines)


def read_trc(path: Path | str, axes: WorldAxes = "opensim") -> Markers:
    """The markers of a TRC in our world, z up, m. Units mm, cm and m are known. Raises InputError if it cannot be read,
    or a header field or a row is broken, naming it.
    """
    check_choice("read_trc: axes", axes, TO_FILE)
    path = Path(path)
    lines = read_lines(path)
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path}: not a TRC file (its first line must start with PathFileType).")
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    unit = header.get("Units", "")
    check(str(path), unit in UNITS, f"Units is {unit!r}; it must be one of {', '.join(UNITS)}")
    names = tuple(name.strip() for name in lines[3].split("\t")[2:] if name.strip())
    if header.get("NumMarkers") != str(len(names)):
        raise InputError(f"{path}: NumMarkers is {header.get('NumMarkers')}, but line 4 names {len(names)} markers.")
    rows = [_trc_row(path, n, line, len(names)) for n, line in enumerate(lines[5:], start=6) if line.strip()]
    check(str(path), rows, "it has no frames")
    told = header.get("NumFrames", "")
    whole = not told.isdigit() or int(told) <= len(rows)
    check(str(path), whole, f"NumFrames is {told}, but it has {len(rows)} rows; it was cut off, or correct the header")
    table = np.array(rows)
    points = table[:, 2:].reshape(len(table), len(names), 3) * UNITS[unit]
    return Markers(names, table[:, 1], points @ TO_FILE[axes])


def _trc_row(path: Path, at: int, line: str, markers: int) -> list[float]:
    """Frame, time and coordinates; empty and missing fields are NaN."""
    fields = [field.strip() for field in line.split("\t")]
    width = 2 + 3 * markers
    if any(fields[width:]):
        raise InputError(f"{path}: line {at} has more than {width} fields, 3 for each of {markers} markers.")
    fields = (fields + [""] * width)[:width]
    check(str(path), fields[1], f"line {at}: Time is missing")
    blank = ("", "nan")
    return [np.nan if field.lower() in blank else finite_number(field, f"{path}: line {at}") for field in fields]


def read_keypoints3d(path: Path | str, times: Float | None = None) -> Markers:
    """3D keypoints of an npz: `X` (N, P, 3) world m, with `times`, s, or `fps`, and `names` of the points.

    A file without a clock takes `times` (N,) s; without names its points are OpenPose BODY_25B in the body's landmark
    names. Raises InputError if it cannot be read, lacks X or a clock, or shapes do not fit.
    """
    data = read_npz(path, "the keypoint file", _POINTS, "it needs an array X of shape (frames, points, 3)")
    X = data["X"]
    names = tuple(map(str, data.get("names", LAYOUTS["body_25b"])))
    if len(names) != X.shape[1]:
        raise InputError(f"{path}: X has {X.shape[1]} points, but there are {len(names)} names.")
    if times is None and "times" in data:
        times = data["times"]
    elif times is None and "fps" in data:
        times = np.arange(len(X)) / float(data["fps"])
    if times is None:
        raise InputError(f"{path}: it has no clock; give it times or fps.")
    check(str(path), len(times) == len(X), f"X has {len(X)} frames, but there are {len(times)} times")
    return Markers(names, np.asarray(times, dtype=float), X)


def frame_rate(times: Float) -> float:
    """Frames per second of evenly spaced times (N,) s, some of which may be missing; 0 for a single one."""
    return round(even_clock(times)[0], 6) if len(times) > 1 else 0.0
