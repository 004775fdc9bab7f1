"""COLMAP's text model (``cameras.txt`` and ``images.txt``), and plain 3 × 4 projection matrices."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.linalg import rq
from scipy.spatial.transform import Rotation

from twistcap.arrays import Float
from twistcap.camera import Camera, Rig
from twistcap.doors.text import read_lines
from twistcap.errors import InputError, check
from twistcap.io.calibration import made
from twistcap.io.cameras.parts import Asked, Size, intrinsics, numbers, whole_size
from twistcap.io.files import write_lines

# Where fx, fy, cx, cy and k1, k2, p1, p2, k3 stand among the numbers of a COLMAP model; −1 is a 0.
_MODELS: dict[str, tuple[int, tuple[int, ...]]] = {
    "SIMPLE_PINHOLE": (3, (0, 0, 1, 2)),
    "PINHOLE": (4, (0, 1, 2, 3)),
    "SIMPLE_RADIAL": (4, (0, 0, 1, 2, 3)),
    "RADIAL": (5, (0, 0, 1, 2, 3, 4)),
    "OPENCV": (8, (0, 1, 2, 3, 4, 5, 6, 7)),
    "OPENCV_FISHEYE": (8, (0, 1, 2, 3, 4, 5, 6, 7)),
    "FULL_OPENCV": (12, (0, 1, 2, 3, 4, 5, 6, 7, 8)),
}
_HALF = 0.5  # px: COLMAP's upper left pixel has its centre at (0.5, 0.5)


def read_colmap(path: Path, asked: Asked) -> Rig:
    """The images of a folder with ``cameras.txt`` and ``images.txt`` (or one of the two), each a camera.

    A COLMAP model has no scale of its own: the user says the unit. Raises InputError.
    """
    folder = path if path.is_dir() else path.parent
    lenses = dict(_lenses(folder / "cameras.txt"))
    where = f"calibration {folder / 'images.txt'}"
    if asked.unit is None:
        raise InputError(f"{where}: a COLMAP model has no scale of its own; scale it, and say its unit, as --unit m.")
    rows = [line.split() for line in _pairs(folder / "images.txt")]
    cameras = [_image(where, row, lenses, asked.unit) for row in rows]
    check(where, cameras, "it holds no image")
    return Rig(tuple(cameras))


def write_colmap(rig: Rig, path: Path) -> None:
    """``cameras.txt`` and ``images.txt``, in a folder; m. One lens for each image."""
    path.mkdir(parents=True, exist_ok=True)
    lenses, images = (
        ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"],
        ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"],
    )
    for i, c in enumerate(rig, start=1):
        model = "OPENCV_FISHEYE" if c.fisheye else "FULL_OPENCV"
        rest = c.dist[:4] if c.fisheye else np.concatenate([c.dist, np.zeros(3)])
        values = [c.K[0, 0], c.K[1, 1], c.K[0, 2] + _HALF, c.K[1, 2] + _HALF, *rest]
        lenses.append(f"{i} {model} {c.size[0]} {c.size[1]} {_words(np.array(values))}")
        x, y, z, w = Rotation.from_matrix(c.T_cam_world[:3, :3]).as_quat()
        images += [f"{i} {_words(np.array([w, x, y, z]))} {_words(c.T_cam_world[:3, 3])} {i} {c.name}", ""]
    write_lines(path / "cameras.txt", lenses)
    write_lines(path / "images.txt", images)


def read_projections(path: Path, asked: Asked) -> Rig:
    """3 × 4 matrices P as text: files of a folder, each a camera by its name, or blocks of three lines in one file.

    P is world to pixels, up to a factor, and knows neither distortion nor the size of the images: the user says it.
    Raises InputError, also for a file without a matrix: it may be a camera that is damaged.
    """
    files = sorted(path.glob("*.txt")) if path.is_dir() else [path]
    check(f"calibration {path}", files, "it holds no .txt file with a 3 × 4 matrix; name another folder")
    blocks = [(name, block) for file in files for name, block in _blocks(file)]
    cameras = [_of_projection(f"calibration {path}, camera {name!r}", name, P, asked) for name, P in blocks]
    return Rig(tuple(cameras))


def write_projections(rig: Rig, path: Path) -> None:
    """One text file for each camera, in a folder. Raises InputError for a lens that P cannot say."""
    path.mkdir(parents=True, exist_ok=True)
    for camera in rig:
        if camera.distorts:
            raise InputError(
                f"camera {camera.name!r} has distortion, which a 3 × 4 matrix cannot say; undistort the video."
            )
        write_lines(path / f"{camera.name}.txt", [_words(row) for row in camera.P])


def _lenses(path: Path) -> Iterator[tuple[str, tuple[Size, Float, Float, bool]]]:
    """Size, K, distortion and whether it is a fisheye, by the camera's number."""
    for row in (line.split() for line in _lines(path)):
        where = f"calibration {path}, camera {row[0]!r}"
        check(where, len(row) > 4, "a line of cameras.txt holds CAMERA_ID, MODEL, WIDTH, HEIGHT and its numbers")
        if row[1] not in _MODELS:
            raise InputError(f"{where}: the model {row[1]} is not supported; undistort with COLMAP, or use OPENCV.")
        count, places = _MODELS[row[1]]
        values = numbers(f"{where}, PARAMS", row[4:], count)
        chosen = values[list(places)]
        check(
            where, row[1] != "FULL_OPENCV" or not np.any(values[9:]), "k4, k5 and k6 of FULL_OPENCV are not supported"
        )
        fx, fy, cx, cy = chosen[:4]
        size = whole_size(where, *numbers(f"{where}, WIDTH and HEIGHT", row[2:4], 2))
        yield row[0], (size, intrinsics(fx, fy, cx - _HALF, cy - _HALF), chosen[4:], row[1] == "OPENCV_FISHEYE")


def _image(where: str, row: list[str], lenses: dict[str, tuple[Size, Float, Float, bool]], unit: float) -> Camera:
    check(where, len(row) >= 10, "a line holds IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID and NAME")
    name = " ".join(row[9:])
    where = f"{where}, image {name!r}"
    w, x, y, z, *t = numbers(f"{where}, QW to TZ", row[1:8], 7)
    check(where, 0.9 < float(np.linalg.norm([w, x, y, z])) < 1.1, "its quaternion is not of length 1")
    check(where, row[8] in lenses, f"its camera {row[8]} is not in cameras.txt")
    size, K, dist, fisheye = lenses[row[8]]
    turn = np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix(), dtype=float)
    return made(where, Path(name).stem or name, K, (turn, unit * np.array(t)), size, dist, fisheye)


def _lines(path: Path) -> list[str]:
    return [line for line in read_lines(path) if line.strip() and not line.startswith("#")]


def _pairs(path: Path) -> list[str]:
    """The first of each two lines; the second, of points, may be empty."""
    lines = [line for line in read_lines(path) if not line.startswith("#")]
    while lines and not lines[0].strip():
        lines = lines[1:]
    return [line for line in lines[::2] if line.strip()]


def _blocks(file: Path) -> Iterator[tuple[str, Float]]:
    """Names and matrices of a file: lines of four numbers in threes; other lines are names."""
    rows, name, count, where = list[Float](), None, 0, f"calibration {file}"
    early = "a matrix ends too early; each needs three lines of four numbers"
    for line in read_lines(file):
        words = line.replace(",", " ").replace("[", " ").replace("]", " ").replace(";", " ").split()
        if line.startswith("#"):
            continue
        if _is_row(words):
            check(where, len(words) in (4, 12), f"the line {line.strip()!r} is no row of a matrix; it needs 4 numbers")
            rows += list(numbers(where, words).reshape(-1, 4))
        elif words:
            check(where, not rows, early)
            name = line.strip().rstrip(":")
        if len(rows) == 3:
            count += 1
            yield name or (file.stem if count == 1 else f"{file.stem}_{count}"), np.array(rows)
            rows, name = [], None
    check(where, not rows, early)
    check(where, count, "it holds no 3 × 4 matrix; mend it, or move it elsewhere if it is no camera")


def _is_row(words: list[str]) -> bool:
    """Whether a line is meant as a row of numbers, one of which may be damaged, and not as a name."""
    if len(words) in (4, 12) and not words[0][0].isalpha():
        return True
    return sum(map(_is_number, words)) >= max(2, len(words) - 1)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _of_projection(where: str, name: str, P: Float, asked: Asked) -> Camera:
    """``P = K [R | t]``, by an RQ decomposition; points before the camera have positive depth where det(M) > 0."""
    P = P * np.sign(np.linalg.det(P[:, :3]))
    check(
        where,
        abs(np.linalg.det(P[:, :3])) > 1e-12 * np.linalg.norm(P[:, :3]) ** 3,
        "its matrix is of no pinhole camera",
    )
    K, R = (np.asarray(part, float) for part in rq(P[:, :3]))
    sign = np.sign(np.diag(K))
    K, R = K * sign, sign[:, None] * R
    t: Float = np.linalg.solve(K, P[:, 3]).astype(float) * asked.metres(1.0)
    return made(where, name, K / K[2, 2], (R, t), asked.size_or(None, where), np.zeros(5))


def _words(values: Float) -> str:
    return " ".join(repr(float(x)) for x in values)
