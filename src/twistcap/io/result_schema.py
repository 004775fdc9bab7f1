"""What a result file holds, as the door for arrays checks it; ``docs/formats/result-file.md`` describes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from h5py import string_dtype

from twistcap.arrays import AnyArray
from twistcap.doors.schema import Entry, Schema, checked, flag, real, whole, word
from twistcap.errors import InputError, check
from twistcap.registry import NAME_BYTES
from twistcap.se3 import is_motion

_ANY = {"least": -1e300, "most": 1e300, "gaps": True}  # information and its inverse have no bounds
_SHARE = {"least": 0.0, "most": 1.0}

HEAD: Schema = {"@format": word(), "@format_version": whole()}
BODY: Schema = {
    "@name": word(),
    "coordinate_names": word("J"),
    "segment_names": word("S"),
    "parent": whole("J"),
    "twists": real("J", 6),
    "limits": real("J", 2),
    "segment_joint": whole("S"),
    "vertices": real("V", 3),
    "faces": whole("F", 3),
    "skin_segments": whole("V", "K"),
    "skin_weights": real("V", "K", least=-1e-6, most=1 + 1e-6),
    "landmarks/names": word("L"),
    "landmarks/segments": whole("L"),
    "landmarks/points": real("L", 3),
}
RIG: Schema = {
    "names": word("C"),
    "K": real("C", 3, 3),
    "T_cam_world": real("C", 4, 4),
    "size": whole("C", 2, least=1, most=1 << 15),
    "dist": real("C", 5),
}


@dataclass(frozen=True)
class Column:
    """A dataset of the frames: which attribute of `Result` and of `Estimate` it holds, its type and its rows."""

    of_result: str
    of_estimate: str
    stored: Any
    rows: Entry


COLUMNS: Mapping[str, Column] = {
    "time": Column("times", "time", "f8", real("N", least=-1e11, most=1e11)),
    "root": Column("roots", "pose.root", "f8", real("N", 4, 4)),
    "q": Column("q", "pose.q", "f8", real("N", "J")),
    "covariance": Column("covariances", "covariance", "f8", real("N", "6+J", "6+J", **_ANY)),
    "status": Column("statuses", "status", string_dtype("ascii", 16), word("N")),
    "iterations": Column("iterations", "iterations", "i4", whole("N", least=0)),
    "lost": Column("lost", "lost", "bool", flag("N")),
    "support": Column("support", "support", "f8", real("N", **_SHARE, gaps=True)),
    "probability": Column("probability", "probability", "f8", real("N", **_SHARE)),
    "part_probability": Column("part_probability", "part_probability", "f8", real("N", "S", **_SHARE, gaps=True)),
    "left_out": Column("left_out", "left_out", "bool", flag("N", "C")),
    "missing": Column("missing", "missing", "bool", flag("N", "C")),
    "bumps": Column("bumps", "bumps", "f8", real("N", "C", 3, least=-4.0, most=4.0)),
    "sources": Column("sources", "sources", "i2", whole("N", "C", least=0)),
    "relit": Column("relit", "relit", "bool", flag("N")),
    "brightness": Column("brightness", "brightness", "f4", real("N", "C", **_SHARE, gaps=True)),
    "predicted": Column("predicted", "predicted", string_dtype("ascii", NAME_BYTES), word("N")),
    # The last one to be written: it says that the frame is whole.
    "index": Column("indices", "index", "i8", whole("N", least=0, most=1 << 30)),
}
STATE: Schema = {"about": Entry("real", (2, 3), least=-1, most=1 << 62)}  # counts beyond those of "whole"


def of_group(held: Mapping[str, AnyArray], group: str, schema: Schema, source: str) -> dict[str, Any]:
    """The checked arrays of a group, by their names in it. Raises InputError as `doors.schema.checked`."""
    inside = {name[len(group) :].removeprefix("/"): array for name, array in held.items() if _is_in(name, group)}
    return checked(inside, schema, f"{source}, {group or 'top'}", "track the recording again")


def frames_of(held: Mapping[str, AnyArray], source: str) -> dict[str, Any]:
    """The checked arrays of all N frames that are complete: a kill may strike between two datasets. Energies that end
    earlier are NaN from there on. Raises InputError.
    """
    lengths = [len(array) for name in COLUMNS if (array := held.get(f"frames/{name}")) is not None and array.ndim]
    n = min(lengths, default=0)
    index = held.get("frames/index")
    if index is not None and index.ndim == 1 and index.dtype.kind == "i" and np.any(index[:n] < 0):
        n = int(np.argmax(index[:n] < 0))  # rows that wait for their frame
    energies = {name: array for name, array in held.items() if name.startswith("frames/energies/")}
    cut = {name: array[:n] for name, array in held.items() if _is_in(name, "frames") and array.ndim}
    for name, array in energies.items():
        if array.ndim == 1 and array.dtype.kind == "f":
            cut[name] = np.pad(array[:n], (0, max(0, n - len(array))), constant_values=np.nan)
    schema = {name: column.rows for name, column in COLUMNS.items()}
    schema |= {name.removeprefix("frames/"): real("N", **_ANY) for name in energies}
    return of_group(cut, "frames", schema, source)


def check_frames(rows: Mapping[str, AnyArray], coordinates: int, segments: int, cameras: int) -> None:
    """Raises InputError for rows that do not fit the body and the cameras, or that hold what no run writes."""
    wanted = {"q": coordinates, "part_probability": segments}
    for name, columns in (
        wanted | dict.fromkeys(("left_out", "missing", "bumps", "sources", "brightness"), cameras)
    ).items():
        if rows[name].shape[1] != columns:
            raise InputError(f"frames: {name} has {rows[name].shape[1]} columns, not {columns}; track it again.")
    if np.any(np.diff(rows["index"]) <= 0) or np.any(np.diff(rows["time"]) <= 0):
        raise InputError("frames: their numbers or times do not rise; track the recording again.")
    each = np.sort(rows["sources"], axis=1) == np.arange(cameras)
    check("frames", np.all(each), "its sources name a camera twice or one that is not there; track the recording again")
    check("frames", np.all(is_motion(rows["root"])), "a root is no rigid motion; track the recording again")


def _is_in(name: str, group: str) -> bool:
    return name.startswith((f"{group}/", f"{group}@")) if group else "/" not in name
