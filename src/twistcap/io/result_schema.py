"""What a result file holds, as the door for arrays checks it; ``docs/formats/result-file.md`` describes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray
from twistcap.doors.schema import Entry, Schema, checked, flag, real, whole, word

_ANY = {"least": -1e300, "most": 1e300, "gaps": True}  # information and its inverse have no bounds

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
FRAMES: Schema = {
    "index": whole("N", least=0, most=1 << 30),
    "time": real("N", least=-1e11, most=1e11),
    "root": real("N", 4, 4),
    "q": real("N", "J"),
    "covariance": real("N", "6+J", "6+J", **_ANY),
    "status": word("N"),
    "iterations": whole("N", least=0),
    "lost": flag("N"),
    "support": real("N", least=0.0, most=1.0, gaps=True),
    "probability": real("N", least=0.0, most=1.0),
    "part_probability": real("N", "S", least=0.0, most=1.0, gaps=True),
    "left_out": flag("N", "C"),
    "missing": flag("N", "C"),
    "bumps": real("N", "C", 3, least=-4.0, most=4.0),
    "predicted": word("N"),
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
    lengths = [len(array) for name in FRAMES if (array := held.get(f"frames/{name}")) is not None and array.ndim]
    n = min(lengths, default=0)
    index = held.get("frames/index")
    if index is not None and index.ndim == 1 and index.dtype.kind == "i" and np.any(index[:n] < 0):
        n = int(np.argmax(index[:n] < 0))  # rows that wait for their frame
    energies = {name: array for name, array in held.items() if name.startswith("frames/energies/")}
    cut = {name: array[:n] for name, array in held.items() if _is_in(name, "frames") and array.ndim}
    for name, array in energies.items():
        if array.ndim == 1 and array.dtype.kind == "f":
            cut[name] = np.pad(array[:n], (0, max(0, n - len(array))), constant_values=np.nan)
    schema = dict(FRAMES) | {name.removeprefix("frames/"): real("N", **_ANY) for name in energies}
    return of_group(cut, "frames", schema, source)


def _is_in(name: str, group: str) -> bool:
    return name.startswith((f"{group}/", f"{group}@")) if group else "/" not in name
