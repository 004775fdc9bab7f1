"""caliscope's ``camera_array.toml``, and OpenCap's pickles, one for each camera."""

from __future__ import annotations

import pickle
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twistcap.arrays import Float
from twistcap.camera import Camera, Rig
from twistcap.doors.text import number_array, read_toml
from twistcap.errors import InputError, check
from twistcap.io.calibration import made
from twistcap.io.cameras.parts import Asked, whole_size, without_fisheye
from twistcap.io.files import replacing, write_lines
from twistcap.io.number_pickle import read_number_pickle


def read_caliscope(path: Path, asked: Asked) -> Rig:
    """The cameras of a ``camera_array.toml`` that have a place. They are named ``cam_0``. Raises InputError."""
    source = f"calibration {path}"
    tables = read_toml(path, "calibration").get("cameras")
    if not isinstance(tables, dict):
        raise InputError(f"{source}: [cameras.0] is missing; is it a camera_array.toml of caliscope?")
    whole = {key: t for key, t in tables.items() if isinstance(t, dict) and "rotation" in t and not t.get("ignore")}
    check(source, whole, "no camera of it has a rotation; calibrate the places too")
    return Rig(tuple(_caliscope(f"{source}, camera {key!r}", key, table, asked) for key, table in whole.items()))


def write_caliscope(rig: Rig, path: Path) -> None:
    """A ``camera_array.toml``, cameras by the numbers of `caliscope_names`; m."""
    lines = list[str]()
    for i, c in zip(_numbers(rig.names), rig, strict=True):
        turn = np.asarray(cv2.Rodrigues(c.T_cam_world[:3, :3])[0], float).ravel()
        dist = c.dist[:4] if c.fisheye else c.dist
        lines += [
            f"[cameras.{i}]", f"cam_id = {i}", f"size = [{c.size[0]}, {c.size[1]}]", "rotation_count = 0",
            f"matrix = {c.K.tolist()}", f"distortions = {dist.tolist()}", f"rotation = {turn.tolist()}",
            f"translation = {c.T_cam_world[:3, 3].tolist()}", f"fisheye = {str(c.fisheye).lower()}", "",
        ]  # fmt: skip
    write_lines(path, lines)


def caliscope_names(names: Sequence[str]) -> list[str]:
    """Names under which `read_caliscope` reads cameras again: by their own numbers where all end in different ones."""
    return [f"cam_{i}" for i in _numbers(names)]


def read_opencap(path: Path, asked: Asked) -> Rig:
    """OpenCap's pickles, one for each camera: a file, or all of a folder and its folders; mm.

    A camera is named as its file, or as the folder for OpenCap's own name, ``cameraIntrinsicsExtrinsics.pickle``. The
    pickle may build numbers, text and arrays only. Raises InputError.
    """
    files = [path] if path.is_file() else sorted(path.rglob("*.pickle"))
    check(f"calibration {path}", files, "no .pickle file is there")
    return Rig(tuple(_opencap(file, asked) for file in files))


def write_opencap(rig: Rig, path: Path) -> None:
    """One ``cameraIntrinsicsExtrinsics.pickle`` in a folder for each camera; mm."""
    without_fisheye(rig, "OpenCap's pickle")
    for c in rig:
        R, t = c.T_cam_world[:3, :3], 1e3 * c.T_cam_world[:3, 3:]
        table = {
            "intrinsicMat": c.K, "distortion": c.dist[None], "imageSize": np.array(c.size[::-1])[:, None],
            "rotation": R, "translation": t, "rotation_EulerAngles": np.zeros((3, 1)),
        }  # fmt: skip
        file = path / c.name / "cameraIntrinsicsExtrinsics.pickle"
        file.parent.mkdir(parents=True, exist_ok=True)
        with replacing(file) as part:
            part.write_bytes(pickle.dumps(table, protocol=4))


def _numbers(names: Sequence[str]) -> list[int]:
    ends = [re.search(r"\d{1,9}$", name) for name in names]
    numbers = [int(end[0]) for end in ends if end]
    return numbers if len(set(numbers)) == len(names) else list(range(len(names)))


def _caliscope(where: str, key: str, table: Mapping[str, Any], asked: Asked) -> Camera:
    fields = {"matrix": (3, 3), "distortions": (None,), "translation": (3,), "size": (2,)}
    for name in fields:
        check(where, name in table, f"the field {name!r} is missing; calibrate it again")
    K, dist, t, size = (number_array(table[name], shape, f"{where}: {name!r}") for name, shape in fields.items())
    turned = table.get("rotation_count", 0)
    check(where, turned == 0, "its rotation_count is not 0; turn the video, and calibrate it again")
    shape = (3, 3) if np.size(table["rotation"]) == 9 else (3,)
    R = number_array(table["rotation"], shape, f"{where}: 'rotation'")
    fisheye = table.get("fisheye", False)
    check(where, isinstance(fisheye, bool), "'fisheye' must be true or false")
    return made(where, f"cam_{key}", K, (R, t * asked.metres(1.0)), whole_size(where, *size), dist, fisheye)


def _opencap(file: Path, asked: Asked) -> Camera:
    where, held = f"calibration {file}", read_number_pickle(file)

    def numbers_of(key: str, count: int | None = None) -> Float:
        try:
            out = np.asarray(held.get(key, ()), dtype=float).ravel()
        except (ValueError, TypeError) as error:
            raise InputError(f"{where}: {key!r} is no array of numbers; export it again.") from error
        good = len(out) > 0 and count in (None, len(out)) and bool(np.all(np.isfinite(out)))
        check(where, good, f"{key!r} must hold {count or 'some'} finite numbers")
        return out

    height, width = numbers_of("imageSize", 2)
    place = (numbers_of("rotation", 9).reshape(3, 3), asked.metres(1e-3) * numbers_of("translation", 3))
    name = file.parent.name if file.stem == "cameraIntrinsicsExtrinsics" else file.stem
    K, dist = numbers_of("intrinsicMat", 9).reshape(3, 3), numbers_of("distortion")
    return made(where, name or "cam", K, place, whole_size(where, width, height), dist)
