"""A studio capture whose cameras, lights and company change while it is filmed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import cv2
import numpy as np

from reproduce.faults.figures import Figure, figure_of, together
from twistcap.arrays import Bool, Float, Float32, UInt8
from twistcap.body import Posed
from twistcap.camera import Camera
from twistcap.camera.bump import bumped, homography
from twistcap.studio import Capture
from twistcap.studio.config import stream
from twistcap.studio.look import Look
from twistcap.studio.picture import marred, replace_pixels


@dataclass(frozen=True)
class Lighting:
    """Another light: the person under it, and the factor (3,) on the colours of the room."""

    look: Look
    room: Float


@dataclass(frozen=True)
class Staged(Capture):
    """A capture with what happens in the room and to the cameras, by frame (N) and camera (C).

    Attributes:
        bumps: (N, C, 3) rotation vector of each camera, in its own frame, from where it was calibrated, rad.
        exposure: (N, C) factor on the brightness.
        grain: (N,) fraction of pixels that noise replaces.
        relit: (N,) frames under the other light.
        lighting: that light.
        company: what else stands in the room in a frame.
    """

    bumps: Float = field(default_factory=lambda: np.zeros(0))
    exposure: Float = field(default_factory=lambda: np.ones(0))
    grain: Float = field(default_factory=lambda: np.zeros(0))
    relit: Bool = field(default_factory=lambda: np.zeros(0, np.bool_))
    lighting: Lighting | None = None
    company: Callable[[int], Sequence[Figure]] | None = None

    def image(self, index: int, camera: int, moments: Sequence[Posed] | None = None) -> UInt8 | None:
        """One camera's image, uint8 (H, W, 3)."""
        picture = self.exposed(index, camera, moments or [Posed(self.true_body, self.true_poses[index])])
        picture *= np.float32(self.exposure[index, camera])
        replace_pixels(picture, float(self.grain[index]), stream(self.config.seed, "grain", camera, index))
        return marred(picture, self.config, index, camera)

    def scenery(self, index: int, camera: int, moments: Sequence[Posed]) -> Float32:
        """The picture (H, W, 3) of the room, the person and the company, each before what is behind it."""
        view, room, look = self.true_rig[camera], self.rooms[camera].copy(), self.look
        if self.relit[index] and self.lighting is not None:
            look = self.lighting.look
            room = np.clip(room * self.lighting.room, 0.0, 1.0).astype(np.float32)
        if np.any(self.bumps[index, camera]):
            room = bumped_picture(room, view, self.bumps[index, camera])
            view = bumped(view, self.bumps[index, camera])
        others = [] if self.company is None else self.company(index)
        together([figure_of(moments[0], look), *others], view, look).over(room)
        return room


def staged(take: Capture) -> Staged:
    """The capture with nothing changed yet."""
    n, c = len(take.true_poses), len(take.rig)
    kept: dict[str, Any] = {f.name: getattr(take, f.name) for f in fields(take)}
    return Staged(
        **kept, bumps=np.zeros((n, c, 3)), exposure=np.ones((n, c)), grain=np.zeros(n), relit=np.zeros(n, np.bool_)
    )


def bumped_picture(picture: Float32, camera: Camera, turn: Float) -> Float32:
    """The picture (H, W, 3) that the turned camera takes of far things; mirrored beyond the old picture's border."""
    H = homography(camera.K, turn)
    return cv2.warpPerspective(picture, H, camera.size, borderMode=cv2.BORDER_REFLECT_101).astype(np.float32)
