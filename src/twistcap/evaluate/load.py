"""References to evaluate against: studio truth, marker files, motion files and 3D keypoints, all as one `Reference`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.doors.npz import read_npz
from twistcap.doors.schema import Schema, real, word
from twistcap.errors import InputError, check, check_choice, naming
from twistcap.evaluate.other_systems import landmark_name, read_c3d
from twistcap.io.angles import complete_coordinates
from twistcap.io.isb import ISB
from twistcap.io.markers import CLOCK, TO_FILE, WorldAxes, read_keypoints3d, read_trc
from twistcap.io.motion_files import MotionTable, poses_from_mot, read_mot

_CLOCKED: Schema = {"X": real("N", "P", 3, gaps=True, needed=False), "names": word("M", needed=False), **CLOCK}
_TRUTH: Schema = {
    "q": real("N", "J", gaps=True), "landmarks": real("N", "P", 3, gaps=True), "names": word("P"),
    "coordinate_names": word("J"), **CLOCK,
}  # fmt: skip


@dataclass(frozen=True)
class Reference:
    """Values to compare with, on their own time line; NaN where unknown. P and C may be 0."""

    times: Float  # (M,) s, rising, on the recording's clock
    names: tuple[str, ...] = ()  # P points, in the body's landmark names where they are known
    points: Float = field(default_factory=lambda: np.zeros((0, 0, 3)))  # (M, P, 3) world, m
    coordinate_names: tuple[str, ...] = ()  # C joint coordinates
    angles: Float = field(default_factory=lambda: np.zeros((0, 0)))  # (M, C) rad
    notes: tuple[str, ...] = ()  # assumptions of the reader, for below the table
    added: tuple[int, ...] = ()  # rows that the file does not have: the ends of what it leaves out

    def at(self, times: Float) -> tuple[Float, Float]:
        """Points (N, P, 3) and angles (N, C) at other times, linearly interpolated; NaN outside the time line."""
        N = len(times)
        points = interpolated(self.times, self.points, times) if self.names else np.zeros((N, 0, 3))
        angles = interpolated(self.times, self.angles, times) if self.coordinate_names else np.zeros((N, 0))
        return points, angles

    def without(self, exclude: Sequence[str]) -> Reference:
        """The reference with flawed stretches unknown, each as ``NAME`` or ``NAME:FIRST-LAST`` (its own row numbers).
        Raises InputError for a name it does not have or a range that cannot be read.
        """
        points, angles = self.points.copy(), self.angles.copy()
        own = np.delete(np.arange(len(self.times)), self.added)
        for text in exclude:
            name, chosen = parsed_exclusion(text, len(own))
            rows = own[chosen]
            if name in self.names:
                points[rows, self.names.index(name)] = np.nan
            elif name in self.coordinate_names:
                angles[rows, self.coordinate_names.index(name)] = np.nan
            else:
                had = f"no point or coordinate {name!r}; it has {', '.join((*self.names, *self.coordinate_names))}"
                raise InputError(f"exclusion {text!r}: the reference has {had}.")
        return replace(self, points=points, angles=angles)


def interpolated(times: Float, values: Float, at: Float) -> Float:
    """Values (M, ...) given at rising `times` (M,), linearly interpolated at other times (N,); NaN outside. A time that
    is given needs only its own sample; its neighbours may be NaN."""
    tolerance = 1e-9 + 1e-6 * (times[-1] - times[0])  # times that came through a text file still hit the ends
    after = np.clip(np.searchsorted(times, at - tolerance), 0, len(times) - 1)
    before = np.where(np.abs(times[after] - at) <= tolerance, after, np.maximum(after - 1, 0))
    span = times[after] - times[before]
    weight = np.where(span > 0, (at - times[before]) / np.where(span > 0, span, 1.0), 0.0)
    w = weight.reshape(-1, *[1] * (values.ndim - 1))
    out = np.where(w > 0, (1 - w) * values[before] + w * values[after], values[before])
    out[(at < times[0] - tolerance) | (at > times[-1] + tolerance)] = np.nan
    return out


def parsed_exclusion(text: str, rows: int) -> tuple[str, slice]:
    """``wrist_r:76-79`` as a name and a range of rows, both ends included; a name alone means every row."""
    match = re.fullmatch(r"(\w+)(?::(\d+)(?:-(\d+))?)?", text.strip())
    if not match:
        raise InputError(f"exclusion {text!r} cannot be read; write it as NAME or NAME:FIRST-LAST, e.g. wrist_r:76-79.")
    name, first, last = match.groups()
    if first is None:
        return name, slice(0, rows)
    start, stop = int(first), int(last or first) + 1
    if not start < stop <= rows:
        raise InputError(f"exclusion {text!r} is no range of rows; write FIRST-LAST of rows 0 to {rows - 1}.")
    return name, slice(start, stop)


def load_reference(
    path: Path, body: Body, frame_times: Callable[[int], Float], axes: WorldAxes = "opensim"
) -> Reference:
    """Read a reference by its ending: ``.npz`` (studio truth or keypoints), ``.trc``, ``.c3d`` or ``.mot`` / ``.sto``.

    A motion file is read into the coordinates of `body` (OpenSim turns the shoulder in another order). Files without a
    clock take `frame_times`: (M,) s of the recording's frames 0 … M − 1. `axes` is how a TRC's or C3D's world lies in
    ours, see `io.markers`. Raises InputError for a missing, unknown or unreadable file.
    """
    check_choice("the reference: axes", axes, TO_FILE)
    if not path.exists():
        raise InputError(f"the reference {path} does not exist; give a file or a folder of masks.")
    ending = path.suffix.lower()
    if ending == ".npz":
        reference = _from_npz(path, frame_times)
    elif ending == ".trc":
        markers = read_trc(path, axes)
        reference = Reference(markers.times, tuple(landmark_name(name) for name in markers.names), markers.points)
    elif ending == ".c3d":
        markers = read_c3d(path, axes)
        reference = Reference(markers.times, markers.names, markers.points)
    elif ending in (".mot", ".sto"):
        reference = _from_mot(path, body)
    else:
        mend = "give .npz, .trc, .c3d, .mot, .sto or a folder of masks"
        raise InputError(f"the reference {path} has an unknown ending; {mend}.")
    if not np.all(np.diff(reference.times) > 0):
        raise InputError(f"the reference {path} needs times that rise from row to row.")
    return reference


def _from_npz(path: Path, frame_times: Callable[[int], Float]) -> Reference:
    form = "a keypoint file has X, a studio truth landmarks, names, q, coordinate_names and fps"
    if "X" in (head := read_npz(path, "the reference", _CLOCKED, form)):
        markers = read_keypoints3d(path, None if CLOCK.keys() & head.keys() else frame_times(len(head["X"])))
        notes = () if "names" in head else ("keypoints read in BODY_25B order",)
        return Reference(markers.times, markers.names, markers.points, notes=notes)
    data = read_npz(path, "the reference", _TRUTH, form)
    rows = len(data["q"])
    times = data.get("times", np.arange(rows) / float(data["fps"]) if "fps" in data else None)
    names, coordinates = (tuple(data[key].tolist()) for key in ("names", "coordinate_names"))
    return Reference(frame_times(rows) if times is None else times, names, data["landmarks"], coordinates, data["q"])


def _from_mot(path: Path, body: Body) -> Reference:
    """Angles of a motion file in the body's own coordinates: knees bend to positive, shoulders turn in our order. The
    ISB's, of our exports, keep their names. Rows with a NaN are not known, nor are the frames that a file of ours
    leaves out."""
    table = read_mot(path)
    known = np.all(np.isfinite(table.values), axis=1).reshape(-1)
    check(str(path), known.any(), "every row holds a NaN; give a file with rows that are whole")
    whole = replace(table, times=table.times[known], values=table.values[known])
    isb = tuple(name for name in table.columns if name.startswith(ISB))
    names, notes = (isb, ()) if isb else (complete_coordinates(body, table.columns), tuple[str, ...]())
    angles = np.full((len(known), len(names)), np.nan)
    if isb:
        angles[known] = np.stack([whole.get(name) for name in isb], axis=1)
    else:
        with naming(path):
            poses, _ = poses_from_mot(whole, body)
        angles[known] = np.stack([pose.q for pose in poses])[:, [body.coordinate(name) for name in names]]
        notes = _flipped(names, angles[known], whole)
    times, angles, added = _with_gaps(table, angles)
    return Reference(times, coordinate_names=names, angles=angles, notes=notes, added=added)


def _flipped(names: Sequence[str], angles: Float, table: MotionTable) -> tuple[str, ...]:
    """Notes on the knees of which `angles` (N, C) have the other sign than the file."""
    knees = [(name, angles[:, k], table.get(name)) for k, name in enumerate(names) if name.startswith("knee_angle")]
    flipped = [name for name, ours, theirs in knees if np.allclose(ours, -theirs) and np.any(ours)]
    return tuple(f"{name} was negative in flexion and has its sign changed" for name in flipped)


def _with_gaps(table: MotionTable, angles: Float) -> tuple[Float, Float, tuple[int, ...]]:
    """Times (M,) and angles (M, C) with a row of NaN at both ends of each span that the file leaves out, so that
    nothing is interpolated across it; and which rows these are."""
    ends = np.unique(np.array(table.gaps, float).ravel())
    ends = ends[~np.isin(ends, table.times)]
    times = np.concatenate([table.times, ends])
    order = np.argsort(times, kind="stable") if len(ends) else np.arange(len(times))
    filled = np.concatenate([angles, np.full((len(ends), angles.shape[1]), np.nan)])[order]
    return times[order], filled, tuple(np.flatnonzero(order >= len(table.times)).tolist())
