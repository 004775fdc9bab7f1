"""Array aliases used in signatures, whose docstrings say shapes and units; and the runs of true values in an array."""

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


def runs(flags: AnyArray) -> list[tuple[int, int]]:
    """First row and row after the last of each run of true rows (N,)."""
    steps = np.diff(np.concatenate([[0], np.asarray(flags, int), [0]]))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))
