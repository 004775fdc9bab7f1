"""References to evaluate against: studio truth, marker files, motion files and 3D keypoints, all as one `Reference`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.body import Body
from twistcap.errors import InputError
from twistcap.io.angles import shoulders_of
from twistcap.io.markers import WorldAxes, read_keypoints3d, read_trc
from twistcap.io.motion_files import poses_from_mot, read_mot

_DETECTOR_NAMES: Mapping[str, str] = {
    "hip": "hip", "knee": "knee", "ankle": "ankle", "shoulder": "shoulder", "elbow": "elbow", "wrist": "wrist",
    "bigtoe": "toe", "smalltoe": "small_toe", "heel": "heel", "eye": "eye", "ear": "ear",
}  # fmt: skip
_MIDDLE_NAMES: Mapping[str, str] = {"nose": "nose", "neck": "neck", "head": "head_top", "midhip": "mid_hip"}


@dataclass(frozen=True)
class Reference:
    """Values to compare with, on their own time line.

    Attributes:
        times: (M,) s, rising, on the recording's clock.
        names: P points, in the body's landmark names where they are known.
        points: (M, P, 3) world, m; NaN where unknown. P may be 0.
        coordinate_names: C joint coordinates.
        angles: (M, C) rad; NaN where unknown. C may be 0.
        notes: assumptions of the reader, for below the table.
    """

    times: Float
    names: tuple[str, ...] = ()
    points: Float = field(default_factory=lambda: np.zeros((0, 0, 3)))
    coordinate_names: tuple[str, ...] = ()
    angles: Float = field(default_factory=lambda: np.zeros((0, 0)))
    notes: tuple[str, ...] = ()

    def at(self, times: Float) -> tuple[Float, Float]:
        """Points (N, P, 3) and angles (N, C) at other times, linearly interpolated; NaN outside the time line."""
        N = len(times)
        points = interpolated(self.times, self.points, times) if self.names else np.zeros((N, 0, 3))
        angles = interpolated(self.times, self.angles, times) if self.coordinate_names else np.zeros((N, 0))
        return points, angles

    def without(self, exclude: Sequence[str]) -> Reference:
        """The reference with flawed stretches unknown, each as ``NAME`` or ``NAME:FIRST-LAST`` (its own row numbers).

        Raises InputError for a name it does not have or a range that cannot be read.
        """
        points, angles = self.points.copy(), self.angles.copy()
        for text in exclude:
            name, rows = parsed_exclusion(text, len(self.times))
            if name in self.names:
                points[rows, self.names.index(name)] = np.nan
            elif name in self.coordinate_names:
                angles[rows, self.coordinate_names.index(name)] = np.nan
            else:
                raise InputError(
                    f"exclusion {text!r}: the reference has no point or coordinate {name!r}; "
                    f"it has {', '.join((*self.names, *self.coordinate_names))}."
                )
        return replace(self, points=points, angles=angles)


def interpolated(times: Float, values: Float, at: Float) -> Float:
    """Values (M, ...) given at rising `times` (M,), linearly interpolated at other times (N,); NaN outside.

    A time that is given needs only its own sample; its neighbours may be NaN.
    """
    tolerance = 1e-9 + 1e-6 * (times[-1] - times[0])  # times that came through a text file still hit the ends
    after = np.clip(np.searchsorted(times, at - tolerance), 0, len(times) - 1)
    before = np.where(np.abs(times[after] - at) <= tolerance, after, np.maximum(after - 1, 0))
    span = times[after] - times[before]
    weight = np.where(span > 0, (at - times[before]) / np.where(span > 0, span, 1.0), 0.0)
    w = weight.reshape(-1, *[1] * (values.ndim - 1))
    out = np.where(w > 0, (1 - w) * values[before] + w * values[after], values[before])
    out[(at < times[0] - tolerance) | (at > times[-1] + tolerance)] = np.nan
    return out


def parsed_exclusion(text: str, rows: int) -> tuple[str, slice]:
    """``wrist_r:76-79`` as a name and a range of rows, both ends included; a name alone means every row."""
    match = re.fullmatch(r"(\w+)(?::(\d+)(?:-(\d+))?)?", text.strip())
    if not match:
        raise InputError(f"exclusion {text!r} cannot be read; write it as NAME or NAME:FIRST-LAST, e.g. wrist_r:76-79.")
    name, first, last = match.groups()
    if first is None:
        return name, slice(0, rows)
    return name, slice(int(first), int(last or first) + 1)


def load_reference(
    path: Path, body: Body, frame_times: Callable[[int], Float], axes: WorldAxes = "pose2sim"
) -> Reference:
    """Read a reference by its ending: ``.npz`` (studio truth or keypoints), ``.trc`` or ``.mot`` / ``.sto``.

    Args:
        path: the file.
        body: whose coordinates a motion file is read into (OpenSim turns the shoulder in another order).
        frame_times: times (M,) of the recording's frames 0 … M − 1, for files that have no clock of their own.
        axes: rotation of a TRC's world about the vertical, see `io.markers`.

    Raises InputError for a missing, unknown or unreadable file.
    """
    if not path.exists():
        raise InputError(f"the reference {path} does not exist; give a file or a folder of masks.")
    ending = path.suffix.lower()
    if ending == ".npz":
        reference = _from_npz(path, frame_times)
    elif ending == ".trc":
        markers = read_trc(path, axes)
        reference = Reference(markers.times, tuple(landmark_name(name) for name in markers.names), markers.points)
    elif ending in (".mot", ".sto"):
        reference = _from_mot(path, body)
    else:
        raise InputError(
            f"the reference {path} has an unknown ending; give .npz, .trc, .mot, .sto or a folder of masks."
        )
    if not np.all(np.diff(reference.times) > 0):
        raise InputError(f"the reference {path} needs times that rise from row to row.")
    return reference


def _from_npz(path: Path, frame_times: Callable[[int], Float]) -> Reference:
    try:
        with np.load(path, allow_pickle=False) as archive:
            data = {key: archive[key] for key in archive.files}
    except (OSError, ValueError) as error:
        raise InputError(f"the reference {path} cannot be read as an npz file: {error}.") from error
    if "X" in data:
        clock = {"times", "fps"} & set(data)
        markers = read_keypoints3d(path, None if clock else frame_times(len(data["X"])))
        notes = () if "names" in data else ("keypoints read in BODY_25B order",)
        return Reference(markers.times, markers.names, markers.points, notes=notes)
    missing = [key for key in ("q", "landmarks", "names", "coordinate_names") if key not in data]
    if missing:
        raise InputError(
            f"the reference {path} lacks {', '.join(missing)}; a studio truth has root, q, landmarks, names, "
            "coordinate_names and fps, a keypoint file has X."
        )
    return _from_truth(data, frame_times)


def _from_truth(data: Mapping[str, AnyArray], frame_times: Callable[[int], Float]) -> Reference:
    rows = len(data["q"])
    if "times" in data:
        times = data["times"].astype(float)
    else:
        times = np.arange(rows) / float(data["fps"]) if "fps" in data else frame_times(rows)
    return Reference(
        times=times,
        names=tuple(str(name) for name in data["names"]),
        points=data["landmarks"].astype(float),
        coordinate_names=tuple(str(name) for name in data["coordinate_names"]),
        angles=data["q"].astype(float),
    )


def landmark_name(marker: str) -> str:
    """The body's name for a marker of the OpenPose family (``RHip`` -> ``hip_r``); other names stay as they are."""
    lower = marker.lower()
    if lower in _MIDDLE_NAMES:
        return _MIDDLE_NAMES[lower]
    if lower[:1] in ("r", "l") and lower[1:] in _DETECTOR_NAMES:
        return f"{_DETECTOR_NAMES[lower[1:]]}_{lower[0]}"
    return marker


def _from_mot(path: Path, body: Body) -> Reference:
    """Angles of a motion file in the body's own coordinates: knees bend to positive, shoulders turn in our order."""
    table = read_mot(path)
    poses, _ = poses_from_mot(table, body)
    names = tuple(name for name in body.coordinate_names if _complete(name, table.columns, body))
    q = np.stack([pose.q for pose in poses])[:, [body.coordinate(name) for name in names]]
    flipped = [
        name
        for k, name in enumerate(names)
        if name.startswith("knee_angle") and np.allclose(q[:, k], -table.get(name)) and np.any(q[:, k])
    ]
    notes = tuple(f"{name} was negative in flexion and has its sign changed" for name in flipped)
    return Reference(table.times, coordinate_names=names, angles=q, notes=notes)


def _complete(name: str, columns: Sequence[str], body: Body) -> bool:
    """Whether a coordinate is in the file, and if it is one of a shoulder's three, with the other two."""
    together = {name}
    for ours, _ in shoulders_of(body):
        trio = {body.coordinate_names[k] for k in ours}
        together |= trio if name in trio else set()
    return together <= set(columns)
