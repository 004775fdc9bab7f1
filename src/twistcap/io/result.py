"""The result file: one HDF5 with everything a track produced; its layout is in ``docs/formats/result-file.md``.

Every frame is in the file before the next is tracked, and the file is whole at any time; see `result_image`.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import Bool, Float, Int, UInt8
from twistcap.body import Body, Landmarks, Pose, Posed
from twistcap.camera import Camera, Rig
from twistcap.doors.hdf5 import read_hdf5, trust
from twistcap.doors.schema import flag
from twistcap.doors.text import parsed_json
from twistcap.errors import InputError, naming
from twistcap.estimate import UNSEEN, Estimate
from twistcap.io.calibration import check_camera
from twistcap.io.files import replacing, unwritable, write_at
from twistcap.io.lock import WriteLock
from twistcap.io.result_image import (
    BODY_ARRAYS,
    BODY_NAMES,
    FORMAT,
    FORMAT_VERSION,
    NONE,
    SLOTS,
    image_of,
    installed_versions,
    named,
    state_row,
    value_of,
)
from twistcap.io.result_schema import BODY, COLUMNS, HEAD, RIG, STATE, check_frames, frames_of, of_group

_LEAST_ROOM = 64  # frames, where nobody has said how many will come
PLANNED = "planned frames"  # in `Result.recording`: how many the run had to track
_WHOLE = ("body", "rig", "config", "versions", "recording")  # of a result, what has no row for each frame


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
    probability: Float  # (N,) of being lost
    part_probability: Float  # (N, S) the same of each segment's limb; NaN where nothing was seen
    left_out: Bool  # (N, C) cameras that were not believed
    missing: Bool  # (N, C) cameras that showed nothing, or nothing new
    bumps: Float  # (N, C, 3) turns of the cameras from where they are calibrated, rad; see `Estimate`
    sources: Int  # (N, C) under which camera's name each camera's picture came
    relit: Bool  # (N,) whether all pictures changed, as by another light
    brightness: Float  # (N, C) mean of each camera's picture, 0 to 1; NaN where none was looked at
    predicted: tuple[str, ...]  # N words, the source of the pose that each frame started from; see `Estimate`
    config: Mapping[str, Any]  # what the run was configured with, as JSON data
    versions: Mapping[str, str]  # of the programs, by name
    recording: Mapping[str, Any] = field(default_factory=dict[str, Any])  # tracked in, see `provenance.made_of`

    @staticmethod
    def without_frames(
        body: Body, rig: Rig, config: Mapping[str, Any], versions: Mapping[str, str], recording: Mapping[str, Any]
    ) -> Result:
        """Before the first frame."""
        J, S, none = len(body.coordinate_names), len(body.segment_names), np.zeros(0)
        parts, cameras, bumps = np.zeros((0, S)), np.zeros((0, len(rig)), np.bool_), np.zeros((0, len(rig), 3))
        roots, covariances = np.zeros((0, 4, 4)), np.zeros((0, 6 + J, 6 + J))
        return Result(
            body, rig, none.astype(np.int32), none, roots, np.zeros((0, J)), covariances, {}, (), none.astype(np.int32),
            none.astype(np.bool_), none, none, parts, cameras, cameras, bumps,
            cameras.astype(np.int32), none.astype(np.bool_), np.zeros(cameras.shape), (), config, versions, recording,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.times)

    @property
    def unfinished(self) -> str:
        """`holds 18 of 60 frames` of a track that was stopped before its end; empty otherwise."""
        planned = self.recording.get(PLANNED, 0)
        return f"holds {len(self)} of {planned} frames" if isinstance(planned, int) and planned > len(self) else ""

    @cached_property
    def known(self) -> Bool:
        """(N,) whether images support the pose: neither lost nor predicted without them."""
        return ~self.lost & ~np.isin(self.statuses, UNSEEN)

    @cached_property
    def swapped(self) -> Bool:
        """(N, C) cameras whose pictures came under other names."""
        return np.asarray(self.sources != np.arange(len(self.rig)), np.bool_)

    def within(self, first: int, last: int) -> Result:
        """The frames of a range of frame numbers, both included."""
        n = np.flatnonzero((self.indices >= first) & (self.indices <= last))

        def chosen(rows: Any) -> Any:
            if isinstance(rows, Mapping):
                return {name: row[n] for name, row in rows.items()}
            return tuple(rows[k] for k in n) if isinstance(rows, tuple) else rows[n]

        each = [f.name for f in fields(self) if f.name not in _WHOLE]
        kept = {key: value for key, value in self.recording.items() if key != PLANNED}  # a part has no end to reach
        return replace(self, recording=kept, **{name: chosen(getattr(self, name)) for name in each})

    @cached_property
    def poses(self) -> tuple[Pose, ...]:
        """N poses."""
        return tuple(Pose(root, q) for root, q in zip(self.roots, self.q, strict=True))

    @cached_property
    def landmarks(self) -> Float:
        """(N, L, 3) landmarks of the body, m."""
        return np.array([Posed(self.body, pose).landmarks for pose in self.poses]).reshape(len(self), -1, 3)

    @cached_property
    def sigmas(self) -> Float:
        """(N, J) standard deviations of the coordinates, rad."""
        return np.sqrt(np.maximum(np.diagonal(self.covariances, axis1=1, axis2=2)[:, 6:], 0.0))

    @cached_property
    def estimates(self) -> tuple[Estimate, ...]:
        """The frames as the tracker gave them."""
        return tuple(
            Estimate(
                index=int(self.indices[n]), time=float(self.times[n]), pose=pose, covariance=self.covariances[n],
                energies={k: float(v[n]) for k, v in self.energies.items() if np.isfinite(v[n])},
                status=self.statuses[n], iterations=int(self.iterations[n]), lost=bool(self.lost[n]),
                support=float(self.support[n]), predicted=self.predicted[n], probability=float(self.probability[n]),
                part_probability=None if np.isnan(self.part_probability[n]).all() else self.part_probability[n],
                left_out=named(self.left_out[n]), missing=named(self.missing[n]),
                bumps=self.bumps[n] if np.any(self.bumps[n]) else None,
                sources=tuple(self.sources[n].tolist()) if self.swapped[n].any() else (), relit=bool(self.relit[n]),
                brightness=None if np.isnan(self.brightness[n]).all() else self.brightness[n],
            )
            for n, pose in enumerate(self.poses)
        )  # fmt: skip


class ResultWriter:
    """Writes estimates one by one; what has been appended survives a kill and a full disk. Use as a context manager.

    The file always is a whole HDF5 file: a frame is written in its place, its index last. Where there is no room for
    it, a file with more room is made beside and takes its place.
    """

    def __init__(
        self, path: str | Path, body: Body, rig: Rig, config: Mapping[str, Any],
        recording: Mapping[str, Any] | None = None, room: int = 0, lock: WriteLock | None = None,
    ) -> None:  # fmt: skip
        """Start a new file, replacing an old one; its folder must exist.

        Args:
            path: of the file.
            body, rig: as in `Result`.
            config: anything JSON can hold.
            recording: what `provenance.made_of` says.
            room: frames that will be written, as far as it is known; the disk must have room for them.
            lock: of the file, where it has been taken already.

        Raises InputError where the file cannot be written, or another process is writing it.
        """
        result = Result.without_frames(body, rig, config, installed_versions(), recording or {})
        self._begin(path, result, None, None, room, lock)

    @classmethod
    def resume(
        cls, path: str | Path, frames: int | None = None, room: int = 0, lock: WriteLock | None = None
    ) -> ResultWriter:
        """Go on after the last complete frame of a file, or after its first `frames`.

        Later frames stay in the file until they are overwritten. Raises InputError for a file that is missing or no
        result, or that another process is writing.
        """
        writer = cls.__new__(cls)
        writer._begin(path, *_result_and_state(path), frames, room, lock)
        return writer

    def _begin(
        self, path: str | Path, result: Result, state: tuple[int, UInt8] | None, frames: int | None, room: int,
        lock: WriteLock | None,
    ) -> None:  # fmt: skip
        self.path, self._room, self._descriptor = Path(path), room, None
        self._held = len(result)  # frames in the file; after `resume` some of them are overwritten by the same
        self._count = self._held if frames is None else min(frames, self._held)
        self._own_lock = WriteLock(path) if lock is None else None
        if result.recording and room:
            result = replace(result, recording={**result.recording, PLANNED: room})
        try:
            self._rebuild(result, state, self._held and max(self._held, room), result.energies)
        except InputError:
            self.close()
            raise

    def __len__(self) -> int:
        return self._count

    def save_state(self, data: UInt8) -> None:
        """Write what the next frame depends on (N,) bytes.

        Two slots are used in turn, so that a kill in the middle of a write leaves one whole.
        """
        if len(data) > self._slot_bytes:
            self._rebuild(self._written()[0], (self._count, data), self._capacity, self._energies)
            return
        slot, self._slot = self._slot, 1 - self._slot
        self._put("state/about", slot, state_row(NONE, data))
        self._write(data.tobytes(), self._places[f"state/{SLOTS[slot]}"].offset)
        self._put("state/about", slot, state_row(self._count, data))

    def append(self, estimate: Estimate) -> None:
        """Write one frame. Raises InputError where the disk is full."""
        self._put_row(self._count, estimate)
        self._count += 1
        self._held = max(self._held, self._count)

    def correct(self, estimates: Sequence[Estimate]) -> None:
        """Write those before the last frame anew, the oldest first. Raises InputError where the disk is full."""
        for row, estimate in enumerate(estimates, self._count - 1 - len(estimates)):
            self._put_row(row, estimate)

    def _put_row(self, row: int, estimate: Estimate) -> None:
        if row == self._capacity or not estimate.energies.keys() <= set(self._energies):
            names = dict.fromkeys((*self._energies, *estimate.energies))
            self._rebuild(*self._written(), self._wanted_room(), names)
        for name in self._energies:
            self._put(f"frames/energies/{name}", row, estimate.energies.get(name, np.nan))
        for name in COLUMNS:
            shape = self._places[f"frames/{name}"].shape
            self._put(f"frames/{name}", row, value_of(estimate, name, shape))

    def _wanted_room(self) -> int:
        """Frames that have room from now on."""
        if self._count < self._capacity:
            return self._capacity
        return self._room if self._count < self._room else max(2 * self._capacity, _LEAST_ROOM)

    def close(self) -> None:
        """Without room that was not used. Safe to call twice."""
        if self._descriptor is not None:
            if self._held < self._capacity:
                with suppress(InputError):  # on a full disk the file stays as it is, which is as good
                    self._rebuild(*self._written(), self._held, self._energies)
            os.close(self._descriptor)
            self._descriptor = None
            self._trust()
        if self._own_lock is not None:
            self._own_lock.release()

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _trust(self) -> None:
        with suppress(OSError):  # somebody has removed it
            trust(self.path)

    def _written(self) -> tuple[Result, tuple[int, UInt8] | None]:
        """What this writer has written so far."""
        self._trust()
        return _result_and_state(self.path)

    def _rebuild(self, result: Result, state: tuple[int, UInt8] | None, capacity: int, energies: Iterable[str]) -> None:
        """A file of the same, with another capacity, and room for the state to grow, in the place of the old one."""
        state = state or (NONE, np.zeros(0, np.uint8))
        slot = len(state[1]) * 5 // 4
        image = image_of(result, capacity, tuple(energies), state, slot)
        with replacing(self.path, "result file") as part:
            descriptor = os.open(part, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
            try:
                write_at(descriptor, image.data, 0)
                os.fsync(descriptor)
            except BaseException:
                os.close(descriptor)
                raise
        if self._descriptor is not None:
            os.close(self._descriptor)
        self._descriptor, self._places = descriptor, image.places
        self._capacity, self._energies, self._slot_bytes = capacity, tuple(energies), slot
        self._slot = 1 if state[0] >= 0 else 0

    def _put(self, name: str, row: int, value: Any) -> None:
        place = self._places[name]
        self._write(place.bytes_of(value), place.of(row))

    def _write(self, data: bytes, offset: int) -> None:
        assert self._descriptor is not None, "the writer is closed"
        try:
            write_at(self._descriptor, data, offset)
        except OSError as error:
            raise unwritable(self.path, error, "result file") from error


def read_result(path: str | Path) -> Result:
    """Read a result file, finished or not: all frames that are complete. Raises InputError for a file that is missing,
    no HDF5, no result, of another format, or holds what no track writes.
    """
    return _result_of(path, _held(path))


def read_state(path: str | Path) -> tuple[int, UInt8] | None:
    """The latest whole state: frames that had been written, and its bytes (N,). Raises InputError as `read_result`."""
    return _state_of(path, _held(path))


def _result_and_state(path: str | Path) -> tuple[Result, tuple[int, UInt8] | None]:
    """Both, of a file that is read once."""
    held = _held(path)
    return _result_of(path, held), _state_of(path, held)


def _result_of(path: str | Path, held: Mapping[str, Any]) -> Result:
    source = f"result file {path}"
    lenses = {"fisheye": flag("C")} if "rig/fisheye" in held else {}
    rows, rig = frames_of(held, source), of_group(held, "rig", {**RIG, **lenses}, source)
    with naming(path):
        body = _body_of(of_group(held, "body", BODY, source))
        check_frames(rows, len(body.coordinate_names), len(body.segment_names), len(rig["names"]))
        columns = {column.of_result: rows[name] for name, column in COLUMNS.items()}
        columns |= {name: tuple(columns[name].tolist()) for name in ("statuses", "predicted")}
        return Result(
            body=body, rig=Rig(tuple(_camera_of(source, rig, i) for i in range(len(rig["names"])))),
            energies={k.removeprefix("energies/"): row for k, row in rows.items() if k.startswith("energies/")},
            config=_table_of(held, "config", source),
            versions={k.removeprefix("versions@"): str(v) for k, v in held.items() if k.startswith("versions@")},
            recording=_table_of(held, "recording", source), **columns,
        )  # fmt: skip


def _state_of(path: str | Path, held: Mapping[str, Any]) -> tuple[int, UInt8] | None:
    source = f"result file {path}"
    complete, about = len(frames_of(held, source)["index"]), of_group(held, "state", STATE, source)["about"]
    for slot in np.argsort(-about[:, 0]):
        frames, size, checksum = map(int, about[slot])
        data = np.ravel(held.get(f"state/{SLOTS[slot]}", np.zeros(0)))[:size]
        if 0 <= frames <= complete and data.dtype == np.uint8 and zlib.crc32(data.tobytes()) == checksum:
            return frames, data
    return None


def _held(path: str | Path) -> dict[str, Any]:
    """All arrays of a file that is a result of this format."""
    held, source = read_hdf5(path), f"result file {path}"
    if str(held.get("@format", "")) != FORMAT:
        raise InputError(f"{path} is an HDF5 file, but no twistcap result; give the result.h5 that track wrote.")
    version = int(of_group(held, "", HEAD, source)["@format_version"])
    if version > FORMAT_VERSION:
        raise InputError(f"{path} was written by a newer twistcap (format {version}); update twistcap.")
    if version < FORMAT_VERSION:
        raise InputError(f"{path} was written by an older twistcap (format {version}); track the recording again.")
    return held


def _body_of(held: Mapping[str, Any]) -> Body:
    names: dict[str, Any] = {name: tuple(held[name].tolist()) for name in BODY_NAMES}
    arrays: dict[str, Any] = {name: held[name] for name in BODY_ARRAYS}
    marks = tuple(held["landmarks/names"].tolist()), held["landmarks/segments"], held["landmarks/points"]
    return Body(name=str(held["@name"]), landmarks=Landmarks(*marks), **names, **arrays)


def _camera_of(source: str, held: Mapping[str, Any], i: int) -> Camera:
    size = (int(held["size"][i, 0]), int(held["size"][i, 1]))
    fisheye = bool(held["fisheye"][i]) if "fisheye" in held else False
    camera = Camera(str(held["names"][i]), held["K"][i], held["T_cam_world"][i], size, held["dist"][i], fisheye)
    check_camera(f"{source}, camera {camera.name!r}", camera)
    return camera


def _table_of(held: Mapping[str, Any], name: str, source: str) -> dict[str, Any]:
    table = parsed_json(str(held.get(f"@{name}", "{}")), f"{source}, {name}")
    if not isinstance(table, dict):
        raise InputError(f"{source}: its {name} is no table; track the recording again.")
    return table
