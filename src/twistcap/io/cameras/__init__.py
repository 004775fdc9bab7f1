"""Calibrations of other programs, read and written; none of their axes or units is guessed in silence."""

from twistcap.io.cameras.formats import FORMATS, CameraFormat, format_named, format_of, read_cameras, write_cameras
from twistcap.io.cameras.parts import Asked

__all__ = [
    "FORMATS", "Asked", "CameraFormat", "format_named", "format_of", "read_cameras", "write_cameras",
]  # fmt: skip
