"""A filmed capture, and what of it reaches the tracker."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from reproduce.faults.staged import Staged
from twistcap.arrays import Bool, Float, Int, UInt8
from twistcap.body import Pose, Posed
from twistcap.camera import Rig
from twistcap.estimate import Frame

NONE = -1  # the source of an image that does not arrive
_SEEN = 0.02  # fraction of the surface's points within an image from which a person counts as in it


@dataclass(frozen=True)
class Take:
    """A capture of N frames and C cameras with its faults.

    Attributes:
        kind, motion: what happens to it, and what the person does.
        scene: what is filmed; its poses are the truth.
        first_pose: that the tracker is given.
        source: (N, C, 2) frame and camera whose picture arrives as each image; `NONE` where none does.
        span: first and last frame of the fault; None where it has no end, or none at all.
    """

    kind: str
    motion: str
    scene: Staged
    first_pose: Pose
    source: Int
    span: tuple[int, int | None]

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.source)

    @property
    def views(self) -> int:
        """Number of cameras."""
        return self.source.shape[1]

    @property
    def during(self) -> slice:
        """The frames of the fault."""
        first, last = self.span
        return slice(first, None if last is None else last + 1)

    def staged(self, **changes: Any) -> Take:
        """With something changed in the scene."""
        return replace(self, scene=replace(self.scene, **changes))

    def frames(self) -> Iterator[Frame]:
        """What the tracker sees, rendered when asked for."""
        picture = lru_cache(maxsize=64)(self._picture)
        for k, sources in enumerate(self.source):
            images = tuple(None if frame == NONE else picture(int(frame), int(camera)) for frame, camera in sources)
            yield Frame(k, k / self.scene.config.fps, images)

    def _picture(self, frame: int, camera: int) -> UInt8:
        image = self.scene.image(frame, camera)
        assert image is not None
        return image

    @cached_property
    def absent(self) -> Bool:
        """(N,) frames of which no image that arrives was taken with the person in it."""
        body, rig, shown = self.scene.true_body, self.scene.true_rig, np.zeros(self.source.shape[:2], np.bool_)
        inside = [in_images(Posed(body, pose), rig) for pose in self.scene.true_poses]
        for k, c in np.ndindex(*shown.shape):
            frame, camera = self.source[k, c]
            dark = self.scene.exposure[frame, camera] == 0.0
            shown[k, c] = frame != NONE and not dark and inside[frame][camera] >= _SEEN
        return np.asarray(~shown.any(axis=1), np.bool_)


def own_pictures(frames: int, cameras: int) -> Int:
    """(N, C, 2) each image from its own frame and camera."""
    return np.moveaxis(np.indices((frames, cameras)), 0, -1).astype(np.int32)


def in_images(posed: Posed, rig: Rig) -> Float:
    """(C,) fraction of a surface's points that lie within each image."""
    return np.array([_within(camera.project(posed.vertices), camera.size).mean() for camera in rig])


def landmarks_in_images(points: Float, rig: Rig) -> Int:
    """(L,) number of images in which each of the points (L, 3) lies, hidden or not."""
    return np.sum([_within(camera.project(points), camera.size) for camera in rig], axis=0)


def _within(projected: tuple[Float, Float], size: tuple[int, int]) -> Bool:
    pixels, depth = projected
    return np.asarray((depth > 0) & np.all((pixels > -0.5) & (pixels < np.array(size) - 0.5), axis=1), np.bool_)
