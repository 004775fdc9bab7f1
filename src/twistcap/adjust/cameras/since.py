"""From which frame on a camera stands as it was found to stand."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Float


def holds_from(before: Float, after: Float) -> int:
    """The first frame (0 … F) from which the mended camera agrees better with the images than the given one.

    Args:
        before, after: (F,) share of the contour points that agree in each frame, with the camera as given and as
            mended; NaN without an image.
    """
    gain = np.concatenate([[0.0], np.cumsum(np.nan_to_num(after - before))])
    return int(np.argmin(gain))
