"""One pose in a file: our JSON, an NPZ of poses, or a frame of a result file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.adjust.first_pose import Proportions
from twistcap.arrays import Float
from twistcap.body import Body, Pose, rescaled
from twistcap.body.rig_spec import RIG_MEND
from twistcap.doors.npz import read_npz
from twistcap.doors.schema import Schema, real, word
from twistcap.doors.text import finite_number, number_array, read_json_table
from twistcap.errors import InputError
from twistcap.io.result import read_result
from twistcap.se3 import is_motion

_ONE: Schema = {"root": real(4, 4), "q": real("J"), "coordinate_names": word("J")}
_MANY: Schema = {"root": real("N", 4, 4), "q": real("N", "J"), "coordinate_names": word("J")}
_FARTHEST = 1e3  # m or rad


def write_pose(
    path: str | Path, body: Body, pose: Pose, proportions: Proportions | None = None, frame: int | None = None
) -> None:  # fmt: skip
    """Write JSON ``{"root": 4×4, "q": {coordinate: rad}}`` and, where given, the ``"frame"`` of which it is, and the
    body's ``"proportions"``: the factors that made `body` from the generic one.
    """
    content: dict[str, Any] = {"root": pose.root.tolist()} | ({} if frame is None else {"frame": frame})
    content["q"] = {name: float(value) for name, value in zip(body.coordinate_names, pose.q, strict=True)}
    if proportions is not None:
        content["proportions"] = asdict(proportions)
    Path(path).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_proportions(path: str | Path) -> Proportions | None:
    """The ``"proportions"`` that a pose file holds; None where it holds none or is no such file. Raises InputError for
    proportions that are no finite numbers.
    """
    path = Path(path)
    if path.suffix.lower() != ".json" or not path.is_file():
        return None
    given = read_json_table(path).get("proportions")
    if given is None:
        return None
    where, kinds = f"pose file {path}: 'proportions'", ("lengths", "girths")
    if not isinstance(given, dict) or not all(isinstance(given.get(kind), dict) for kind in kinds):
        raise InputError(f"{where} needs stature, lengths and girths.")
    lengths, girths = ({k: finite_number(v, f"{where}, {k}") for k, v in given[kind].items()} for kind in kinds)
    found = Proportions(lengths, girths, finite_number(given.get("stature"), f"{where}, stature"))
    if not all(0.1 <= factor <= 10 for factor in (found.stature, *lengths.values(), *girths.values())):
        raise InputError(f"{where}: a factor is not between 0.1 and 10.")
    return found


def frame_of(path: str | Path) -> int | None:
    """The frame of which a JSON file says that its pose is; None where it does not say, or is no such file."""
    path = Path(path)
    found = read_json_table(path).get("frame") if path.suffix.lower() == ".json" and path.is_file() else None
    return found if type(found) is int else None


def body_at(path: str | Path, body: Body) -> Body:
    """The generic body at a pose file's `read_proportions`. Raises InputError for segments that it does not have."""
    found = read_proportions(path)
    return body if found is None else rescaled(body, found.lengths, found.girths, found.stature)


def read_pose(path: str | Path, body: Body, frame: int | None = None) -> Pose:
    """Read a pose for `body`.

    Args:
        path: ``.json`` as `write_pose` writes it (coordinates that are absent are 0), ``.npz`` with root (4, 4) or
            (N, 4, 4), q and coordinate_names, or a result file (``.h5``).
        body: whose coordinates are meant.
        frame: which pose of an NPZ (row) or of a result (frame number); None takes the first.

    Raises InputError for a file that cannot be read, an unknown coordinate, or a root that is no motion.
    """
    path = Path(path)
    readers = {".json": _from_json, ".npz": _from_npz, ".h5": _from_result, ".hdf5": _from_result}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"pose file {path} has an unknown ending; give .json, .npz or .h5.")
    if not path.is_file():
        raise InputError(f"pose file {path} does not exist; check [first_pose] file.")
    root, q = reader(path, frame)
    return Pose(_motion(path, root), _by_name(path, body, q))


def _from_json(path: Path, frame: int | None) -> tuple[Float, Mapping[str, Any]]:
    content = read_json_table(path)
    if "root" not in content or not isinstance(content.get("q"), dict):
        raise InputError(f'pose file {path} must be JSON {{"root": 4×4, "q": {{coordinate: rad}}}}.')
    return number_array(content["root"], (4, 4), f"pose file {path}: root"), content["q"]


def _from_npz(path: Path, frame: int | None) -> tuple[Float, Mapping[str, Any]]:
    mend = "it must hold root, q and coordinate_names, of one pose or many"
    try:
        data, row = read_npz(path, "pose file", _ONE, mend), ...
    except InputError:
        data = read_npz(path, "pose file", _MANY, mend)
        row = _row(path, np.arange(len(data["root"])), frame)
    return data["root"][row], dict(zip(data["coordinate_names"].tolist(), data["q"][row].tolist(), strict=True))


def _from_result(path: Path, frame: int | None) -> tuple[Float, Mapping[str, Any]]:
    result = read_result(path)
    pose = result.poses[_row(path, result.indices, frame)]
    return pose.root, dict(zip(result.body.coordinate_names, pose.q.tolist(), strict=True))


def _row(path: Path, numbers: Any, frame: int | None) -> int:
    if len(numbers) == 0:
        raise InputError(f"pose file {path} holds no pose.")
    if frame is None:
        return 0
    if frame not in numbers:
        raise InputError(f"pose file {path} has no frame {frame}; it has {numbers[0]} to {numbers[-1]}.")
    return int(np.flatnonzero(numbers == frame)[0])


def _motion(path: Path, root: Float) -> Float:
    if not is_motion(root) or np.abs(root).max() > _FARTHEST:
        raise InputError(f"pose file {path}: root must be a 4×4 rigid motion, rest pose to world, in metres.")
    return root


def _by_name(path: Path, body: Body, q: Mapping[str, Any]) -> Float:
    out = np.zeros(len(body.coordinate_names))
    for name, value in q.items():
        if name not in body.coordinate_names:
            lack = f"body {body.name!r} has no coordinate {name!r}; check [body]; {RIG_MEND}"
            raise InputError(f"pose file {path}: {lack}.")
        angle = finite_number(value, f"pose file {path}: coordinate {name!r}")
        if abs(angle) > _FARTHEST:
            raise InputError(f"pose file {path}: coordinate {name!r} is {angle:g}; it must be an angle, rad.")
        out[body.coordinate(name)] = angle
    return out
