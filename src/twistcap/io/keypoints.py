"""Readers of 2D keypoints: OpenPose-style JSON (one file per frame and camera), and clicked joints as CSV or JSON.

All give `Keypoints` in the landmark names of the built-in body. Orders of the detectors: OpenPose BODY_25 and
BODY_25B (github.com/CMU-Perceptual-Computing-Lab, openpose and openpose_train), COCO (cocodataset.org), HALPE_26
(github.com/Fang-Haoshu/Halpe-FullBody), COCO-WholeBody's 133 (github.com/jin-s13/COCO-WholeBody) and BlazePose's 33
(MediaPipe). Names that the body lacks, as of hands, do not count.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import Float
from twistcap.doors.text import finite_number, number_array, read_json_table, read_text
from twistcap.errors import InputError, check
from twistcap.estimate import Keypoints
from twistcap.io.session_tables import Grid

_FEET = ("toe_l", "small_toe_l", "heel_l", "toe_r", "small_toe_r", "heel_r")
_COCO = (
    "nose", "eye_l", "eye_r", "ear_l", "ear_r", "shoulder_l", "shoulder_r", "elbow_l", "elbow_r", "wrist_l", "wrist_r",
    "hip_l", "hip_r", "knee_l", "knee_r", "ankle_l", "ankle_r",
)  # fmt: skip
_BLAZE = (
    "shoulder", "elbow", "wrist", "pinky", "index", "thumb", "hip", "knee", "ankle", "heel", "toe",
)  # fmt: skip
LAYOUTS: Mapping[str, tuple[str, ...]] = {
    "body_25": (
        "nose", "neck", "shoulder_r", "elbow_r", "wrist_r", "shoulder_l", "elbow_l", "wrist_l", "mid_hip", "hip_r",
        "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l", "eye_r", "eye_l", "ear_r", "ear_l", *_FEET,
    ),
    "body_25b": (*_COCO, "neck", "head_top", *_FEET),
    "coco_17": _COCO,
    "halpe_26": (
        *_COCO, "head_top", "neck", "mid_hip", "toe_l", "toe_r", "small_toe_l", "small_toe_r", "heel_l", "heel_r",
    ),
    "coco_133": (
        *_COCO, *_FEET, *(f"face_{k}" for k in range(68)), *(f"hand_{side}_{k}" for side in "lr" for k in range(21)),
    ),
    "blazepose": (
        "nose", "eye_inner_l", "eye_l", "eye_outer_l", "eye_inner_r", "eye_r", "eye_outer_r", "ear_l", "ear_r",
        "mouth_l", "mouth_r", *(f"{joint}_{side}" for joint in _BLAZE for side in "lr"),
    ),
}  # fmt: skip


class NoKeypoints(InputError):
    """A frame has none: no file, no picture, or nobody in the pictures."""


def read_openpose(
    files: Mapping[str, Path | str], cameras: Sequence[str], layout: str = "body_25b",
    person: int | Mapping[str, int] = 0, grids: Mapping[str, Grid] | None = None,
) -> Keypoints:  # fmt: skip
    """Keypoints of one frame from one OpenPose-style JSON file per camera.

    Args:
        files: JSON file of each camera, by camera name; a camera without one gives no keypoints.
        cameras: the rig's camera names, in order.
        layout: a name of `LAYOUTS`. BODY_25 and BODY_25B both have 25 points: the file does not say.
        person: which entry of ``people``, for all cameras or by camera name; a file without people gives no keypoints.
        grids: pixel grid of the detector, by camera name, where it is not the video's.

    Raises InputError for an unknown layout or camera, a file that cannot be read, has another number of points, or has
    fewer people.
    """
    people = read_people(files, cameras, layout, grids)
    choice = list[int | None]()
    for camera, persons in zip(cameras, people, strict=True):
        chosen = person if isinstance(person, int) else person.get(camera, 0)
        if len(persons):
            check_person(files[camera], chosen, len(persons))
        choice.append(chosen if len(persons) else None)
    return of_people(people, choice, layout)


def check_person(file: Path | str, chosen: int, count: int) -> None:
    """Raises InputError where a file of so many people does not hold the one who is chosen."""
    check(str(file), 0 <= chosen < count, f"person {chosen} is needed, but the file holds {count} (counted from 0)")


def read_people(
    files: Mapping[str, Path | str], cameras: Sequence[str], layout: str, grids: Mapping[str, Grid] | None = None
) -> list[Float]:
    """All people of each camera, (P, L, 3) x, y, confidence, in the video's pixels. Raises InputError as
    `read_openpose`.
    """
    if layout not in LAYOUTS:
        raise InputError(f"keypoint layout {layout!r} is unknown; use one of {', '.join(LAYOUTS)}.")
    _expect_cameras([*files, *(grids or {})], cameras, "the keypoints")
    L, out = len(LAYOUTS[layout]), list[Float]()
    for camera in cameras:
        people = _read_people(Path(files[camera]), layout) if camera in files else np.zeros((0, L, 3))
        grid = (grids or {}).get(camera, Grid())
        people[..., :2] = (people[..., :2] - grid.offset) / grid.scale
        people[..., 2] = np.clip(people[..., 2], 0.0, 1.0)
        out.append(people)
    return out


def of_people(people: Sequence[Float], choice: Sequence[int | None], layout: str) -> Keypoints:
    """The keypoints of one person of each camera; none where the choice is None."""
    names = LAYOUTS[layout]
    pixels, confidence = np.full((len(people), len(names), 2), np.nan), np.zeros((len(people), len(names)))
    for c, (persons, chosen) in enumerate(zip(people, choice, strict=True)):
        if chosen is not None:
            seen = persons[chosen, :, 2] > 0
            pixels[c, seen], confidence[c, seen] = persons[chosen, seen, :2], persons[chosen, seen, 2]
    return Keypoints(names, pixels, confidence)


def openpose_files(folders: Mapping[str, Path | str], frame: int | Mapping[str, int]) -> dict[str, Path]:
    """The JSON file of a frame in each camera's folder: number `frame`, or that of the camera, of its files in the
    order of their names. Raises NoKeypoints if a folder has fewer JSON files.
    """
    out: dict[str, Path] = {}
    numbers = dict.fromkeys(folders, frame) if isinstance(frame, int) else frame
    for camera, folder in folders.items():
        frame = numbers[camera]
        files = sorted(Path(folder).glob("*.json"))
        if not 0 <= frame < len(files):
            raise NoKeypoints(f"{folder}: frame {frame} of {camera} is needed, but there are {len(files)} JSON files.")
        out[camera] = files[frame]
    return out


def read_clicks(path: Path | str, cameras: Sequence[str], joints: Sequence[str] | None = None) -> Keypoints:
    """Clicked joints: CSV with columns camera, joint, x, y[, confidence], or JSON ``{camera: {joint: [x, y]}}``.

    A file is JSON by its ending. `cameras` are the rig's, in order; `joints` the names to accept (a body's landmarks),
    by default any. Raises InputError for a file that cannot be read, a missing column, an unknown camera or joint, a
    joint clicked twice in one camera, or a coordinate that is no finite number.
    """
    path = Path(path)
    rows = _json_rows(path) if path.suffix.lower() == ".json" else _csv_rows(path)
    _expect_cameras([row[0] for row in rows], cameras, str(path))
    clicks: dict[tuple[str, str], tuple[float, float, float]] = {}
    for camera, joint, *values in rows:
        if joints is not None and joint not in joints:
            raise InputError(f"{path}: joint {joint!r} is unknown; the body has {', '.join(joints)}.")
        where = f"of {joint} in {camera}"
        x, y, weight = (finite_number(v, f"{path}: {what} {where}") for v, what in zip(values, "xyc", strict=True))
        if clicks.get((camera, joint), (0, 0, 0))[2] > 0:
            raise InputError(f"{path}: joint {joint} is given twice for camera {camera}; keep one.")
        clicks[camera, joint] = x, y, weight
    return clicked(clicks, cameras)


def clicked(clicks: Mapping[tuple[str, str], tuple[float, float, float]], cameras: Sequence[str]) -> Keypoints:
    """x, y, px, and confidence by camera and joint as `Keypoints` of these cameras."""
    names = tuple(dict.fromkeys(joint for _, joint in clicks))
    pixels, confidence = np.full((len(cameras), len(names), 2), np.nan), np.zeros((len(cameras), len(names)))
    for (camera, joint), (x, y, weight) in clicks.items():
        at = cameras.index(camera), names.index(joint)
        pixels[at], confidence[at] = (x, y), weight
    return Keypoints(names, pixels, confidence)


def _expect_cameras(named: Sequence[str], cameras: Sequence[str], where: str) -> None:
    for camera in named:
        check(where, camera in cameras, f"camera {camera!r} has no calibration; the rig has {', '.join(cameras)}")


def _read_people(path: Path, layout: str) -> Float:
    """(P, L, 3) x, y, confidence of everybody in a file of OpenPose (``people``) or EasyMocap (``annots``)."""
    content = read_json_table(path)
    listed, key = ("annots", "keypoints") if "annots" in content else ("people", "pose_keypoints_2d")
    people: Any = content.get(listed)
    if not isinstance(people, list):
        raise InputError(f"{path}: field 'people' (a list) is missing; an OpenPose keypoint file has one.")
    L = len(LAYOUTS[layout])
    out = np.zeros((len(people), L, 3))
    for k, person in enumerate(people):
        given = person.get(key) if isinstance(person, dict) else None
        if listed == "annots" and isinstance(given, list) and all(isinstance(row, list) for row in given):
            given = [number for row in given for number in row]
        if isinstance(given, list) and len(given) != 3 * L:
            raise InputError(
                f"{path}: {key!r} of person {k} holds {len(given)} numbers; {_other_layout(given, layout)}."
            )
        out[k] = number_array(given, (3 * L,), f"{path}: {key!r} of person {k}").reshape(L, 3)
    return out


def _other_layout(numbers: Sequence[Any], layout: str) -> str:
    fitting = [repr(name) for name, names in LAYOUTS.items() if 3 * len(names) == len(numbers)]
    mend = f"set format = {' or '.join(fitting)}" if fitting else "set the format that they have"
    return f"format {layout!r} has {3 * len(LAYOUTS[layout])}, so {mend}"


def _csv_rows(path: Path) -> list[tuple[str, str, Any, Any, Any]]:
    try:
        rows = list(csv.DictReader(line for line in read_text(path).splitlines() if not line.startswith("#")))
    except csv.Error as error:
        raise InputError(f"{path}: the file of clicked joints cannot be read ({error}).") from error
    for column in ("camera", "joint", "x", "y"):
        if not rows or column not in rows[0]:
            head = "camera,joint,x,y[,confidence]"
            raise InputError(f"{path}: column {column!r} is missing; the first line must be {head}.")
    for r in rows:
        if None in r:  # what is beyond the last column
            where = f"the line of {r['joint']} in {r['camera']}"
            raise InputError(f"{path}: {where} has more fields than the first line; write numbers with a point.")
    return [(r["camera"], r["joint"], r["x"], r["y"], r.get("confidence") or 1.0) for r in rows]


def _json_rows(path: Path) -> list[tuple[str, str, Any, Any, Any]]:
    rows: list[tuple[str, str, Any, Any, Any]] = []
    for camera, joints in read_json_table(path).items():
        for joint, value in joints.items() if isinstance(joints, dict) else ():
            if not isinstance(value, list) or len(value) not in (2, 3):
                raise InputError(f"{path}: {camera}.{joint} must be [x, y] or [x, y, confidence], not {value!r}.")
            rows.append((camera, joint, value[0], value[1], value[2] if len(value) == 3 else 1.0))
    check(str(path), rows, "no joint is given; the file must be {camera: {joint: [x, y]}}")
    return rows
