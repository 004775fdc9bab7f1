"""Synthetic captures with exact truth: a textured person walks through a cluttered room inside a ring of cameras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from twistcap.arrays import Bool, Float, Float32, UInt8
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.studio.background import background, occluder_layer
from twistcap.studio.config import StudioConfig, stream
from twistcap.studio.look import GREY, Look, look
from twistcap.studio.mismatch import wrong_body, wrong_pose, wrong_rig
from twistcap.studio.motion import gait
from twistcap.studio.picture import Layer, between, marred, picture_of, render_body

PERSON_HEIGHT = 0.68  # fraction of the image's height, for a person in the middle of the ring: 190 px of 280
RADIUS = 2.9  # of the ring, in statures
_SHUTTER = 0.5  # open time as a fraction of the frame interval, centred on the frame's time
# Direction of the first camera from the walking direction, deg, by number of views. Two cameras are at the front left
# and right, so that each arm is visible in one of them.
FIRST_CAMERA_DEG = {1: 60.0, 2: -67.5}
STEREO_ANGLE_DEG = 135.0  # between two cameras; 90° and 160° were measured to be worse
_MARGIN = 0.03  # of the image, on each side


@dataclass(frozen=True)
class Capture:
    """A synthetic recording. A tracker may see `frames()`, `body`, `rig` and `first_pose`; the rest is the truth.

    In `exact` scenes these equal the truth; else they are as wrong as in a laboratory (`studio.mismatch`).
    """

    config: StudioConfig
    true_body: Body
    true_rig: Rig
    true_poses: tuple[Pose, ...]
    body: Body
    rig: Rig
    first_pose: Pose
    look: Look

    @cached_property
    def rooms(self) -> tuple[Float32, ...]:
        """The empty room in each view, (H, W, 3) in [0, 1]."""
        return tuple(background(self.config, c) for c in range(len(self.true_rig)))

    @cached_property
    def occluders(self) -> tuple[Float32, ...]:
        """The occluders in each view, (H, W, 4) colour times coverage, and coverage."""
        return tuple(occluder_layer(self.config, c) for c in range(len(self.true_rig)))

    @cached_property
    def landmarks(self) -> Float:
        """(N, L, 3) true landmarks, m, of all frames; their names are those of `true_body.landmarks`."""
        return np.stack([Posed(self.true_body, pose).landmarks for pose in self.true_poses])

    def frames(self) -> Iterator[Frame]:
        """All frames in turn, rendered when asked for."""
        return (self.frame(k) for k in range(len(self.true_poses)))

    def frame(self, index: int) -> Frame:
        """One frame; the same pixels whether rendered alone or in turn."""
        moments, views = self._moments(index), range(len(self.rooms))
        with ThreadPoolExecutor(len(views)) as pool:  # one thread per camera: the kernels release the interpreter lock
            images = tuple(pool.map(lambda camera: self.image(index, camera, moments), views))
        return Frame(index, index / self.config.fps, images)

    def image(self, index: int, camera: int, moments: Sequence[Posed] | None = None) -> UInt8 | None:
        """One camera's image, uint8 (H, W, 3) or grey (H, W); None if it was dropped."""
        if self.config.is_dropped(index, camera):
            return None
        return marred(self.exposed(index, camera, moments or self._moments(index)), self.config, index, camera)

    def exposed(self, index: int, camera: int, moments: Sequence[Posed]) -> Float32:
        """The picture (H, W, 3) or grey (H, W) in [0, 1] before it is disturbed; it may be overwritten."""
        picture = self.scenery(index, camera, moments)
        if self.config.occluders:
            Layer(0, 0, self.occluders[camera]).over(picture)
        return picture if self.config.colour else picture @ GREY.astype(np.float32)

    def scenery(self, index: int, camera: int, moments: Sequence[Posed]) -> Float32:
        """The picture (H, W, 3) of the room and the person; it may be overwritten."""
        return picture_of(moments, self.true_rig[camera], self.look, self.rooms[camera])

    def masks(self, index: int) -> list[Bool]:
        """True silhouettes (H, W) of the whole body, occluded or not: pixels that it covers by more than half."""
        posed, masks = Posed(self.true_body, self.true_poses[index]), list[Bool]()
        for view in self.true_rig:
            layer, mask = render_body(posed, view, self.look), np.zeros(view.size[::-1], dtype=bool)
            h, w = layer.pixels.shape[:2]
            mask[layer.y : layer.y + h, layer.x : layer.x + w] = layer.pixels[..., 3] > 0.5
            masks.append(mask)
        return masks

    def _moments(self, index: int) -> list[Posed]:
        """The body at the sub-frames of one frame, evenly spaced over the open time of the shutter."""
        n = self.config.motion_blur
        offsets = _SHUTTER * ((np.arange(n) + 0.5) / n - 0.5)
        return [Posed(self.true_body, self._pose_at(index + offset)) for offset in offsets]

    def _pose_at(self, at: float) -> Pose:
        last = len(self.true_poses) - 1
        if at == round(at) or last == 0:
            return self.true_poses[min(max(round(at), 0), last)]
        k = min(max(int(np.floor(at)), 0), last - 1)
        return between(self.true_poses[k], self.true_poses[k + 1], at - k)


def capture(config: StudioConfig, body: Body | None = None, poses: Sequence[Pose] | None = None) -> Capture:
    """A synthetic capture of a body, by default the built-in humanoid of random stature by the seed, in poses, one per
    frame, by default a walk. Raises InputError for fewer poses than frames.
    """
    body = default_body(config) if body is None else body
    heading = float(stream(config.seed, "heading").uniform(0, 2 * np.pi)) if poses is None else 0.0
    poses = default_poses(config, body, heading) if poses is None else list(poses)[: config.frames]
    if len(poses) < config.frames:
        raise InputError(f"studio: {len(poses)} poses were given for {config.frames} frames; give one for each frame.")
    rig = ring_around(config, body, poses, heading)
    known = (body, rig, poses[0])
    if config.condition == "mismatch":
        rngs = [stream(config.seed, f"wrong {what}") for what in ("body", "rig", "pose")]
        known = (wrong_body(body, rngs[0]), wrong_rig(rig, rngs[1]), wrong_pose(body, poses[0], rngs[2]))
    return Capture(config, body, rig, tuple(poses), *known, look(body, config))


def default_body(config: StudioConfig) -> Body:
    """The built-in humanoid, its stature ± 5 % by the seed."""
    return humanoid(config.variant, stature=1.75 * float(stream(config.seed, "stature").uniform(0.95, 1.05)))


def default_poses(config: StudioConfig, body: Body, heading: float) -> list[Pose]:
    """A walk in the direction of a heading (rad, from x towards y), its speed and phase by the seed."""
    rng = stream(config.seed, "gait")
    speed, phase = float(rng.uniform(1.15, 1.45)), float(rng.uniform(0, 1))
    fps = config.fps / config.speed_factor
    return gait(body, fps=fps, frames=config.frames, speed=speed, heading=heading, phase=phase)


def ring_around(config: StudioConfig, body: Body, poses: Sequence[Pose], heading: float) -> Rig:
    """Cameras around the middle of the path, with the person inside all images."""
    rng = stream(config.seed, "cameras")
    steps = np.unique(np.linspace(0, len(poses) - 1, 25).astype(int))
    cloud = np.concatenate([Posed(body, poses[k]).vertices for k in steps])
    stature = float(np.ptp(Posed(body, poses[0]).vertices[:, 2]))
    target = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    heights = stature * rng.uniform(0.55, 1.05, size=config.views)
    offset = np.rad2deg(heading) + FIRST_CAMERA_DEG.get(config.views, 40.0) + rng.uniform(-10, 10)
    focal = PERSON_HEIGHT * config.size[1] * RADIUS
    rig = ring(config.views, RADIUS * stature, target[2] - 0.5 * stature + heights, target, config.size, focal, offset)
    return zoom_to_fit(rig, cloud)


def ring(
    views: int, radius: float, height: ArrayLike, target: ArrayLike, size: tuple[int, int], focal: float | None = None,
    offset_deg: float = 0.0,
) -> Rig:  # fmt: skip
    """Cameras cam01 … evenly spaced on a circle, all looking at one point; two are 135° apart.

    Args:
        radius, height: horizontal distance from the target, and height above z = 0 (one for all or one each), m.
        target: (3,) point at the principal point of all, m.
        size, focal: of the images, px; by default 1.75 m at the target fill 0.68 of their height.
        offset_deg: direction from the target to the first camera, from x towards y.
    """
    target = np.asarray(target, float)
    heights = np.broadcast_to(np.asarray(height, float), (views,))
    focal = 0.68 * size[1] * radius / 1.75 if focal is None else focal
    K = np.array([[focal, 0.0, (size[0] - 1) / 2], [0.0, focal, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
    step = STEREO_ANGLE_DEG if views == 2 else 360.0 / views
    cameras: list[Camera] = []
    for k in range(views):
        angle = np.deg2rad(offset_deg + k * step)
        eye = [target[0] + radius * np.cos(angle), target[1] + radius * np.sin(angle), heights[k]]
        cameras.append(Camera(f"cam{k + 1:02d}", K, look_at(eye, target), size))
    return Rig(tuple(cameras))


def zoom_to_fit(rig: Rig, points: Float) -> Rig:
    """The rig zoomed out, if needed, until all points (N, 3) are inside every image with a margin."""
    reach = 0.0
    for camera in rig:
        half = (np.array(camera.size) - 1) / 2
        pixels, _ = camera.project(points)
        reach = max(reach, float(np.max(np.abs(pixels - half) / half)))
    factor = min(1.0, (1.0 - 2 * _MARGIN) / reach)
    zoom = np.array([[factor, factor, 1.0], [factor, factor, 1.0], [1.0, 1.0, 1.0]])
    return Rig(tuple(replace(camera, K=camera.K * zoom) for camera in rig))
