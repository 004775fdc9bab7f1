"""Joint angles over time: OpenSim MOT and STO in and out, CSV out."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twistcap.arrays import Bool, Float, Int, runs
from twistcap.body import Body, Pose
from twistcap.body.humanoid import humanoid
from twistcap.body.limbs import most_of_limbs, named_limbs
from twistcap.doors.text import finite_number, read_lines
from twistcap.errors import InputError, check, check_choice
from twistcap.io import angles as convert
from twistcap.io.coordinates import Angles, coordinates_of
from twistcap.io.files import replacing, write_lines
from twistcap.io.markers import TO_FILE, WorldAxes
from twistcap.io.result import Result

_LENGTHS = re.compile(r"(_[tpv][xyz]|_beta_t[xyz])$|force|torque|moment", re.IGNORECASE)
_LEFT_OUT = "Frames left out"
_SPAN = re.compile(r"\((\S+) to (\S+) s\)")
_NO_NAME = re.compile(r"[\s/\\*+]")  # blanks end a label; OpenSim takes none of the others in a name
_NEGATIVE_KNEE = np.radians(-5.0)  # no walker has a mean knee angle below this


@dataclass(frozen=True)
class MotionTable:
    """Columns of a MOT or STO: `columns` (C names without time), `times` (N,) s, `values` (N, C) rad, or m and N.

    `gaps` are first and last time, s, of the spans that `write_mot` left out.
    """

    columns: tuple[str, ...]
    times: Float
    values: Float
    gaps: tuple[tuple[float, float], ...] = ()

    def get(self, name: str) -> Float:
        """(N,) one column, zeros where the file has none of that name."""
        return self.values[:, self.columns.index(name)] if name in self.columns else np.zeros(len(self.times))


def opensim_names(names: Iterable[str]) -> tuple[str, ...]:
    """Names as OpenSim takes them: without blanks and the signs of its paths. Different ones stay different."""
    out = list[str]()
    for name in names:
        plain = _NO_NAME.sub("_", name) or "_"
        while plain in out:
            plain += "_"
        out.append(plain)
    return tuple(out)


LOST_THROUGHOUT = "the body is lost in every frame; with --fill the predicted poses are written"


def write_mot(
    path: Path | str, body: Body, times: Float, poses: Sequence[Pose], axes: WorldAxes = "opensim",
    angles: Angles = "opensim", known: Bool | None = None, fill: bool = False, frames: Int | None = None,
) -> None:  # fmt: skip
    """Writes the coordinates of N poses (`io.coordinates`): inDegrees=yes, lengths in m.

    `times` (N,) are in s; for `axes` see `io.markers`. Frames that are not `known` (N,) are left out, unless `fill`:
    OpenSim's Storage stops at a row of NaN without a word. The head names them either way, by `frames` (N,), their
    numbers in the recording, by default 0 … N − 1. Raises InputError for unequal numbers, where no frame is left, or if
    the file cannot be written.
    """
    path = Path(path)
    check(str(path), len(times) == len(poses), f"there are {len(poses)} poses, but {len(times)} times")
    lost = np.zeros(len(times), np.bool_) if known is None else ~known
    check(str(path), fill or not lost.all(), LOST_THROUGHOUT)
    table = coordinates_of(body, poses, angles=angles, axes=axes, known=None if fill else ~lost)
    kept, (values, _) = np.flatnonzero(~lost | fill), table.in_degrees
    head = ["Coordinates", "version=1", f"nRows={len(kept)}", f"nColumns={len(table.names) + 1}", "inDegrees=yes", ""]
    head += ["Units are S.I. units (second, meters, Newtons, ...)", "Angles are in degrees.", ""]
    head += _lost_spans(lost, times, np.arange(len(times), dtype=np.int32) if frames is None else frames, fill)
    names = opensim_names(table.names)
    rows = ["\t".join([repr(float(times[n])), *(f"{v:.8f}" for v in values[n])]) for n in kept]
    write_lines(path, [*head, "endheader", "\t".join(["time", *names]), *rows])


def _lost_spans(lost: Bool, times: Float, frames: Int, fill: bool) -> list[str]:
    """A line of the head: first and last frame and time of each span in which the body was lost or not seen."""
    if not lost.any():
        return []
    ends = [(start, stop - 1) for start, stop in runs(lost)]
    spans = [f"{frames[a]}-{frames[b]} ({float(times[a])!r} to {float(times[b])!r} s)" for a, b in ends]
    what = "Frames filled with the predicted pose" if fill else _LEFT_OUT
    return [f"{what}, since the body was lost or not seen: {', '.join(spans)}", ""]


def read_mot(path: Path | str) -> MotionTable:
    """A MOT or STO table. Angles come in rad; columns of lengths and forces (_tx, force, …) stay as they are. Raises
    InputError if it cannot be read, has no endheader, no time column, or a broken row, naming it.
    """
    path = Path(path)
    lines = [line.strip() for line in read_lines(path)]
    ends = [n for n, line in enumerate(lines) if line.lower() == "endheader"]
    check(str(path), ends, "not a MOT or STO file (no line 'endheader')")
    header = dict(line.lower().split("=", 1) for line in lines[: ends[0]] if re.match(r"\w+=", line))
    start = next((n for n in range(ends[0] + 1, len(lines)) if lines[n]), len(lines) - 1)
    columns = lines[start].split()
    if not columns or columns[0].lower() != "time":
        raise InputError(f"{path}: its first column is {columns[0] if columns else ''!r}; it must be time.")
    rows = [_mot_row(path, n + 1, lines[n], columns) for n in range(start + 1, len(lines)) if lines[n]]
    check(str(path), rows, "it has no rows")
    table = np.array(rows)
    values = table[:, 1:]
    if header.get("indegrees", "yes").strip() == "yes":
        angular = np.array([not _LENGTHS.search(name) for name in columns[1:]], dtype=bool)
        values = np.where(angular, np.radians(values), values)
    return MotionTable(tuple(columns[1:]), table[:, 0], values, _gaps(path, lines[: ends[0]]))


def _gaps(path: Path, head: Sequence[str]) -> tuple[tuple[float, float], ...]:
    """First and last time of the spans that the head says are left out."""
    spans = [span for line in head if line.startswith(_LEFT_OUT) for span in _SPAN.findall(line)]
    where = f"{path}: {_LEFT_OUT}"
    return tuple((finite_number(first, where), finite_number(last, where)) for first, last in spans)


def _mot_row(path: Path, at: int, line: str, columns: list[str]) -> list[float]:
    fields = line.split()
    if len(fields) != len(columns):
        raise InputError(f"{path}: line {at} has {len(fields)} fields, the head names {len(columns)} columns.")
    return [np.nan if field.lower() == "nan" else finite_number(field, f"{path}: line {at}") for field in fields]


def poses_from_mot(table: MotionTable, body: Body, axes: WorldAxes = "opensim") -> tuple[list[Pose], list[str]]:
    """Poses of a body from a motion file, matched by coordinate names; missing coordinates are 0.

    gait2392 and others bend knees to negative angles: they are taken for that if their mean is below −5°. For `axes`
    see `io.markers`.

    Returns one pose per row, and the names of the columns that the body does not have. Raises InputError if a used
    column holds NaN, or none of the columns is known to the body.
    """
    check_choice("poses_from_mot: axes", axes, TO_FILE)
    known = {*convert.PELVIS_ANGLES, *convert.PELVIS_PLACE, *body.coordinate_names}
    unknown = [name for name in table.columns if name not in known]
    if len(unknown) == len(table.columns):
        raise InputError(f"the motion file: none of its columns is a coordinate of body {body.name!r}.")
    q = np.stack([table.get(name) for name in body.coordinate_names], axis=1).reshape(len(table.times), -1)
    knees = [k for k, name in enumerate(body.coordinate_names) if name.startswith("knee_angle")]
    if knees and float(np.mean(q[:, knees])) < _NEGATIVE_KNEE:
        q[:, knees] *= -1.0
    given = np.array([name in table.columns for name in body.coordinate_names], bool)
    q -= given * convert.zeros_of(body)
    for ours, opensim in convert.shoulders_of(body):
        q = convert.reordered(body, q, opensim, ours)
    turns = np.stack([table.get(name) for name in convert.PELVIS_ANGLES], axis=1)
    place = np.stack([table.get(name) for name in convert.PELVIS_PLACE], axis=1)
    roots = convert.pelvis_roots(turns, place, convert.pelvis_point(body), TO_FILE[axes])
    if not (np.all(np.isfinite(q)) and np.all(np.isfinite(roots))):
        raise InputError("the motion file: a coordinate is NaN; fill or cut the rows without values.")
    return [Pose(root, row) for root, row in zip(roots, q, strict=True)], unknown


def poses_of_file(path: Path, axes: WorldAxes = "opensim") -> tuple[Body, MotionTable, list[Pose]]:
    """A MOT or STO in the coordinates of our body with all its joints; errors as of its parts, with the path."""
    table, body = read_mot(path), humanoid(thorax=True, clavicles=True, wrists=True)
    try:
        return body, table, poses_from_mot(table, body, axes)[0]
    except InputError as error:
        raise InputError(f"motion {path}: {error}") from error


def write_csv(
    path: Path | str, result: Result, axes: WorldAxes = "opensim", angles: Angles = "opensim", fill: bool = False
) -> None:
    """One row per frame: time, coordinates (`io.coordinates`), their standard deviations, status, support, the
    probability of loss of the body and of each limb (``probability_lost_arm_l``), and the lost flag.

    Units stand in the column names: `_deg` and `_m`, standard deviations end in `_std_deg` and `_std_m`. Frames that
    are lost or unseen have empty cells, unless `fill`. Raises InputError if the file cannot be written.
    """
    known = None if fill else result.known
    table = coordinates_of(result.body, result.poses, result.covariances, angles, axes, known)
    named = [f"_{'deg' if turns else 'm'}" for turns in table.turning]
    head = [name + unit for name, unit in zip(table.names, named, strict=True)]
    head += [f"{name}_std{unit}" for name, unit in zip(table.names, named, strict=True)]
    cells, limbs = np.hstack(table.in_degrees), named_limbs(result.body)
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        names = [f"probability_lost_{name}" for name in limbs]
        writer.writerow(["frame", "time", *head, "status", "support", "probability_lost", *names, "lost"])
        for n, (time, row) in enumerate(zip(result.times, cells, strict=True)):
            shown = [f"{v:.6f}" for v in row] if fill or result.known[n] else [""] * len(row)
            each = [f"{p:.4f}" if np.isfinite(p) else "" for p in most_of_limbs(limbs, result.part_probability[n])]
            ends = [f"{result.support[n]:.4f}", f"{result.probability[n]:.4f}", *each, int(result.lost[n])]
            writer.writerow([result.indices[n], repr(float(time)), *shown, result.statuses[n], *ends])
