"""What all readers of calibrations share: parts of a camera, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twistcap.arrays import Float
from twistcap.doors.text import finite_number
from twistcap.errors import InputError, check

Size = tuple[int, int]


@dataclass(frozen=True)
class Asked:
    """What a user says because the file does not.

    Attributes:
        unit: m of one unit of its lengths; None where the user does not say.
        size: (width, height) px of all images; None where the user does not say.
    """

    unit: float | None = None
    size: Size | None = None

    def metres(self, usual: float) -> float:
        """The unit: as said, else what the format says; of a format that says none, 1, until `taken_unit` tells it."""
        return usual if self.unit is None else self.unit

    def size_or(self, given: Size | None, where: str) -> Size:
        """The size that the file gives, else the user's. Raises InputError where neither says it."""
        size = given or self.size
        if size is None:
            raise InputError(f"{where}: the file does not say how large the images are; say it, as --size 1920x1080.")
        return size


def numbers(where: str, words: Any, count: int | None = None) -> Float:
    """Finite numbers, as many as asked for. Raises InputError."""
    out = np.array([finite_number(word, where) for word in words], dtype=float)
    check(where, count is None or len(out) == count, f"it must hold {count} numbers, and has {len(out)}")
    return out


def attribute(where: str, table: Mapping[str, Any], key: str) -> str:
    """A text of a table. Raises InputError where it is missing."""
    value = table.get(key)
    if not isinstance(value, str):
        raise InputError(f"{where}: {key} is missing; export the calibration again.")
    return value


def whole_size(where: str, width: float, height: float) -> Size:
    """A size in whole pixels. Raises InputError for another."""
    good = 1 <= width < 1e5 and 1 <= height < 1e5 and width == round(width) and height == round(height)
    check(where, good, f"its image size is {width:g}×{height:g}; it must be in whole pixels")
    return round(width), round(height)


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> Float:
    """(3, 3) matrix, px."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def without_fisheye(cameras: Any, what: str) -> None:
    """Raises InputError where a format cannot say that a lens is a fisheye."""
    for camera in cameras:
        if camera.fisheye:
            raise InputError(
                f"camera {camera.name!r} has a fisheye lens, which {what} cannot say; choose another format."
            )
