"""H.264 video that browsers play."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError

from twistcap.arrays import AnyArray
from twistcap.io.files import replacing

_TICK = Fraction(1, 90_000)  # s, of time stamps


class VideoWriter:
    """Writes RGB or grey images (uint8, or float in [0, 1]) as H.264 yuv420p; odd sizes lose their last row or column.

    Use as a context manager; every image must have the size of the first.
    """

    def __init__(self, path: str | Path, fps: float, crf: int = 18) -> None:
        """`crf` is x264's quality: 0 lossless in all but chroma, 18 hardly visible, 23 small. Raises InputError where
        the file cannot be written.
        """
        self.path = Path(path)
        self._fps, self._crf = fps, crf
        self._stream: Any = None
        with ExitStack() as stack:
            part = stack.enter_context(replacing(path, "video"))
            self._container: Any = av.open(str(part), "w", options={"movflags": "faststart"})
            self._replaced = stack.pop_all()  # takes the video's place when it is whole

    def write(self, image: AnyArray, time: float | None = None) -> None:
        """Append one image (H, W) or (H, W, 3). `time` (s) of every image, or of none."""
        rgb = as_rgb(image)[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
        if self._stream is None:
            rate, options = Fraction(self._fps).limit_denominator(1001), {"crf": str(self._crf), "preset": "veryfast"}
            self._stream = self._container.add_stream("libx264", rate=rate, options=options)
            if time is not None:
                self._stream.codec_context.time_base = _TICK
            self._stream.width, self._stream.height, self._stream.pix_fmt = rgb.shape[1], rgb.shape[0], "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        if time is not None:
            frame.pts, frame.time_base = round(time / _TICK), _TICK
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Write what the encoder holds back; safe to call twice."""
        with self._replaced:
            self._finish()

    def _finish(self) -> None:
        if self._container is None:
            return
        container, self._container = self._container, None
        if self._stream is not None:
            container.mux(self._stream.encode())
        container.close()

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, *raised: Any) -> None:
        if raised[0] is None:
            self.close()
            return
        with suppress(FFmpegError):
            self._container.close()  # nothing is encoded after an error of writing: FFmpeg crashes on it
        self._container = None
        self._replaced.__exit__(*raised)


def as_rgb(image: AnyArray) -> AnyArray:
    """(H, W, 3) uint8 of an image (H, W) or (H, W, 3), uint8 or float in [0, 1]."""
    if image.dtype != np.uint8:
        image = (np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=-1) if image.ndim == 2 else image
