"""Walks before cameras that stand far off, as a laboratory's and a photographer's do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.camera import Camera, Rig, look_at
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.motion import gait
from twistcap.studio.scene import default_body

_WALK_RATIO = 0.0064  # m per (step/min), as of the built-in gait
_STATURE_PX = 190.0  # of a person in the middle of the path, in an image 280 px high


@dataclass(frozen=True)
class Walk:
    """Scenes of one person walking along x.

    Attributes:
        directions_deg: of the cameras from the middle of the path; 0 is ahead, -90 the person's right.
        distance: of the cameras, m.
        studio: picture settings; views are as many as directions.
        per_cycle: exposures in a cycle of the gait; None takes the studio's rate.
        disturbed: what is changed of each capture.
    """

    directions_deg: tuple[float, ...]
    distance: float
    studio: StudioConfig
    per_cycle: int | None = None
    disturbed: Callable[[Capture], Capture] | None = None

    def scene(self, seed: int) -> Capture:
        """The capture of a seed."""
        speed, phase, cycle = self._gait(seed)
        fps = self.studio.fps if self.per_cycle is None else self.per_cycle / cycle
        config = replace(self.studio, seed=seed, views=len(self.directions_deg), fps=fps)
        body = default_body(config)
        poses = gait(body, fps=fps, frames=config.frames, speed=speed, phase=phase)
        rig = self._rig(poses, config.size)
        take = replace(capture(config, body, poses), true_rig=rig, rig=rig)
        return take if self.disturbed is None else self.disturbed(take)

    def phases(self, scene: Capture) -> Float:
        """(N,) phase of the right leg in each frame, cycles from its heel strike."""
        _, phase, cycle = self._gait(scene.config.seed)
        return phase + np.arange(scene.config.frames) / (scene.config.fps * cycle)

    def _gait(self, seed: int) -> tuple[float, float, float]:
        """Speed m/s, first phase and seconds of a cycle."""
        rng = stream(seed, "gait")
        speed, phase = float(rng.uniform(1.15, 1.45)), float(rng.uniform(0, 1))
        return speed, phase, 120.0 / float(np.sqrt(speed * 60.0 / _WALK_RATIO))

    def _rig(self, poses: Sequence[Pose], size: tuple[int, int]) -> Rig:
        middle = 0.5 * (poses[0].root[:3, 3] + poses[-1].root[:3, 3])
        focal = _STATURE_PX * size[1] / 280 * self.distance / 1.75
        K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])
        cameras: list[Camera] = []
        for k, angle in enumerate(np.deg2rad(self.directions_deg)):
            eye = middle + self.distance * np.array([np.cos(angle), np.sin(angle), 0.0])
            cameras.append(Camera(f"cam{k + 1:02d}", K, look_at(eye, middle), size))
        return Rig(tuple(cameras))
