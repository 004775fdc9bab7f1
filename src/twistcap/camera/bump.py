"""A camera that has been turned about its centre, and its pictures as if it had not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from twistcap import se3
from twistcap.arrays import AnyArray, Bool, Float
from twistcap.camera.calibrated import Camera


def bumped(camera: Camera, bump: Float) -> Camera:
    """The camera turned about its centre by a rotation vector (3,) of its own frame, rad."""
    if not np.any(bump):
        return camera
    turn = se3.transform(se3.exp_rotation(bump), np.zeros(3))
    return replace(camera, T_cam_world=turn @ camera.T_cam_world)


def homography(K: Float, bump: Float) -> Float:
    """(3, 3) that takes pixels of a camera with matrix K (3, 3) to those of the same rays after its turn (3,)."""
    return K @ se3.exp_rotation(bump) @ np.linalg.inv(K)


def warped(image: AnyArray, K: Float, bump: Float, beyond: int = cv2.BORDER_CONSTANT) -> AnyArray:
    """An image (H, W[, C]) as it was before a turn (3,) of its camera with matrix K (3, 3); `beyond` its border by a
    mode of OpenCV's, 0 by default.
    """
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(image, homography(K, bump), image.shape[1::-1], flags=flags, borderMode=beyond)


def turned_back(image: AnyArray, camera: Camera, bump: Float) -> AnyArray:
    """What a (pinhole) camera would have shown, by the image (H, W[, 3]) that it took after such a turn (3,).

    Beyond the border of the image its outermost pixels go on.
    """
    return warped(image, camera.K, bump, cv2.BORDER_REPLICATE) if np.any(bump) else image


def still_shown(camera: Camera, bump: Float) -> Bool:
    """(h, w) pixels of a turned-back image that the turned camera did show."""
    whole = np.ones(camera.size[::-1], np.float32)
    return np.asarray((warped(whole, camera.K, bump) if np.any(bump) else whole) > 0.99, np.bool_)


def after_both(first: Float, second: Float) -> Float:
    """The turn (3,) of a camera that was turned once, and once more in its own frame as it was before both."""
    return se3.log_rotation(se3.exp_rotation(first) @ se3.exp_rotation(second))
