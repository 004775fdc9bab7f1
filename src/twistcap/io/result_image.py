"""The bytes of a result file with room for more frames.

HDF5 makes them in memory, once. All frames lie in datasets of fixed size and place, so that frames are written into
the finished file with plain writes: nothing of HDF5's own tables changes any more, and a kill or a full disk cannot
damage them.
"""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from operator import attrgetter
from platform import python_version
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from twistcap.arrays import AnyArray, Bool, UInt8
from twistcap.body import Body
from twistcap.estimate import Estimate
from twistcap.io.result_schema import COLUMNS

if TYPE_CHECKING:
    from twistcap.io.result import Result

FORMAT = "twistcap-result"
FORMAT_VERSION = 9
BODY_ARRAYS = ("parent", "twists", "limits", "segment_joint", "vertices", "faces", "skin_segments", "skin_weights")
BODY_NAMES = ("coordinate_names", "segment_names")
RIG_ARRAYS = ("K", "T_cam_world", "size", "dist")
CAMERAS = ("left_out", "missing")
"""Datasets that say of each camera whether an estimate names it."""
SLOTS = ("0", "1")
NONE = -1
"""The index of a frame, and the frames of a state, that have not been written."""


@dataclass(frozen=True)
class Place:
    """Where the rows of a dataset lie in the file."""

    offset: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]  # of a row

    @property
    def row_bytes(self) -> int:
        return self.dtype.itemsize * int(np.prod(self.shape))

    def of(self, row: int) -> int:
        """Where a row begins."""
        return self.offset + row * self.row_bytes

    def bytes_of(self, value: Any) -> bytes:
        """A row. Raises ValueError for a value of another shape."""
        array = np.asarray(value, self.dtype)
        if array.shape != self.shape:
            raise ValueError(f"a row of shape {array.shape} does not fit one of shape {self.shape}.")
        return array.tobytes()


def value_of(estimate: Estimate, name: str, shape: tuple[int, ...]) -> Any:
    """What a row of that shape holds of an estimate; NaN for what is not known."""
    value = attrgetter(COLUMNS[name].of_estimate)(estimate)
    if name in CAMERAS:
        return np.isin(np.arange(shape[0]), value)
    if name == "sources":
        return value or np.arange(shape[0])
    if value is None:
        return np.zeros(shape) if name == "bumps" else np.full(shape, np.nan)
    return value


def named(flags: Bool) -> tuple[int, ...]:
    """Numbers of the cameras that a row (C,) of `CAMERAS` names."""
    return tuple(np.flatnonzero(flags).tolist())


@dataclass(frozen=True)
class Image:
    """A whole result file.

    Attributes:
        data: its bytes.
        places: of what is written later, by dataset (``frames/q``).
    """

    data: memoryview
    places: Mapping[str, Place]


def image_of(result: Result, capacity: int, energies: Sequence[str], state: tuple[int, UInt8], slot: int) -> Image:
    """A file of a result.

    Args:
        result: head and frames.
        capacity: frames that have room; at least those of the result.
        energies: names of all terms.
        state: how many frames had been written when it was saved (`NONE` where there is none), and its bytes (n,).
        slot: bytes of each slot for states, at least those of the state.
    """
    buffer = _Bytes()
    with h5py.File(buffer, "w", libver="earliest") as file:
        _write_head(file, result)
        places = _write_frames(file.create_group("frames"), result, capacity, energies)
        places |= _write_states(file.create_group("state"), state, slot)
    return Image(buffer.getbuffer(), places)


class _Bytes(io.BytesIO):
    """A file in memory that is as long as asked: HDF5 does not write what lies at its end and is not set."""

    def truncate(self, size: int | None = None, /) -> int:
        if size is not None and size > (length := self.getbuffer().nbytes):
            self.seek(length)
            self.write(bytes(size - length))
        return super().truncate(size)


def state_row(frames: int, data: UInt8) -> AnyArray:
    """(3,) what is written of a state beside it: frames written until then, bytes, CRC-32."""
    return np.array([frames, len(data), zlib.crc32(data.tobytes())], np.int64)


def installed_versions() -> dict[str, str]:
    """Versions of this package and of those that shape its numbers."""
    packages = ("twistcap", "numpy", "scipy", "numba", "opencv-python-headless", "av", "h5py")
    return {"python": python_version(), **{name: version(name) for name in packages}}


def _write_head(file: h5py.File, result: Result) -> None:
    file.attrs.update(format=FORMAT, format_version=FORMAT_VERSION)
    file.attrs["config"] = json.dumps(result.config, default=str)
    file.attrs["recording"] = json.dumps(result.recording)
    file.create_group("versions").attrs.update(result.versions)
    _write_body(file.create_group("body"), result.body)
    rig = file.create_group("rig")
    _write_strings(rig, "names", result.rig.names)
    for name in RIG_ARRAYS:
        rig[name] = np.array([getattr(camera, name) for camera in result.rig])
    if any(camera.fisheye for camera in result.rig):  # older versions read all other results
        rig["fisheye"] = np.array([camera.fisheye for camera in result.rig])


def _write_body(group: h5py.Group, body: Body) -> None:
    group.attrs["name"] = body.name
    for name in BODY_NAMES:
        _write_strings(group, name, getattr(body, name))
    for name in BODY_ARRAYS:
        group.create_dataset(name, data=getattr(body, name), compression="gzip")
    marks = group.create_group("landmarks")
    _write_strings(marks, "names", body.landmarks.names)
    marks["segments"], marks["points"] = body.landmarks.segments, body.landmarks.points


def _write_strings(group: h5py.Group, name: str, values: tuple[str, ...]) -> None:
    group.create_dataset(name, data=list(values), dtype=h5py.string_dtype())


def _write_frames(group: h5py.Group, result: Result, capacity: int, energies: Sequence[str]) -> dict[str, Place]:
    places: dict[str, Place] = {}
    for name, column in COLUMNS.items():
        held = np.asarray(getattr(result, column.of_result), column.stored)
        fill = NONE if name == "index" else None
        places[f"frames/{name}"] = _fixed(group, name, (capacity, *held.shape[1:]), column.stored, held, fill)
    terms = group.create_group("energies")
    for name in energies:
        held = result.energies.get(name, np.full(len(result), np.nan))
        places[f"frames/energies/{name}"] = _fixed(terms, name, (capacity,), "f8", held, np.nan)
    return places


def _write_states(group: h5py.Group, state: tuple[int, UInt8], slot: int) -> dict[str, Place]:
    """The state goes to the first slot, the second is empty."""
    about = np.stack([state_row(*state), state_row(NONE, state[1][:0])])
    places = {"state/about": _fixed(group, "about", about.shape, "i8", about)}
    for name, held in zip(SLOTS, (state[1], state[1][:0]), strict=True):
        places[f"state/{name}"] = _fixed(group, name, (slot,), "u1", held)
    return places


def _fixed(group: h5py.Group, name: str, shape: tuple[int, ...], dtype: Any, held: AnyArray, fill: Any = None) -> Place:
    """A dataset in one piece whose first rows are given."""
    settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    settings.set_layout(h5py.h5d.CONTIGUOUS)
    settings.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    dataset = group.create_dataset(name, shape, dtype, dcpl=settings, fillvalue=fill)
    if held.size:
        dataset[: len(held)] = held
    offset = dataset.id.get_offset() if dataset.size else 0
    return Place(offset, dataset.dtype, shape[1:])
