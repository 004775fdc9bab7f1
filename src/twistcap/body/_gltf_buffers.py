"""Reading and writing arrays of glTF buffers."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pygltflib as gl
from scipy.spatial.transform import Rotation

from twistcap.arrays import AnyArray, Float
from twistcap.body.rig_spec import RigSpec
from twistcap.doors.text import brief, read_bytes
from twistcap.errors import InputError, check

_TYPES: dict[int, type[np.generic]] = {
    5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32,
}  # fmt: skip
_CODES = {np.dtype(kind): code for code, kind in _TYPES.items()}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TO_REST = RigSpec().to_rest()  # (3, 3) from glTF's axes to ours: a cyclic permutation, exact
EXTRAS = "twistcap"  # key of our own data in extras
LARGEST_BUFFER = 1 << 29  # bytes
_GREATEST = 1e9  # of a value: a place in any unit, or an index
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


class Buffers:
    """Reads accessors of one file as float64 arrays."""

    def __init__(self, gltf: gl.GLTF2, path: Path) -> None:
        self.gltf, self.path = gltf, path
        self._data: dict[int, bytes] = {}

    def accessor(self, number: int, where: str) -> Float:
        """(N, width) values of an accessor; normalised integers are scaled to [0, 1] or [-1, 1]. Raises InputError for
        an accessor that is missing, sparse, exceeds its buffer, or has values that are not finite.
        """
        try:
            entry = dict(enumerate(self.gltf.accessors))[number]  # no negative numbers here
            if entry.sparse is not None or entry.bufferView is None:
                raise InputError(f"{self.path}: {where}: sparse accessors cannot be read; export it without.")
            view = dict(enumerate(self.gltf.bufferViews))[entry.bufferView]
            kind, width = np.dtype(_TYPES[entry.componentType]).newbyteorder("<"), _WIDTHS[entry.type]
        except (KeyError, TypeError) as error:
            raise InputError(f"{self.path}: {where}: accessor {number} is missing or of an unknown type.") from error
        start, stride = (view.byteOffset or 0) + (entry.byteOffset or 0), view.byteStride or kind.itemsize * width
        data = self._buffer(view.buffer, where)
        whole = all(isinstance(n, int) and n >= 0 for n in (start, stride, entry.count))
        if not whole or start + (entry.count - 1) * stride + kind.itemsize * width > len(data):
            raise InputError(f"{self.path}: {where}: accessor {number} runs past the end of its buffer.")
        raw = np.ndarray((entry.count, width), kind, data, start, (stride, kind.itemsize)).astype(np.float64)
        within = np.all(np.abs(raw) < _GREATEST)
        check(f"{self.path}: {where}", within, f"a value is not finite, or beyond {_GREATEST:g}")
        return np.maximum(raw / np.iinfo(kind.name).max, -1.0) if entry.normalized and kind.kind != "f" else raw

    def _buffer(self, number: int, where: str) -> bytes:
        if number not in self._data:
            self._data[number] = self._read(number, where)
        return self._data[number]

    def _read(self, number: int, where: str) -> bytes:
        uri = self.gltf.buffers[number].uri if 0 <= number < len(self.gltf.buffers) else ""
        if uri is None:
            blob: Any = self.gltf.binary_blob()
            if blob is None:
                raise InputError(f"{self.path}: {where}: buffer {number} has no data.")
            return bytes(blob)
        try:
            if uri.startswith("data:"):
                return base64.b64decode(uri.partition(",")[2])
        except binascii.Error as error:
            raise InputError(f"{self.path}: {where}: buffer {number} cannot be read ({error}).") from error
        beside = (self.path.parent / unquote(uri)).resolve()
        if not uri or not beside.is_relative_to(self.path.parent.resolve()) or not beside.is_file():
            raise InputError(f"{self.path}: {where}: buffer {number} ({brief(uri)}) is no file beside it.")
        return read_bytes(beside, LARGEST_BUFFER)


class Packer:
    """Collects arrays into the one binary chunk of a GLB, after what it has in it."""

    def __init__(self, gltf: gl.GLTF2) -> None:
        held: Any = gltf.binary_blob()
        self.gltf, self.blob = gltf, bytearray(held or b"")
        self.blob += b"\0" * (-len(self.blob) % 4)

    def add(self, values: AnyArray, kind: str, target: int | None = None, bounds: bool = False) -> int:
        """Append an array of glTF type `kind`, with min and max if `bounds`; returns the number of its accessor."""
        data = np.ascontiguousarray(values)
        self.gltf.bufferViews.append(
            gl.BufferView(buffer=0, byteOffset=len(self.blob), byteLength=data.nbytes, target=target)
        )
        rows = data.reshape(-1, _WIDTHS[kind])
        accessor = gl.Accessor(
            bufferView=len(self.gltf.bufferViews) - 1, componentType=_CODES[data.dtype], count=len(rows), type=kind
        )
        if bounds:
            accessor.min, accessor.max = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self.gltf.accessors.append(accessor)
        self.blob += data.tobytes()
        self.blob += b"\0" * (-len(self.blob) % 4)
        return len(self.gltf.accessors) - 1

    def add_times(self, times: Float | None, poses: int, source: Path | str) -> int:
        """Append the key times (s) of an animation. Raises InputError, which names the source, where there are not as
        many as poses, or they do not rise from 0 or later."""
        if times is None or len(times) != poses:
            raise InputError(f"{source}: an animation needs the time of each pose.")
        keys = np.asarray(times, np.float32)
        rising = keys[0] >= 0 and np.isfinite(keys[-1]) and np.all(np.diff(keys) > 0)
        check(str(source), rising, "the times of an animation must rise, from 0 or later")
        return self.add(keys, "SCALAR", bounds=True)

    def add_channel(self, animation: gl.Animation, keys: int, node: int, path: str, values: Float) -> None:
        """Move a node: by rotations (T, 4; x y z w) or translations (T, 3), as the `path` says, at key times."""
        output = self.add(values.astype(np.float32), "VEC4" if path == "rotation" else "VEC3")
        animation.samplers.append(gl.AnimationSampler(input=keys, output=output, interpolation="LINEAR"))
        target = gl.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(gl.AnimationChannel(sampler=len(animation.samplers) - 1, target=target))

    def save(self, path: Path | str) -> None:
        """Write the GLB. Raises InputError where it cannot be written."""
        if not self.gltf.buffers:
            self.gltf.buffers.append(gl.Buffer())
        self.gltf.buffers[0].byteLength = len(self.blob)
        self.gltf.set_binary_blob(bytes(self.blob))
        try:
            self.gltf.save_binary(str(path))
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}).") from error


def quaternions(turns: Float) -> Float:
    """(T, …, 4) x y z w of rotations (T, …, 3, 3), continuous in time."""
    q = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(canonical=True).reshape(*turns.shape[:-2], 4)
    flips = np.where(np.sum(q[1:] * q[:-1], axis=-1, keepdims=True) < 0, -1.0, 1.0)
    return q * np.cumprod(np.concatenate([np.ones_like(q[:1, ..., :1]), flips]), axis=0)


def noted(notes: Mapping[str, Any] | None) -> dict[str, Any]:
    """Extras that hold our notes."""
    return {EXTRAS: dict(notes)} if notes else {}
