"""Camera calibration files of the aniposelib / Pose2Sim family, and whether what they say can be true.

One TOML table per camera: ``name``, ``size`` [w, h] px, ``matrix`` (3, 3), ``distortions`` [k1, k2, p1, p2(, k3)],
``rotation`` (Rodrigues vector or 3×3 matrix, world to camera), ``translation``, ``fisheye``; and ``[metadata]``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.camera import Camera, Rig
from twistcap.doors.images import MOST_PIXELS
from twistcap.doors.text import number_array, read_toml
from twistcap.errors import InputError, check
from twistcap.io.files import pasted
from twistcap.io.plausible import check_plausible

Unit = Literal["m", "mm"]
_TO_METRES: dict[str, float] = {"m": 1.0, "mm": 1e-3}
_GREATEST, _WIDEST = 1e6, 1 << 15  # of a number of a camera: px, m; of a side of its images, px
_FIELDS = ("size", "matrix", "rotation", "translation")  # a table with none of them is no camera
_KEY = "[cameras] calibration"  # which names the file, mostly
_FOREIGN = (".txt", ".xcp", ".yml", ".yaml", ".xml", ".pickle")  # what `io.cameras` reads


def read_rig(path: str | Path, unit: Unit | None = None, floor: float | None = 0.0, key: str = _KEY) -> Rig:
    """Read a calibration and check that it can be true.

    `unit` is that of the translations; None takes ``unit`` in the file's ``[metadata]``, and metres where there is
    none. `floor` is its height, m; None where the world's z is not upward; `key` is what names the file, for messages.
    Raises InputError as `parsed_rig`, and what `check_plausible` raises.
    """
    rig = parsed_rig(Path(path), unit, key)
    check_plausible(rig, floor=floor, source=f"calibration {path}")
    return rig


def parsed_rig(path: Path, unit: Unit | None = None, key: str = _KEY) -> Rig:
    """As `read_rig`, wherever its cameras stand.

    Raises InputError for a missing file, one of another program, and a missing, malformed, non-finite or impossible
    entry.
    """
    if (inside := path / "Calib.toml").is_file():
        raise InputError(f"calibration {path} is a folder; name {inside}.")
    if path.name.lower().endswith(_FOREIGN) or path.is_dir():
        raise _foreign(path)
    tables = read_toml(path, "calibration", f"check {key}")
    metadata = tables.get("metadata", {})
    given = unit or (metadata.get("unit") if isinstance(metadata, dict) else None) or "m"
    if not isinstance(given, str) or given not in _TO_METRES:
        raise InputError(f"calibration {path}: the unit {given!r} is unknown; write 'm' or 'mm'.")
    cameras = tuple(
        _camera(f"calibration {path}, camera {key!r}", key, table, _TO_METRES[given])
        for key, table in tables.items()
        if key != "metadata" and isinstance(table, dict) and any(field in table for field in _FIELDS)
    )
    if not cameras and isinstance(tables.get("cameras"), dict):
        raise _foreign(path)
    check(f"calibration {path} holds no camera", cameras, "it needs one table per camera, such as [cam01]")
    names = [camera.name for camera in cameras]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"calibration {path}: two cameras are named {name!r}; give each its own name.")
    return Rig(cameras)


def _foreign(path: Path) -> InputError:
    mend = f"make a Calib.toml of it:  twistcap convert {pasted(path)} Calib.toml"
    return InputError(f"calibration {path} is of another program; {mend}")


def says_unit(path: Path) -> bool:
    """Whether a calibration file names its unit in its ``[metadata]``."""
    metadata = read_toml(path, "calibration", f"check {_KEY}").get("metadata")
    return isinstance(metadata, dict) and metadata.get("unit") is not None


def knows_floor(path: str | Path) -> bool:
    """Whether z = 0 is the floor in a calibration file; ``floor = false`` in its ``[metadata]`` says that it is not."""
    metadata = read_toml(Path(path), "calibration", f"check {_KEY}").get("metadata")
    return not (isinstance(metadata, dict) and metadata.get("floor") is False)


def write_rig(rig: Rig, path: str | Path, unit: Unit = "m", floor: bool = True) -> None:
    """Write a rig so that `read_rig`, Pose2Sim and aniposelib read it.

    `unit` is that of the translations, and `floor` whether z = 0 is known to be the floor.
    """
    Path(path).write_text(rig_text(rig, unit, floor), encoding="utf-8")


def rig_text(rig: Rig, unit: Unit = "m", floor: bool = True) -> str:
    """What `write_rig` writes."""
    tables = [_table(camera, _TO_METRES[unit]) for camera in rig]
    metadata = f'[metadata]\nunit = "{unit}"\nadjusted = false\nerror = 0.0\n' + ("" if floor else "floor = false\n")
    return "\n".join([*tables, metadata])


def _camera(where: str, key: str, table: Mapping[str, Any], scale: float) -> Camera:
    fisheye = table.get("fisheye", False)
    check(where, isinstance(fisheye, bool), "the field 'fisheye' must be true or false")
    size = _numbers(where, table, "size", (2,))
    K = _numbers(where, table, "matrix", (3, 3))
    dist = _numbers(where, table, "distortions", (None,)) if "distortions" in table else np.zeros(5)
    R = _numbers(where, table, "rotation", (3, 3) if np.size(table.get("rotation", ())) == 9 else (3,))
    t = _numbers(where, table, "translation", (3,)) * scale
    if np.any(size < 1) or not np.allclose(size, np.round(size)):
        raise InputError(f"{where}: 'size' is {size.tolist()}; it must be [width, height] in whole pixels.")
    return made(where, str(table.get("name", key)), K, (R, t), (round(size[0]), round(size[1])), dist, fisheye)


def _numbers(where: str, table: Mapping[str, Any], field: str, shape: tuple[int | None, ...]) -> Float:
    check(where, field in table, f"the field '{field}' is missing; add it to the file")
    value = table[field]
    if len(shape) == 1 and isinstance(value, list) and all(isinstance(row, list) for row in value):
        value = [item for row in value for item in row]  # a column
    return number_array(value, shape, f"{where}: the field '{field}'")


def made(
    where: str, name: str, K: Float, place: tuple[Float, Float], size: tuple[int, int], dist: Float,
    fisheye: bool = False,
) -> Camera:  # fmt: skip
    """A camera of an intrinsic matrix, its place (rotation (3, 3) or Rodrigues' vector (3,); translation (3,), m; world
    to camera), and distortion coefficients. Raises InputError, which `where` begins, for what no camera has.
    """
    if np.any(dist[4 if fisheye else 5 :]):
        most = "four (k1 to k4) of a fisheye lens" if fisheye else "five (k1, k2, p1, p2, k3)"
        raise InputError(f"{where}: it has {dist.size} distortion coefficients; at most {most} are supported.")
    R, t = place
    out = Camera(name, K, se3.transform(_rotation(where, R), t), size, np.concatenate([dist, np.zeros(5)])[:5], fisheye)
    check_camera(where, out)
    return out


def _rotation(where: str, R: Float) -> Float:
    """(3, 3) of a matrix that is nearly a rotation, or of Rodrigues' vector."""
    if R.size == 3:
        return np.asarray(cv2.Rodrigues(R.reshape(3))[0], dtype=float)
    check(where, np.linalg.det(R) >= 0, "its rotation is mirrored (determinant below 0); flip one axis of it")
    check(where, np.allclose(R @ R.T, np.eye(3), atol=1e-3), "its rotation is no rotation; rows must be orthonormal")
    return se3.orthonormalised(se3.transform(R, np.zeros(3)))[:3, :3]


def check_camera(where: str, camera: Camera) -> None:
    """Check that a camera can be true; `where` it is from begins the message. Raises InputError for a matrix, lens,
    place or size that no camera has.
    """
    K, size = camera.K, np.array(camera.size, float)
    numbers = np.concatenate([K.ravel(), camera.dist, camera.T_cam_world.ravel()])
    if not np.all(np.abs(numbers) < _GREATEST):
        raise InputError(f"{where}: a number of it is not finite, or beyond {_GREATEST:g}; calibrate it again.")
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        given = f"{K[0, 0]:g} and {K[1, 1]:g}"
        raise InputError(f"{where}: the focal lengths in 'matrix' are {given}; they must be positive.")
    if not np.allclose(K[2], [0, 0, 1], atol=1e-6) or abs(K[1, 0]) > 1e-6:
        raise InputError(f"{where}: 'matrix' must read [[fx, s, cx], [0, fy, cy], [0, 0, 1]]; it may be transposed.")
    if size.max() > _WIDEST or size.prod() > MOST_PIXELS:
        raise InputError(f"{where}: its images are {camera.size[0]}×{camera.size[1]} pixels; that is too large.")
    if np.any(np.abs(K[:2, 2] - 0.5 * size) > size):
        raise InputError(
            f"{where}: the principal point ({K[0, 2]:g}, {K[1, 2]:g}) is far outside the image of"
            f" {[int(n) for n in size]} pixels; check that 'matrix' and 'size' belong together."
        )
    check(where, se3.is_motion(camera.T_cam_world, 1e-3), "its place is no rigid motion; calibrate it again")


def _table(camera: Camera, scale: float) -> str:
    name = '"' + camera.name.replace("\\", "\\\\").replace('"', '\\"') + '"'
    rvec = np.asarray(cv2.Rodrigues(camera.T_cam_world[:3, :3])[0], dtype=float).ravel()
    values: dict[str, Any] = {
        "size": [float(s) for s in camera.size],
        "matrix": camera.K.tolist(),
        # The family writes four; a fifth only where it says something.
        "distortions": (camera.dist if camera.dist[4] else camera.dist[:4]).tolist(),
        "rotation": rvec.tolist(),
        "translation": (camera.T_cam_world[:3, 3] / scale).tolist(),
    }
    lines = [f"{key} = {value}" for key, value in values.items()]
    return "\n".join([f"[{name}]", f"name = {name}", *lines, f"fisheye = {str(camera.fisheye).lower()}\n"])
