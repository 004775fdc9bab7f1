"""Two slots for what the next frame depends on, written in turn: a kill in the middle of a write leaves one whole."""

from __future__ import annotations

import zlib

import h5py
import numpy as np

from twistcap.arrays import UInt8

_SLOTS = ("0", "1")
_NONE = -1  # frames of a slot that is empty or being written


def put_state(group: h5py.Group, data: UInt8, frames: int) -> None:
    """Write (N,) bytes into the older slot, the state after `frames` frames."""
    slot = min(_SLOTS, key=lambda name: _frames(group, name))
    if slot not in group:
        group.create_dataset(slot, (0,), np.uint8, maxshape=(None,), chunks=(1 << 16,))
    dataset = group[slot]
    assert isinstance(dataset, h5py.Dataset)
    dataset.attrs["frames"] = _NONE
    dataset.resize(len(data), axis=0)
    dataset[:] = data
    dataset.attrs["crc32"] = zlib.crc32(data.tobytes())
    dataset.attrs["frames"] = frames


def latest_state(group: h5py.Group, complete: int) -> tuple[int, UInt8] | None:
    """Frames and bytes (N,) of the newest slot that is whole and not ahead of `complete` frames; None where none is."""
    for slot in sorted(_SLOTS, key=lambda name: -_frames(group, name)):
        dataset, frames = group.get(slot), _frames(group, slot)
        if isinstance(dataset, h5py.Dataset) and 0 <= frames <= complete:
            data = np.asarray(dataset[:], np.uint8)
            if zlib.crc32(data.tobytes()) == dataset.attrs.get("crc32"):
                return frames, data
    return None


def _frames(group: h5py.Group, slot: str) -> int:
    return int(group[slot].attrs.get("frames", _NONE)) if slot in group else _NONE
