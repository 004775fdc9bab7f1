"""The sound of a video, one channel of numbers."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from twistcap.arrays import Float

RATE = 16_000
"""Samples per second that are given."""


def read_sound(path: str | Path, longest: float) -> Float | None:
    """(N,) samples in [-1, 1] from the time of the first picture on, of at most `longest` s; None without sound."""
    if not Path(path).is_file():
        return None
    try:
        with av.open(str(path), options={"protocol_whitelist": "file"}) as container:
            if not container.streams.audio or not container.streams.video:
                return None
            picture, sound = container.streams.video[0], container.streams.audio[0]
            began = float((picture.start_time or 0) * (picture.time_base or 0))
            heard = float((sound.start_time or 0) * (sound.time_base or 0))
            if abs(heard - began) > longest:  # no recording begins so; a forged one would fill the memory
                return None
            resampler, out, count = av.AudioResampler("flt", "mono", RATE), list[Float](), 0
            for frame in container.decode(sound):
                for piece in resampler.resample(frame):
                    out.append(np.asarray(piece.to_ndarray(), float).ravel())
                    count += len(out[-1])
                if count > longest * RATE:
                    break
    except (FFmpegError, ValueError):
        return None
    samples, late = np.concatenate([*out, np.zeros(0)]), round((heard - began) * RATE)
    samples = np.concatenate([np.zeros(late), samples]) if late > 0 else samples[-late:]
    return samples if len(samples) > RATE and np.isfinite(samples).all() and np.abs(samples).max() > 0 else None
