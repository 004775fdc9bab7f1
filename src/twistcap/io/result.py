"""The result file: one HDF5 with everything a track produced; its layout is in ``docs/formats/result-file.md``.

Every frame is flushed, so that a killed run keeps what it had. Made with HDF5's oldest format (``libver`` default):
files of ``libver="latest"`` cannot be opened after a kill.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from platform import python_version
from typing import Any

import h5py
import numpy as np

from twistcap.arrays import Bool, Float, Int, UInt8
from twistcap.body import Body, Landmarks, Pose
from twistcap.camera import Camera, Rig
from twistcap.doors.hdf5 import read_hdf5, trust
from twistcap.doors.text import parsed_json
from twistcap.errors import InputError, naming
from twistcap.estimate import Estimate
from twistcap.io.calibration import check_camera
from twistcap.io.result_schema import BODY, HEAD, RIG, frames_of, of_group
from twistcap.se3 import is_motion

FORMAT = "twistcap-result"
FORMAT_VERSION = 3
_ARRAYS = ("parent", "twists", "limits", "segment_joint", "vertices", "faces", "skin_segments", "skin_weights")
_NAMES = ("coordinate_names", "segment_names")
_RIG = ("K", "T_cam_world", "size", "dist")
_FIELDS: Mapping[str, tuple[str, Any]] = {  # datasets of the frames: attribute of an estimate, type
    "index": ("index", "i8"),
    "time": ("time", "f8"),
    "root": ("pose.root", "f8"),
    "q": ("pose.q", "f8"),
    "covariance": ("covariance", "f8"),
    "status": ("status", h5py.string_dtype("ascii", 16)),
    "iterations": ("iterations", "i4"),
    "lost": ("lost", "bool"),
    "support": ("support", "f8"),
    "predicted": ("predicted", h5py.string_dtype("ascii", 20)),
}
_SLOTS = ("0", "1")
_COUNTS = ("ii", "iu", "ui", "uu")  # kinds of two whole numbers
_NONE = -1  # frames of a slot that is empty or being written


@dataclass(frozen=True)
class Result:
    """A result file in memory: N frames of a body with J coordinates, seen by a rig."""

    body: Body  # the tracked body
    rig: Rig  # the cameras as calibrated (full size, with distortion)
    indices: Int  # (N,) frame numbers
    times: Float  # (N,) s
    roots: Float  # (N, 4, 4) root motions
    q: Float  # (N, J) joint coordinates, rad
    covariances: Float  # (N, 6 + J, 6 + J) of the pose step, rad and m
    energies: Mapping[str, Float]  # (N,) by term; NaN where the term was not there
    statuses: tuple[str, ...]  # N words, see `Estimate`
    iterations: Int  # (N,) accepted solver steps
    lost: Bool  # (N,) whether the evidence no longer supported the pose
    support: Float  # (N,) that evidence in [0, 1]
    predicted: tuple[str, ...]  # N words, the source of the pose that each frame started from; see `Estimate`
    config: Mapping[str, Any]  # what the run was configured with, as JSON data
    versions: Mapping[str, str]  # of the programs, by name

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def poses(self) -> tuple[Pose, ...]:
        """N poses."""
        return tuple(Pose(root, q) for root, q in zip(self.roots, self.q, strict=True))

    @cached_property
    def sigmas(self) -> Float:
        """(N, J) standard deviations of the coordinates, rad."""
        return np.sqrt(np.maximum(np.diagonal(self.covariances, axis1=1, axis2=2)[:, 6:], 0.0))

    @cached_property
    def estimates(self) -> tuple[Estimate, ...]:
        """The frames as the tracker gave them."""
        return tuple(
            Estimate(
                index=int(self.indices[n]),
                time=float(self.times[n]),
                pose=pose,
                covariance=self.covariances[n],
                energies={k: float(v[n]) for k, v in self.energies.items() if np.isfinite(v[n])},
                status=self.statuses[n],
                iterations=int(self.iterations[n]),
                lost=bool(self.lost[n]),
                support=float(self.support[n]),
                predicted=self.predicted[n],
            )
            for n, pose in enumerate(self.poses)
        )


class ResultWriter:
    """Writes estimates one by one; what has been appended survives a kill. Use as a context manager."""

    def __init__(self, path: str | Path, body: Body, rig: Rig, config: Mapping[str, Any]) -> None:
        """Start a new file, replacing an old one; its folder must exist.

        `body` and `rig` are as in `Result`, `config` is anything JSON can hold. Raises InputError where the file cannot
        be written.
        """
        self._file = _opened(path, "w")
        self._file.attrs.update(format=FORMAT, format_version=FORMAT_VERSION)
        self._file.attrs["config"] = json.dumps(config, default=str)
        self._file.create_group("versions").attrs.update(installed_versions())
        _write_body(self._file.create_group("body"), body)
        rigs = self._file.create_group("rig")
        _write_strings(rigs, "names", rig.names)
        for name in _RIG:
            rigs[name] = np.array([getattr(camera, name) for camera in rig])
        self._frames: Any = self._file.create_group("frames")
        J = len(body.coordinate_names)
        shapes = {"root": (4, 4), "q": (J,), "covariance": (6 + J, 6 + J)}
        for name, (_, dtype) in _FIELDS.items():
            _create(self._frames, name, shapes.get(name, ()), dtype)
        self._frames.create_group("energies")
        self._count = 0
        self._file.flush()

    @classmethod
    def resume(cls, path: str | Path, frames: int | None = None) -> ResultWriter:
        """Go on after the last complete frame of a file, or after its first `frames`.

        Later frames stay in the file until they are overwritten. Raises InputError for a file that is missing or no
        result.
        """
        read_result(path)
        writer = cls.__new__(cls)
        writer._file = _opened(path, "r+")
        writer._frames = writer._file["frames"]
        complete = _complete(writer._frames)
        for dataset in (*(writer._frames[name] for name in _FIELDS), *writer._frames["energies"].values()):
            dataset.resize(complete, axis=0)
        writer._count = complete if frames is None else min(frames, complete)
        return writer

    def save_state(self, data: UInt8) -> None:
        """Write what the next frame depends on (N,) bytes, and flush.

        Two slots are used in turn, so that a kill in the middle of a write leaves one whole.
        """
        group: Any = self._file.require_group("state")
        slot = min(_SLOTS, key=lambda name: _frames_of(group, name))
        if slot not in group:
            group.create_dataset(slot, (0,), np.uint8, maxshape=(None,), chunks=(1 << 16,))
        dataset = group[slot]
        dataset.attrs["frames"] = _NONE
        dataset.resize(len(data), axis=0)
        dataset[:] = data
        dataset.attrs["crc32"] = zlib.crc32(data.tobytes())
        dataset.attrs["frames"] = self._count
        self._file.flush()

    def __len__(self) -> int:
        return self._count

    def append(self, estimate: Estimate) -> None:
        """Write one frame and flush."""
        for name, (attribute, _) in _FIELDS.items():
            _put(self._frames[name], self._count, attrgetter(attribute)(estimate))
        energies = self._frames["energies"]
        for name in estimate.energies:
            if name not in energies:
                _create(energies, name, (), "f8", fillvalue=np.nan)
        for name, dataset in energies.items():
            _put(dataset, self._count, estimate.energies.get(name, np.nan))
        self._count += 1
        self._file.flush()

    def close(self) -> None:
        """Safe to call twice."""
        if self._file:
            path = self._file.filename
            self._file.close()
            trust(path)

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_result(path: str | Path) -> Result:
    """Read a result file, finished or not: all frames that are complete. Raises InputError for a file that is missing,
    no HDF5, no result, of another format, or holds what no track writes.
    """
    held, source = _held(path), f"result file {path}"
    rows, rig = frames_of(held, source), of_group(held, "rig", RIG, source)
    with naming(path):
        _check_frames(rows)
        return Result(
            body=_body_of(of_group(held, "body", BODY, source)),
            rig=Rig(tuple(_camera_of(source, rig, i) for i in range(len(rig["names"])))),
            indices=rows["index"],
            times=rows["time"],
            roots=rows["root"],
            q=rows["q"],
            covariances=rows["covariance"],
            energies={
                name.removeprefix("energies/"): row for name, row in rows.items() if name.startswith("energies/")
            },
            statuses=tuple(rows["status"].tolist()),
            iterations=rows["iterations"],
            lost=rows["lost"],
            support=rows["support"],
            predicted=tuple(rows["predicted"].tolist()),
            config=_config_of(held, source),
            versions={k.removeprefix("versions@"): str(v) for k, v in held.items() if k.startswith("versions@")},
        )


def read_state(path: str | Path) -> tuple[int, UInt8] | None:
    """The latest state that is whole: how many frames had been written, and its bytes (N,); None where there is none.
    Raises InputError as `read_result`.
    """
    held = _held(path)
    complete = len(frames_of(held, f"result file {path}")["index"])
    slots = [slot for slot in (_slot(held, name) for name in _SLOTS) if slot is not None and 0 <= slot[0] <= complete]
    for frames, crc, data in sorted(slots, key=lambda slot: -slot[0]):
        if zlib.crc32(data.tobytes()) == crc:
            return frames, data
    return None


def _held(path: str | Path) -> dict[str, Any]:
    """All arrays of a file that is a result of this format."""
    held, source = read_hdf5(path, "result file"), f"result file {path}"
    if str(held.get("@format", "")) != FORMAT:
        raise InputError(f"{path} is an HDF5 file, but no twistcap result; give the result.h5 that track wrote.")
    version = int(of_group(held, "", HEAD, source)["@format_version"])
    if version > FORMAT_VERSION:
        raise InputError(f"{path} was written by a newer twistcap (format {version}); update twistcap.")
    if version < FORMAT_VERSION:
        raise InputError(f"{path} was written by an older twistcap (format {version}); track the recording again.")
    return held


def _slot(held: Mapping[str, Any], name: str) -> tuple[int, int, UInt8] | None:
    """Frames, checksum and bytes of a state; None for a slot that is empty or no state."""
    data, frames, crc = (held.get(f"state/{name}{key}") for key in ("", "@frames", "@crc32"))
    if data is None or frames is None or crc is None or data.ndim != 1 or data.dtype != np.uint8:
        return None
    return (int(frames), int(crc), data) if frames.dtype.kind + crc.dtype.kind in _COUNTS and not crc.ndim else None


def _frames_of(states: Any, slot: str) -> int:
    """How many frames had been written when the state of a slot was."""
    return int(states[slot].attrs.get("frames", _NONE)) if slot in states else _NONE


def installed_versions() -> dict[str, str]:
    """Versions of this package and of those that shape its numbers."""
    packages = ("twistcap", "numpy", "scipy", "numba", "opencv-python-headless", "av", "h5py")
    return {"python": python_version(), **{name: version(name) for name in packages}}


def _write_body(group: h5py.Group, body: Body) -> None:
    group.attrs["name"] = body.name
    for name in _NAMES:
        _write_strings(group, name, getattr(body, name))
    for name in _ARRAYS:
        group.create_dataset(name, data=getattr(body, name), compression="gzip")
    marks = group.create_group("landmarks")
    _write_strings(marks, "names", body.landmarks.names)
    marks["segments"], marks["points"] = body.landmarks.segments, body.landmarks.points


def _body_of(held: Mapping[str, Any]) -> Body:
    names: dict[str, Any] = {name: tuple(held[name].tolist()) for name in _NAMES}
    arrays: dict[str, Any] = {name: held[name] for name in _ARRAYS}
    marks = tuple(held["landmarks/names"].tolist()), held["landmarks/segments"], held["landmarks/points"]
    return Body(name=str(held["@name"]), landmarks=Landmarks(*marks), **names, **arrays)


def _camera_of(source: str, held: Mapping[str, Any], i: int) -> Camera:
    size = (int(held["size"][i, 0]), int(held["size"][i, 1]))
    camera = Camera(str(held["names"][i]), held["K"][i], held["T_cam_world"][i], size, held["dist"][i])
    check_camera(f"{source}, camera {camera.name!r}", camera)
    return camera


def _check_frames(rows: Mapping[str, Any]) -> None:
    if np.any(np.diff(rows["index"]) <= 0) or np.any(np.diff(rows["time"]) <= 0):
        raise InputError("frames: their numbers or times do not rise; track the recording again.")
    if not np.all(is_motion(rows["root"])):
        raise InputError("frames: a root is no rigid motion; track the recording again.")


def _config_of(held: Mapping[str, Any], source: str) -> dict[str, Any]:
    config = parsed_json(str(held.get("@config", "")), f"{source}, config")
    if not isinstance(config, dict):
        raise InputError(f"{source}: its config is no table; track the recording again.")
    return config


def _write_strings(group: h5py.Group, name: str, values: tuple[str, ...]) -> None:
    group.create_dataset(name, data=list(values), dtype=h5py.string_dtype())


def _create(group: h5py.Group, name: str, shape: tuple[int, ...], dtype: Any, fillvalue: Any = None) -> None:
    rows = 1 if int(np.prod(shape)) > 256 else 64  # a chunk of about 10 kB
    group.create_dataset(
        name, (0, *shape), maxshape=(None, *shape), chunks=(rows, *(max(s, 1) for s in shape)), dtype=dtype,
        fillvalue=fillvalue,
    )  # fmt: skip


def _put(dataset: h5py.Dataset, row: int, value: Any) -> None:
    if dataset.shape[0] <= row:
        dataset.resize(row + 1, axis=0)
    if 0 not in dataset.shape[1:]:  # a body without joints
        dataset[row] = value


def _complete(frames: Any) -> int:
    """Frames that all datasets hold: a kill may strike between two of them."""
    return min(frames[name].shape[0] for name in _FIELDS)


def _opened(path: str | Path, mode: str) -> h5py.File:
    try:
        # Reading does not lock: a running track may be looked at.
        return h5py.File(path, mode, locking=False) if mode == "r" else h5py.File(path, mode)
    except FileNotFoundError as error:
        missing = "its folder does not exist" if mode == "w" else "it does not exist"
        raise InputError(f"result file {path} cannot be opened: {missing}; check its path.") from error
    except OSError as error:
        action = "read" if mode == "r" else "written"
        raise InputError(f"result file {path} cannot be {action}: it is no HDF5 file, damaged, or in use.") from error
