"""Array aliases used in signatures, whose docstrings say shapes and units; runs of true values, and even clocks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int = NDArray[np.int32]
Bool = NDArray[np.bool_]
UInt8 = NDArray[np.uint8]
AnyArray = NDArray[Any]

UNEVEN = 0.2
"""Ticks by which a time may be off an even clock."""


def runs(flags: AnyArray) -> list[tuple[int, int]]:
    """First row and row after the last of each run of true rows (N,)."""
    steps = np.diff(np.concatenate([[0], np.asarray(flags, int), [0]]))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def even_clock(times: Float) -> tuple[float, AnyArray, float]:
    """Of times (N,) s that rise, N > 1: ticks per second, the tick of each (N,) from 0 on, and how far any is off its
    own, in ticks. Frames that were dropped leave ticks out; times in whole milliseconds do not change the rate."""
    steps = np.diff(times)
    ticks = np.concatenate([[0], np.cumsum(np.round(steps / np.median(steps)))]).astype(np.int32)
    rate = float(ticks[-1] / (times[-1] - times[0]))
    return rate, ticks, float(np.abs((times - times[0]) * rate - ticks).max())
