"""Where a camera looks, coarsely: what stands out from its background is laid over the tracked body of all frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from twistcap import se3
from twistcap.adjust.unaided.scenery import scenery_of
from twistcap.arrays import AnyArray, Float
from twistcap.body import Posed
from twistcap.camera import Camera, Rig
from twistcap.features import Channels
from twistcap.render import render
from twistcap.search.backdrop import Backdrop, small_camera, small_features

_FARTHEST = np.deg2rad(12.0)  # by which a camera may have been turned
_NEAR = 1.5  # px of the small images, within which contours find the rest
_LEAST = 0.5  # nats for each pixel of the body; below that nothing stands out there, as somebody who never moves


def turned_towards(
    camera: Camera, pictures: Sequence[AnyArray | None], posed: Sequence[Posed], channels: Channels
) -> Camera:
    """The camera, turned so that the body lies where something stands out from the background.

    The sum over all frames of what each pixel says, under the body's silhouette, is computed for all shifts of the
    image at once; the best shift is taken as a turn about the camera's centre. A smaller turn than contours can find
    is none; nor is one where nothing stands out.

    Args:
        camera: pinhole of the images, as calibrated.
        pictures: (H, W[, 3]) images of frames that are spread over the recording, or `small_picture`s of them; None
            where one is missing.
        posed: the body in each of them, as other cameras see it.
        channels: of the features.
    """
    scenery = scenery_of(Rig((camera,)), [pictures], _place(posed), channels)
    still = scenery.stills[0]
    if still is None:
        return camera
    farthest, total, area = int(still.camera.K[0, 0] * np.tan(_FARTHEST)), np.zeros((0, 0)), 0.0
    for image, at in zip(pictures, posed, strict=True):
        if image is not None:
            nats = still.standing_out(small_features(image, still.camera.size, channels))
            body = _silhouette(at, still.camera, farthest)
            found, area = _by_shift(nats, body, farthest), area + float(body.sum())
            total = found if not total.size else total + found
    if not total.size or total.max() < _LEAST * area:
        return camera
    row, column = np.unravel_index(int(np.argmax(total)), total.shape)
    shift = np.array([float(column) - farthest, float(row) - farthest])
    return camera if np.linalg.norm(shift) < _NEAR else _turned(camera, shift / np.diagonal(still.camera.K)[:2])


def small_picture(image: AnyArray, camera: Camera, posed: Sequence[Posed]) -> AnyArray:
    """An image (H, W[, 3]) as small as `turned_towards` makes it for the bodies of all its frames."""
    size = small_camera(camera, Backdrop.blank(), _place(posed)).size
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _place(posed: Sequence[Posed]) -> Float:
    """(3,) where the body is on the whole."""
    return np.mean([at.pose.root[:3, 3] for at in posed], axis=0)


def _silhouette(posed: Posed, camera: Camera, margin: int) -> Float:
    """(H + 2 margin, W + 2 margin) 1 where the body is, also beside the image."""
    width, height = camera.size
    return render(posed, camera.cropped((-margin, -margin), (width + 2 * margin, height + 2 * margin))).mask.astype(
        float
    )


def _by_shift(nats: AnyArray, silhouette: Float, farthest: int) -> Float:
    """(2 farthest + 1, 2 farthest + 1) sum of the nats under the silhouette, shifted by (row, column) − farthest."""
    from scipy.signal import fftconvolve  # slow to import

    return fftconvolve(nats.astype(float), silhouette[::-1, ::-1], mode="full")[
        nats.shape[0] - 1 : nats.shape[0] + 2 * farthest, nats.shape[1] - 1 : nats.shape[1] + 2 * farthest
    ]


def _turned(camera: Camera, slope: Float) -> Camera:
    """Turned about its centre so that what was in the middle of its image is seen at a slope (x, y) from its axis."""
    turn = np.array([-np.arctan(slope[1]), np.arctan(slope[0]), 0.0])
    return replace(camera, T_cam_world=se3.compose_one(se3.exp_one(np.r_[turn, 0, 0, 0]), camera.T_cam_world))
