"""Given silhouettes: a folder ``CAM/frame_XXXX.png``, white on the person."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twistcap.arrays import Bool
from twistcap.camera import Rig
from twistcap.doors.images import read_image
from twistcap.errors import InputError
from twistcap.io.video import preparation


def read_masks(folder: str | Path, rig: Rig, frame: int) -> tuple[Bool | None, ...]:
    """One mask (H, W) per camera of the rig for a frame, in the camera's own pixels; None where there is none. Raises
    InputError if no camera has one, or one cannot be read or has another size than the calibration.
    """
    files = [Path(folder) / camera.name / f"frame_{frame:04d}.png" for camera in rig]
    masks = tuple(_read(file, camera.size) if file.is_file() else None for file, camera in zip(files, rig, strict=True))
    if all(mask is None for mask in masks):
        raise InputError(f"masks: {folder} holds none of frame {frame}; one would be {files[0]}.")
    return masks


def rectified_masks(folder: str | Path, rig: Rig, frame: int, scale: float) -> tuple[Bool | None, ...]:
    """`read_masks` in the pixels of the images that the tracker sees: those of `rig.scaled(scale).pinhole()`."""
    masks = zip(rig, read_masks(folder, rig, frame), strict=True)
    return tuple(
        None if m is None else preparation(camera, scale)(255 * m.astype(np.uint8)) > 127 for camera, m in masks
    )


def _read(file: Path, size: tuple[int, int]) -> Bool:
    image = read_image(file, "mask", grey=True, mend="replace or delete it")
    if image.shape[::-1] != size:
        its, theirs = (f"{width}×{height}" for width, height in (image.shape[::-1], size))
        raise InputError(f"mask {file} is {its} pixels, but the calibration is for {theirs}.")
    return image > 127
