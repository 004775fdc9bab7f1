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
from twistcap.errors import InputError
from twistcap.io.files import read_npz
from twistcap.io.result import read_result


def write_pose(path: str | Path, body: Body, pose: Pose, proportions: Proportions | None = None) -> None:
    """Write JSON ``{"root": 4×4, "q": {coordinate: rad}}`` and, where given, the body's ``"proportions"``.

    These are the factors that made `body` from the generic one.
    """
    content: dict[str, Any] = {"root": pose.root.tolist()}
    content["q"] = {name: float(value) for name, value in zip(body.coordinate_names, pose.q, strict=True)}
    if proportions is not None:
        content["proportions"] = asdict(proportions)
    Path(path).write_text(json.dumps(content, indent=1) + "\n")


def read_proportions(path: str | Path) -> Proportions | None:
    """The ``"proportions"`` that a pose file holds; None where it holds none or is no such file. Raises InputError for
    proportions that are no finite numbers.
    """
    path = Path(path)
    if path.suffix.lower() != ".json" or not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return None  # `read_pose` raises
    given = content.get("proportions") if isinstance(content, dict) else None
    if given is None:
        return None
    try:
        lengths, girths = ({k: float(v) for k, v in dict(given[key]).items()} for key in ("lengths", "girths"))
        found = Proportions(lengths, girths, float(given["stature"]))
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"pose file {path}: 'proportions' needs stature, lengths and girths.") from error
    if not np.all(np.isfinite([found.stature, *lengths.values(), *girths.values()])):
        raise InputError(f"pose file {path}: a factor of 'proportions' is not a finite number.")
    return found


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


def _from_json(path: Path, frame: int | None) -> tuple[Any, Mapping[str, Any]]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return content["root"], dict(content["q"])
    except (ValueError, TypeError, KeyError) as error:
        form = '{"root": 4×4, "q": {coordinate: rad}}'
        raise InputError(f"pose file {path} must be JSON {form} ({error}).") from error


def _from_npz(path: Path, frame: int | None) -> tuple[Any, Mapping[str, Any]]:
    data = read_npz(path, "pose file")
    if not {"root", "q", "coordinate_names"} <= data.keys():
        raise InputError(f"pose file {path} must hold root, q and coordinate_names.")
    roots = data["root"]
    row = _row(path, np.arange(len(roots)), frame) if roots.ndim == 3 else ...
    return roots[row], dict(zip(map(str, data["coordinate_names"]), data["q"][row], strict=True))


def _from_result(path: Path, frame: int | None) -> tuple[Any, Mapping[str, Any]]:
    result = read_result(path)
    pose = result.poses[_row(path, result.indices, frame)]
    return pose.root, dict(zip(result.body.coordinate_names, pose.q, strict=True))


def _row(path: Path, numbers: Any, frame: int | None) -> int:
    if len(numbers) == 0:
        raise InputError(f"pose file {path} holds no pose.")
    if frame is None:
        return 0
    if frame not in numbers:
        raise InputError(f"pose file {path} has no frame {frame}; it has {numbers[0]} to {numbers[-1]}.")
    return int(np.flatnonzero(numbers == frame)[0])


def _motion(path: Path, root: Any) -> Float:
    try:
        T = np.asarray(root, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"pose file {path}: root must be 4×4 numbers.") from error
    rotation = T.shape == (4, 4) and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-4)
    if not rotation or np.linalg.det(T[:3, :3]) < 0 or not np.all(np.isfinite(T)):
        raise InputError(f"pose file {path}: root must be a 4×4 rigid motion, rest pose to world, in metres.")
    return T


def _by_name(path: Path, body: Body, q: Mapping[str, Any]) -> Float:
    out = np.zeros(len(body.coordinate_names))
    for name, value in q.items():
        if name not in body.coordinate_names:
            raise InputError(f"pose file {path}: body {body.name!r} has no coordinate {name!r}; check [body].")
        if not isinstance(value, (int, float)) or not np.isfinite(value):
            raise InputError(f"pose file {path}: coordinate {name!r} is {value!r}; it must be a finite number, rad.")
        out[body.coordinate(name)] = value
    return out
