"""The motion of what lies behind: still, or one affine motion that dominates the picture off the body."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Bool, Float, Float32

_FEWEST = 12
STILL = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def dominant_motion(before: Float32, after: Float32, body: Bool) -> Float:
    """(2, 3) affine motion, px, of the picture off the body from one image to the next; `STILL` where nothing is told.

    Args:
        before, after: (H, W) grey in [0, 1].
        body: (H, W) silhouette in `before`.
    """
    off = cv2.erode((~body).astype(np.uint8) * 255, np.ones((9, 9), np.uint8))
    first, second = (np.clip(255 * image, 0, 255).astype(np.uint8) for image in (before, after))
    corners = cast("AnyArray | None", cv2.goodFeaturesToTrack(first, 300, 0.01, 6, mask=off))  # stubs leave None out
    if corners is None or len(corners) < _FEWEST:
        return STILL
    moved, found, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, np.empty_like(corners))
    kept = found.ravel() == 1
    if np.count_nonzero(kept) < _FEWEST:
        return STILL
    found_motion = cv2.estimateAffine2D(corners[kept], moved[kept], ransacReprojThreshold=0.7)
    motion, inliers = cast("tuple[AnyArray | None, AnyArray]", found_motion)
    if motion is None or np.count_nonzero(inliers) < _FEWEST:
        return STILL
    return np.asarray(motion, np.float64)


def under_motion(pixels: Float, motion: Float) -> Float:
    """Pixels (N, 2) after an affine motion (2, 3)."""
    return pixels @ motion[:, :2].T + motion[:, 2]
