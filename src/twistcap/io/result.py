"""The result file: one HDF5 with everything a track produced; its layout is in ``docs/formats/result-file.md``.

Every frame is flushed, so that a killed run keeps what it had. Made with HDF5's oldest format (``libver`` default):
files of ``libver="latest"`` cannot be opened after a kill.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np

from twistcap.arrays import AnyArray, Bool, Float, Int, UInt8
from twistcap.body import Body, Landmarks, Pose
from twistcap.camera import Camera, Rig
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.io.state_slots import latest_state, put_state

FORMAT = "twistcap-result"
FORMAT_VERSION = 3
_ARRAYS = (
    "parent", "twists", "limits", "segment_joint", "vertices", "faces", "skin_segments", "skin_weights",
)  # fmt: skip
_NAMES = ("coordinate_names", "segment_names")


@dataclass(frozen=True)
class Result:
    """A result file in memory: N frames of a body with J coordinates, seen by a rig.

    Attributes:
        body, rig: the tracked body; the cameras as calibrated (full size, with distortion).
        indices: (N,) frame numbers.
        times: (N,) s.
        roots: (N, 4, 4) root motions.
        q: (N, J) joint coordinates, rad.
        covariances: (N, 6 + J, 6 + J) of the pose step, rad and m.
        energies: (N,) by term; NaN where the term was not there.
        statuses: N words, see `Estimate`.
        iterations: (N,) accepted solver steps.
        lost: (N,) whether the evidence no longer supported the pose.
        support: (N,) that evidence in [0, 1].
        predicted: N words, the source of the pose that each frame started from; see `Estimate`.
        config: what the run was configured with, as JSON data.
        versions: of the programs, by name.
    """

    body: Body
    rig: Rig
    indices: Int
    times: Float
    roots: Float
    q: Float
    covariances: Float
    energies: Mapping[str, Float]
    statuses: tuple[str, ...]
    iterations: Int
    lost: Bool
    support: Float
    predicted: tuple[str, ...]
    config: Mapping[str, Any]
    versions: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.times)

    @property
    def poses(self) -> tuple[Pose, ...]:
        """N poses."""
        return self._poses

    @cached_property
    def _poses(self) -> tuple[Pose, ...]:
        return tuple(Pose(root, q) for root, q in zip(self.roots, self.q, strict=True))

    @cached_property
    def estimates(self) -> tuple[Estimate, ...]:
        """The frames as the tracker gave them."""
        return tuple(self._estimate(n) for n in range(len(self)))

    def _estimate(self, n: int) -> Estimate:
        return Estimate(
            index=int(self.indices[n]),
            time=float(self.times[n]),
            pose=self.poses[n],
            covariance=self.covariances[n],
            energies={k: float(v[n]) for k, v in self.energies.items() if np.isfinite(v[n])},
            status=self.statuses[n],
            iterations=int(self.iterations[n]),
            lost=bool(self.lost[n]),
            support=float(self.support[n]),
            predicted=self.predicted[n],
        )


class ResultWriter:
    """Writes estimates one by one; what has been appended survives a kill. Use as a context manager."""

    def __init__(
        self,
        path: str | Path,
        body: Body,
        rig: Rig,
        config: Mapping[str, Any],
        versions: Mapping[str, str] | None = None,
    ) -> None:
        """Start a new file, replacing an old one.

        Args:
            path: of the file; its folder must exist.
            body, rig: as in `Result`.
            config: anything JSON can hold.
            versions: of the programs; None asks `installed_versions`.

        Raises InputError where the file cannot be written.
        """
        self._file = _opened(path, "w")
        self._file.attrs.update(format=FORMAT, format_version=FORMAT_VERSION)
        self._file.attrs["config"] = json.dumps(config, default=str)
        for name, version in (versions if versions is not None else installed_versions()).items():
            self._file.require_group("versions").attrs[name] = version
        write_body(self._file.create_group("body"), body)
        _write_rig(self._file.create_group("rig"), rig)
        self._frames: h5py.Group = self._file.create_group("frames")
        for name, shape, dtype in _frame_fields(len(body.coordinate_names)):
            _create(self._frames, name, shape, dtype)
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
        writer._frames = _group(writer._file, "frames")
        complete = _complete(writer._frames)
        for dataset in _datasets(writer._frames):
            dataset.resize(complete, axis=0)
        writer._count = complete if frames is None else min(frames, complete)
        return writer

    def save_state(self, data: UInt8) -> None:
        """Write what the next frame depends on (N,) bytes, and flush.

        Two slots are used in turn, so that a kill in the middle of a write leaves one whole.
        """
        put_state(self._file.require_group("state"), data, self._count)
        self._file.flush()

    def __len__(self) -> int:
        return self._count

    def append(self, estimate: Estimate) -> None:
        """Write one frame and flush."""
        values: dict[str, Any] = {name: get(estimate) for name, get in _GETTERS.items()}
        for name, value in values.items():
            _put(_dataset(self._frames, name), self._count, value)
        self._put_energies(estimate.energies)
        self._count += 1
        self._file.flush()

    def close(self) -> None:
        """Safe to call twice."""
        self._file.close()

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _put_energies(self, energies: Mapping[str, float]) -> None:
        group = _group(self._frames, "energies")
        for name in energies:
            if name not in group:
                _create(group, name, (), np.dtype(float), fillvalue=np.nan)
        for dataset in _datasets(group):
            _put(dataset, self._count, energies.get(str(dataset.name).rsplit("/", 1)[-1], np.nan))


def read_result(path: str | Path) -> Result:
    """Read a result file, finished or not: all frames that are complete.

    Raises InputError for a file that is missing, no HDF5, no result or of a newer format.
    """
    with _opened(path, "r") as file:
        _check_format(path, file)
        frames = _group(file, "frames")
        n = _complete(frames)
        get: Callable[[str], AnyArray] = lambda name: np.asarray(_dataset(frames, name)[:n])  # noqa: E731
        return Result(
            body=read_body(_group(file, "body")),
            rig=_read_rig(_group(file, "rig")),
            indices=get("index").astype(np.int32),
            times=get("time"),
            roots=get("root"),
            q=get("q"),
            covariances=get("covariance"),
            energies=_energies(frames, n),
            statuses=tuple(s.decode() for s in get("status")),
            iterations=get("iterations").astype(np.int32),
            lost=get("lost").astype(bool),
            support=get("support"),
            predicted=tuple(s.decode() for s in get("predicted")),
            config=json.loads(str(file.attrs["config"])),
            versions={k: str(v) for k, v in _group(file, "versions").attrs.items()} if "versions" in file else {},
        )


def read_state(path: str | Path) -> tuple[int, UInt8] | None:
    """The latest state that is whole: how many frames had been written, and its bytes (N,); None where there is none.

    Raises InputError as `read_result`.
    """
    with _opened(path, "r") as file:
        _check_format(path, file)
        complete = _complete(_group(file, "frames"))
        return latest_state(_group(file, "state"), complete) if "state" in file else None


def installed_versions() -> dict[str, str]:
    """Versions of this package and of those that shape its numbers."""
    from importlib.metadata import version
    from platform import python_version

    packages = ("twistcap", "numpy", "scipy", "numba", "opencv-python-headless", "av", "h5py")
    return {"python": python_version(), **{name: version(name) for name in packages}}


def write_body(group: h5py.Group, body: Body) -> None:
    """Store a body completely, as arrays."""
    group.attrs["name"] = body.name
    for name in _NAMES:
        group.create_dataset(name, data=list(getattr(body, name)), dtype=h5py.string_dtype())
    for name in _ARRAYS:
        group.create_dataset(name, data=getattr(body, name), compression="gzip")
    marks = group.create_group("landmarks")
    marks.create_dataset("names", data=list(body.landmarks.names), dtype=h5py.string_dtype())
    marks.create_dataset("segments", data=body.landmarks.segments)
    marks.create_dataset("points", data=body.landmarks.points)


def read_body(group: h5py.Group) -> Body:
    """The body that `write_body` stored."""
    arrays: dict[str, Any] = {name: np.asarray(_dataset(group, name)[()]) for name in _ARRAYS}
    marks = _group(group, "landmarks")
    landmarks = Landmarks(
        _strings(_dataset(marks, "names")),
        np.asarray(_dataset(marks, "segments")[()]),
        np.asarray(_dataset(marks, "points")[()]),
    )
    names: dict[str, Any] = {name: _strings(_dataset(group, name)) for name in _NAMES}
    return Body(name=str(group.attrs["name"]), landmarks=landmarks, **names, **arrays)


def _write_rig(group: h5py.Group, rig: Rig) -> None:
    group.create_dataset("names", data=list(rig.names), dtype=h5py.string_dtype())
    for name in ("K", "T_cam_world", "size", "dist"):
        group.create_dataset(name, data=np.array([getattr(camera, name) for camera in rig]))


def _read_rig(group: h5py.Group) -> Rig:
    K, T, size, dist = (np.asarray(_dataset(group, name)[()]) for name in ("K", "T_cam_world", "size", "dist"))
    names = _strings(_dataset(group, "names"))
    return Rig(tuple(Camera(n, K[i], T[i], (int(size[i, 0]), int(size[i, 1])), dist[i]) for i, n in enumerate(names)))


_GETTERS: Mapping[str, Callable[[Estimate], Any]] = {
    "index": lambda e: e.index,
    "time": lambda e: e.time,
    "root": lambda e: e.pose.root,
    "q": lambda e: e.pose.q,
    "covariance": lambda e: e.covariance,
    "status": lambda e: e.status,
    "iterations": lambda e: e.iterations,
    "lost": lambda e: e.lost,
    "support": lambda e: e.support,
    "predicted": lambda e: e.predicted,
}


def _frame_fields(J: int) -> tuple[tuple[str, tuple[int, ...], Any], ...]:
    return (
        ("index", (), np.dtype("i8")),
        ("time", (), np.dtype("f8")),
        ("root", (4, 4), np.dtype("f8")),
        ("q", (J,), np.dtype("f8")),
        ("covariance", (6 + J, 6 + J), np.dtype("f8")),
        ("status", (), h5py.string_dtype("ascii", 16)),
        ("iterations", (), np.dtype("i4")),
        ("lost", (), np.dtype("bool")),
        ("support", (), np.dtype("f8")),
        ("predicted", (), h5py.string_dtype("ascii", 20)),
    )


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


def _complete(frames: h5py.Group) -> int:
    """Frames that all datasets hold: a kill may strike between two of them."""
    return min(_dataset(frames, name).shape[0] for name in _GETTERS)


def _energies(frames: h5py.Group, n: int) -> dict[str, Float]:
    out: dict[str, Float] = {}
    for name, dataset in _group(frames, "energies").items():
        out[name] = np.full(n, np.nan)
        held = np.asarray(dataset[:n])
        out[name][: len(held)] = held
    return out


def _datasets(group: h5py.Group) -> list[h5py.Dataset]:
    out: list[h5py.Dataset] = []
    group.visititems(lambda _, item: out.append(item) if isinstance(item, h5py.Dataset) else None)
    return out


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


def _check_format(path: str | Path, file: h5py.File) -> None:
    if file.attrs.get("format") != FORMAT or "frames" not in file:
        raise InputError(f"{path} is an HDF5 file, but no twistcap result; give the result.h5 that track wrote.")
    version = int(str(file.attrs["format_version"]))
    if version > FORMAT_VERSION:
        raise InputError(f"{path} was written by a newer twistcap (format {version}); update twistcap.")
    if version < FORMAT_VERSION:
        raise InputError(f"{path} was written by an older twistcap (format {version}); track the recording again.")


def _group(parent: h5py.Group, name: str) -> h5py.Group:
    item = parent[name]
    assert isinstance(item, h5py.Group)
    return item


def _dataset(parent: h5py.Group, name: str) -> h5py.Dataset:
    item = parent[name]
    assert isinstance(item, h5py.Dataset)
    return item


def _strings(dataset: h5py.Dataset) -> tuple[str, ...]:
    return tuple(s.decode() if isinstance(s, bytes) else str(s) for s in dataset[()])
