"""OpenCV's files (one for each camera) and EasyMocap's pair ``intri.yml`` and ``extri.yml``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twistcap.arrays import Float
from twistcap.camera import Camera, Rig
from twistcap.errors import InputError, check
from twistcap.io.calibration import made
from twistcap.io.cameras.parts import Asked, Size, numbers, whole_size, without_fisheye
from twistcap.io.opencv_storage import read_storage, storage_lines

_K = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "intrinsic_matrix")
_DIST = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "D", "dist")
_R, _T = ("R", "rotation", "rvec", "rotation_matrix"), ("T", "t", "translation", "tvec", "translation_vector")
_PAIR = ("intri.yml", "extri.yml")
_STEREO = {"M1", "D1", "M2", "D2"}, {"R", "T"}  # of the pair that OpenCV's stereo_calib writes


def read_opencv(path: Path, asked: Asked) -> Rig:
    """The files of a folder, or one, each a camera by its name: intrinsics, and R and T from world to camera.

    Names of matrices are those of OpenCV's samples. The pair of files of its stereo calibration (``intrinsics.yml``,
    ``extrinsics.yml``) holds the cameras "1" and "2", in the world of the first. Raises InputError.
    """
    files = [path] if path.is_file() else _storages(path)
    check(f"calibration {path}", files, "no .yml, .yaml or .xml file is there")
    if any(_is_half(read_storage(file)) for file in files):
        return _stereo(path, asked)
    return Rig(tuple(_camera(file, asked) for file in files))


def write_opencv(rig: Rig, path: Path) -> None:
    """One YAML file for each camera, in a folder; m."""
    without_fisheye(rig, "OpenCV's file")
    path.mkdir(parents=True, exist_ok=True)
    for camera in rig:
        entries: dict[str, Any] = {
            "image_width": camera.size[0], "image_height": camera.size[1], "camera_matrix": camera.K,
            "distortion_coefficients": camera.dist[None], "R": camera.T_cam_world[:3, :3],
            "T": camera.T_cam_world[:3, 3:],
        }  # fmt: skip
        (path / f"{camera.name}.yml").write_text(storage_lines(entries), encoding="utf-8")


def read_easymocap(path: Path, asked: Asked) -> Rig:
    """``intri.yml`` and ``extri.yml`` of a folder, or one of them (zju3dv/EasyMocap). Raises InputError."""
    folder = path if path.is_dir() else path.parent
    inner, outer = (read_storage(folder / name) for name in _PAIR)
    where = f"calibration {folder / _PAIR[0]}"
    names = inner.get("names")
    if not isinstance(names, list) or not names:
        raise InputError(f"{where}: the list 'names' is missing; add the names of the cameras.")
    cameras = list[Camera]()
    for name in names:
        at, there = f"{where}, camera {name!r}", f"calibration {folder / _PAIR[1]}, camera {name!r}"
        R = outer.get(f"Rot_{name}", outer.get(f"R_{name}"))
        K, dist = _matrix(at, inner, (f"K_{name}",)), _matrix(at, inner, (f"dist_{name}",)).ravel()
        place = (_turn(there, R), _shift(there, _matrix(there, outer, (f"T_{name}",)), asked))
        size = asked.size_or(_size(at, inner, f"W_{name}", f"H_{name}"), at)
        cameras.append(made(at, str(name), _square(at, K), place, size, dist))
    return Rig(tuple(cameras))


def write_easymocap(rig: Rig, path: Path) -> None:
    """The pair of files, in a folder; m."""
    without_fisheye(rig, "EasyMocap's pair")
    path.mkdir(parents=True, exist_ok=True)
    inner: dict[str, Any] = {"names": list(rig.names)}
    outer: dict[str, Any] = {"names": list(rig.names)}
    for c in rig:
        inner |= {
            f"K_{c.name}": c.K, f"dist_{c.name}": c.dist[None], f"W_{c.name}": c.size[0], f"H_{c.name}": c.size[1],
        }  # fmt: skip
        R, t = c.T_cam_world[:3, :3], c.T_cam_world[:3, 3:]
        outer |= {f"R_{c.name}": np.asarray(cv2.Rodrigues(R)[0], float), f"Rot_{c.name}": R, f"T_{c.name}": t}
    for name, entries in zip(_PAIR, (inner, outer), strict=True):
        (path / name).write_text(storage_lines(entries), encoding="utf-8")


def _storages(folder: Path) -> list[Path]:
    return sorted(p for p in folder.glob("*") if p.suffix in (".yml", ".yaml", ".xml"))


def _is_half(held: Mapping[str, Any]) -> bool:
    """Whether a file is of the pair of a stereo calibration: only the second of them holds rectified matrices."""
    return held.keys() >= _STEREO[0] or held.keys() >= _STEREO[1] | {"P1", "P2"}


def _stereo(path: Path, asked: Asked) -> Rig:
    """The cameras of such a pair; R and T lead from the first to the second."""
    where, held = f"calibration {path}", dict[str, Any]()
    for file in _storages(path if path.is_dir() else path.parent):
        content = read_storage(file)
        held |= content if _is_half(content) else {}
    if not held.keys() >= _STEREO[0] | _STEREO[1]:
        pair = "intrinsics.yml (M1, D1, M2, D2) and extrinsics.yml (R, T)"
        raise InputError(f"{where}: it is half of OpenCV's stereo calibration; put {pair} into one folder.")
    places = (np.eye(3), np.zeros(3)), (_turn(where, held["R"]), _shift(where, _matrix(where, held, ("T",)), asked))
    size, cameras = asked.size_or(None, where), list[Camera]()
    for name, place in zip("12", places, strict=True):
        K, dist = (_matrix(where, held, (kind + name,)) for kind in "MD")
        cameras.append(made(f"{where}, camera {name!r}", name, _square(where, K), place, size, dist.ravel()))
    return Rig(tuple(cameras))


def _camera(file: Path, asked: Asked) -> Camera:
    where, held = f"calibration {file}", read_storage(file)
    K = _square(where, _matrix(where, held, _K))
    dist = next((held[name].ravel() for name in _DIST if isinstance(held.get(name), np.ndarray)), np.zeros(5))
    t = _shift(where, _matrix(where, held, _T), asked)
    given = _size(where, held, "image_width", "image_height") or _size(where, held, "image_Width", "image_Height")
    place = (_turn(where, next((held[name] for name in _R if name in held), None)), t)
    return made(where, file.stem, K, place, asked.size_or(given, where), dist)


def _matrix(where: str, held: Mapping[str, Any], names: tuple[str, ...]) -> Float:
    for name in names:
        if isinstance(held.get(name), np.ndarray):
            return held[name]
    raise InputError(f"{where}: the matrix {names[0]!r} is missing; add it to the file.")


def _square(where: str, K: Float) -> Float:
    check(where, K.shape == (3, 3), f"its intrinsic matrix is {K.shape}, not 3 × 3")
    return K


def _shift(where: str, t: Float, asked: Asked) -> Float:
    check(where, t.size == 3, f"its translation has {t.size} numbers, not 3")
    return t.ravel() * asked.metres(1.0)


def _turn(where: str, R: Any) -> Float:
    good = isinstance(R, np.ndarray) and R.shape in ((3, 3), (3, 1), (1, 3))
    check(where, good, "its rotation is missing, or neither 3 × 3 nor a vector of 3")
    return R if R.shape == (3, 3) else R.ravel()


def _size(where: str, held: Mapping[str, Any], width: str, height: str) -> Size | None:
    if width not in held or height not in held:
        return None
    return whole_size(where, *numbers(f"{where}, {width} and {height}", (held[width], held[height]), 2))
