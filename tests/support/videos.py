"""Small videos, whole and damaged."""

from __future__ import annotations

from pathlib import Path

import av
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


def with_sound(path: Path, samples: np.ndarray, rate: int) -> Path:
    """The video with a sound track of samples (N,) in [-1, 1]."""
    part = path.with_name(f"{path.stem}-sound{path.suffix}")
    with av.open(str(path)) as source, av.open(str(part), "w") as goal:
        picture, sound = (
            goal.add_stream_from_template(source.streams.video[0]),
            goal.add_stream("alac", rate, layout="mono"),
        )
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = picture
                goal.mux(packet)
        for start in range(0, len(samples), 4096):
            piece = (32767 * samples[None, start : start + 4096]).astype(np.int16)
            frame = av.AudioFrame.from_ndarray(piece, "s16p", "mono")
            frame.sample_rate, frame.pts = rate, start
            goal.mux(sound.encode(frame))
        goal.mux(sound.encode(None))
    part.replace(path)
    return path


def corrupted(source: Path, path: Path, fraction: float = 0.5) -> Path:
    """The video with its pictures overwritten from a fraction of the file on; header and index stay."""
    data = bytearray(source.read_bytes())
    start = data.index(b"mdat")
    cut = start + int(fraction * (len(data) - start))
    data[cut:] = np.random.default_rng(0).integers(0, 256, len(data) - cut, dtype=np.uint8).tobytes()
    path.write_bytes(bytes(data))
    return path
