"""Files of other motion capture systems as named points of our bodies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from twistcap.doors.c3d import read_c3d_arrays
from twistcap.errors import check
from twistcap.io.markers import TO_FILE, UNITS, Markers, WorldAxes

_SAME = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist", "heel", "eye", "ear")
_DETECTOR_NAMES: Mapping[str, str] = {**{name: name for name in _SAME}, "bigtoe": "toe", "smalltoe": "small_toe"}
_CENTRES = {"hjc": "hip", "kjc": "knee", "ajc": "ankle", "sjc": "shoulder", "ejc": "elbow", "wjc": "wrist"}
_MIDDLE_NAMES: Mapping[str, str] = {"nose": "nose", "neck": "neck", "head": "head_top", "midhip": "mid_hip"}
# Segments whose origin is a joint centre, as Theia3D and Visual3D name them.
_ORIGINS = {"thigh": "hip", "shank": "knee", "foot": "ankle", "uarm": "shoulder", "larm": "elbow", "hand": "wrist"}


def landmark_name(marker: str) -> str:
    """The body's name for a marker of the OpenPose family (``RHip`` -> ``hip_r``) or a joint centre (``RHJC``); other
    names stay as they are."""
    lower = marker.lower()
    if lower in _MIDDLE_NAMES:
        return _MIDDLE_NAMES[lower]
    side, rest = lower[:1], lower[1:]
    if side in ("r", "l") and (known := _DETECTOR_NAMES.get(rest, _CENTRES.get(rest))):
        return f"{known}_{side}"
    return marker


def read_c3d(path: Path | str, axes: WorldAxes = "opensim") -> Markers:
    """The points of a C3D in our world, m, and the origins of its segments (ROTATION group) as the joints they are at.

    `axes` is how the file's world lies in ours. The time of frame n is n / rate, by the numbers of the file. A file of
    ours is numbered from 0 where its frames have numbers too high for the format; it says when it starts. Raises
    InputError for a file that cannot be read, or has another unit than m, cm and mm.
    """
    held = read_c3d_arrays(path)
    unit = str(held["unit"])
    check(str(path), unit in UNITS, f"POINT:UNITS is {unit!r}; it must be one of {', '.join(UNITS)}")
    names, points = [landmark_name(str(name)) for name in held["labels"]], held["points"]
    if "segments" in held:
        at = {_joint_of(str(label)): r for r, label in enumerate(held["segments"])}
        more = {name: r for name, r in at.items() if name and name not in names}
        names += list(more)
        points = np.concatenate([points, held["matrices"][..., :3, 3][:, list(more.values())]], axis=1)
    first, rate = int(held["first"]), float(held["rate"])
    start = float(held["start"]) if "start" in held and first == 0 else first / rate
    times = start + np.arange(len(points)) / rate
    return Markers(tuple(names), times, points * UNITS[unit] @ TO_FILE[axes])


def _joint_of(segment: str) -> str:
    """``r_thigh_4X4`` -> ``hip_r``; empty for a segment that begins at no joint of ours."""
    side, _, name = segment.removesuffix("_4X4").partition("_")
    return f"{_ORIGINS[name]}_{side}" if side in ("r", "l") and name in _ORIGINS else ""
