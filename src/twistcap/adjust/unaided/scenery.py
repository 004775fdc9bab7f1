"""What stands still in a recording, and what stands out from it: the person, where nobody has said anything of it.

In small images, for each camera: an empty-scene plate if there is one, else the median of pictures spread over the
recording. Where the person stays in place the median holds part of it, so that only what moves stands out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Float, Float32
from twistcap.body import Body
from twistcap.camera import Camera, Rig
from twistcap.features import Channels
from twistcap.search.backdrop import FLOOR, Backdrop, small_camera, small_features
from twistcap.search.evidence import Evidence, EvidenceView

_NOISE = 0.0005  # variance that is never undercut, brightness²
_USUAL = 1.5  # nats that a pixel of the background has for the person, with which it just fits
_HOLE = 13  # px across, of holes in what stands out: there the person may be part of the still picture
_CLIP = (-2.0, 2.5)  # least and greatest nats that one pixel can say
_IN_HOLE = 0.15  # share of the evidence against the person that counts there
_QUIET = 30.0  # per cent of the pictures by which a pixel's noise is judged: the person may hide it in the others
_QUIET_SD = 0.385  # standard deviations of a Gaussian within which so many lie


@dataclass(frozen=True)
class Still:
    """One camera's still picture.

    Attributes:
        camera: of the small image.
        mean, variance: (h, w, C) of its features.
    """

    camera: Camera
    mean: Float32
    variance: Float32

    def standing_out(self, features: Float32) -> Float32:
        """(h, w) nats by which each pixel speaks for something in front of the still picture."""
        distance = ((features - self.mean) ** 2 / self.variance).sum(axis=2)
        nats = np.clip(0.5 * (distance - features.shape[2]) - _USUAL, *_CLIP).astype(np.float32)
        nats = np.asarray(cv2.GaussianBlur(nats, (3, 3), 0.7), np.float32)
        hole = cv2.morphologyEx(nats, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_HOLE, _HOLE)))
        return np.where(np.asarray(hole) > 0.0, np.maximum(nats, _IN_HOLE * _CLIP[0]), nats).astype(np.float32)


@dataclass(frozen=True)
class Scenery:
    """The still pictures of all cameras.

    Attributes:
        stills: one for each camera; None for one that has no picture.
        channels: of the features.
    """

    stills: tuple[Still | None, ...]
    channels: Channels

    def evidence(self, images: Sequence[AnyArray | None], body: Body) -> Evidence:
        """The evidence of one instant's images for a body of any colours."""
        views = list[EvidenceView]()
        for i, (image, still) in enumerate(zip(images, self.stills, strict=True)):
            if image is not None and still is not None:
                nats = still.standing_out(small_features(image, still.camera.size, self.channels))
                views.append(EvidenceView(i, still.camera, np.repeat(nats[None], len(body.segment_names), axis=0)))
        return Evidence(body, views)


def scenery_of(
    rig: Rig, pictures: Sequence[Sequence[AnyArray | None]], place: Float, channels: Channels,
    plates: Sequence[AnyArray | None] | None = None,
) -> Scenery:  # fmt: skip
    """The scenery of a recording.

    Args:
        rig: cameras of the images.
        pictures: of each camera, spread over the recording; None where one is missing.
        place: (3,) about which the person is, m; it decides how small the images are made.
        plates: of each camera, a picture without the person, or None.
    """
    empty = plates or [None] * len(rig)
    stills = [_still(*one, place, channels) for one in zip(rig, pictures, empty, strict=True)]
    return Scenery(tuple(stills), channels)


def _still(
    camera: Camera, pictures: Sequence[AnyArray | None], plate: AnyArray | None, place: Float, channels: Channels
) -> Still | None:
    small = small_camera(camera, Backdrop.blank(), place)
    seen = [small_features(image, small.size, channels) for image in pictures if image is not None]
    if not seen:
        return None
    stack = np.stack(seen)
    mean = np.median(stack, axis=0) if plate is None else _fitting(small_features(plate, small.size, channels), stack)
    noise = (np.percentile(np.abs(stack - mean), _QUIET, axis=0) / _QUIET_SD) ** 2
    mean = np.ascontiguousarray(mean, np.float32)
    near = [cv2.blur(a, (3, 3)).reshape(a.shape) for a in (mean, mean * mean)]
    texture = np.maximum(near[1] - near[0] ** 2, 0.0)  # a pixel that shakes shows its neighbours
    usual = np.median(noise, axis=(0, 1))
    variance = np.minimum(noise, 16.0 * usual) + 0.25 * texture + max(FLOOR, _NOISE)
    return Still(small, mean, np.asarray(variance, np.float32))


def _fitting(plate: Float32, stack: AnyArray) -> Float32:
    """A plate (h, w, C) with the light of the recording (N, h, w, C)."""
    return np.asarray(plate + np.median(np.median(stack, axis=0) - plate, axis=(0, 1)), np.float32)
