"""Small videos, whole and damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twistcap.io.videowriter import VideoWriter

COUNT = 40


def picture(k: int, size: tuple[int, int] = (384, 280)) -> np.ndarray:
    """A smooth scene with its frame number as a row of black and white blocks."""
    y, x = np.mgrid[: size[1], : size[0]]
    image = np.stack([x / size[0] * 255, y / size[1] * 255, 128 + 100 * np.sin(x / 30 + k / 5)], axis=-1)
    for bit in range(8):
        image[:32, 32 * bit : 32 * bit + 32] = 255 * ((k >> bit) & 1)
    return image.astype(np.uint8)


def write(path: Path, count: int = COUNT, size: tuple[int, int] = (384, 280)) -> Path:
    with VideoWriter(path, fps=60) as writer:
        for k in range(count):
            writer.write(picture(k, size))
    return path


def corrupted(source: Path, path: Path, fraction: float = 0.5) -> Path:
    """The video with its pictures overwritten from a fraction of the file on; header and index stay."""
    data = bytearray(source.read_bytes())
    start = data.index(b"mdat")
    cut = start + int(fraction * (len(data) - start))
    data[cut:] = np.random.default_rng(0).integers(0, 256, len(data) - cut, dtype=np.uint8).tobytes()
    path.write_bytes(bytes(data))
    return path
