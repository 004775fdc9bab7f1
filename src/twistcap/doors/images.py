"""The door for pictures: their kind and their size are read from the first bytes, before they are decoded."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np

from twistcap.arrays import UInt8
from twistcap.doors.text import read_bytes
from twistcap.errors import InputError

MOST_PIXELS = 1 << 25  # of a picture or a frame of a video
_LARGEST = 1 << 28  # bytes of a file
_SIGNATURES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"II*\0", b"MM\0*", *(b"P%d" % k for k in range(1, 8)))


def read_image(path: str | Path, what: str, grey: bool = False, mend: str = "replace it") -> UInt8:
    """A picture as OpenCV gives it: (H, W, 3) BGR, or (H, W) where `grey`.

    `what` it is and how to `mend` it stand in messages. Raises InputError for a file that is missing, no picture
    (PNG, JPEG, BMP, TIFF, PNM), damaged, or of more than `MOST_PIXELS`.
    """
    data = read_bytes(Path(path), _LARGEST)
    width, height = _declared_size(data)
    if width * height > MOST_PIXELS:
        raise InputError(f"{what} {path} is {width}×{height} pixels; at most {MOST_PIXELS >> 20} megapixels are read.")
    image = None
    if data.startswith(_SIGNATURES) and (data[:4] != b"\x89PNG" or _is_whole_png(data)):
        try:
            mode = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
            image = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
        except (cv2.error, MemoryError):
            image = None
    if image is None:
        raise InputError(f"{what} {path} is corrupt, or no picture that can be read; {mend}.")
    return np.asarray(image, dtype=np.uint8)


def _declared_size(data: bytes) -> tuple[int, int]:
    """Width and height that the first bytes declare; (0, 0) for what is damaged, which the decoder refuses."""
    try:
        if data[:4] == b"\x89PNG":
            return struct.unpack(">II", data[16:24])
        if data[:2] == b"BM":
            width, height = struct.unpack("<ii", data[18:26])
            return abs(width), abs(height)
        if data[:2] == b"\xff\xd8":
            return _jpeg_size(data)
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff_size(data)
        if data[:1] == b"P":
            return _pnm_size(data)
    except (struct.error, ValueError, LookupError):
        pass
    return 0, 0


def _is_whole_png(data: bytes) -> bool:
    """Whether its chunks lie in the file; OpenCV allocates what they declare."""
    at = 8
    while at + 12 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        at += 12 + length
        if kind == b"IEND":
            return at <= len(data)
    return False


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """The largest of all frames that its markers name."""
    at, size = 2, (0, 0)
    while at + 9 < len(data):
        if data[at] != 0xFF:
            at += 1
            continue
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            size = max(size, (width, height), key=lambda wh: wh[0] * wh[1])
        at += 1 if marker in (0x00, 0xFF) else 2 if 0xD0 <= marker <= 0xD9 else 2 + length
    return size


def _tiff_size(data: bytes) -> tuple[int, int]:
    order = "<" if data[:2] == b"II" else ">"
    (start,) = struct.unpack(order + "I", data[4:8])
    (count,) = struct.unpack(order + "H", data[start : start + 2])
    found = {256: 0, 257: 0}
    for k in range(count):
        entry = data[start + 2 + 12 * k : start + 14 + 12 * k]
        tag, kind = struct.unpack(order + "HH", entry[:4])
        if tag in found:
            (found[tag],) = struct.unpack(order + ("H" if kind == 3 else "I"), entry[8 : 10 if kind == 3 else 12])
    return found[256], found[257]


def _pnm_size(data: bytes) -> tuple[int, int]:
    lines = [line.split(b"#")[0] for line in data[:4096].split(b"\n")]
    words = b" ".join(lines).split()
    if words[0] == b"P7":
        named = dict(zip(words[1::2], words[2::2], strict=False))
        return int(named[b"WIDTH"]), int(named[b"HEIGHT"])
    return int(words[1]), int(words[2])
