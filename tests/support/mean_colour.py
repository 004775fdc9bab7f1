"""A toy cue, written by a stranger from ARCHITECTURE.md alone: a part is about as bright as it was in this camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates  # type: ignore[import-untyped]

from twistcap.body import Body
from twistcap.camera import Rig, pinhole
from twistcap.cues import Evidence, Fit, Level, Sight
from twistcap.render import SurfacePoints
from twistcap.terms import PointTerm, Rows


def colours(image: np.ndarray) -> np.ndarray:
    """The image as (H, W, 3) floats in [0, 1]."""
    values = np.asarray(image, float) / (255.0 if image.dtype == np.uint8 else 1.0)
    return values if values.ndim == 3 else np.repeat(values[:, :, None], 3, axis=2)


@dataclass(frozen=True)
class ColourMemory:
    """Mean colour of each part in each camera, (cameras, parts, 3), and from how many frames (cameras, parts)."""

    mean: np.ndarray
    frames: np.ndarray


@dataclass(frozen=True)
class LevelTerm(PointTerm):
    """Brightness of surface points less what their part had in mind."""

    points: SurfacePoints
    weight: np.ndarray  # (N,), 1 / brightness²
    P: np.ndarray  # (3, 4)
    image: np.ndarray  # (H, W), smoothed brightness
    expected: np.ndarray  # (N,)
    name: str = "mean colour"

    def _bright(self, pixels):
        return map_coordinates(self.image, pixels[:, ::-1].T, order=1, mode="nearest")

    def rows(self, posed):
        """Residual: brightness where the point falls less what was expected."""
        world = self.points.at(posed)
        pixels, _, by_world = pinhole(self.P, world)  # (N, 2), (N,), (N, 2, 3)
        residual = self._bright(pixels) - self.expected
        by_x, by_y = ((self._bright(pixels + h) - self._bright(pixels - h)) / 2e-3 for h in 1e-3 * np.eye(2))
        gradient = by_x[:, None] * by_world[:, 0] + by_y[:, None] * by_world[:, 1]
        energy = 0.5 * float(np.sum(self.weight * residual**2))
        return energy, self.points, Rows(gradient, residual, self.weight)


@dataclass(frozen=True)
class MeanColour:
    """Surface points pull, weakly, to where the image is as bright as their part."""

    name: str = field(default="mean colour", init=False)
    sigma: float = 0.3  # of brightness within a part, [0, 1]
    independent: float = 0.02  # fraction of the samples that is
    every: int = 6  # pixels from sample to sample
    memory_frames: float = 20.0  # a part's colour is the mean of about as many frames
    blur: float = 2.0  # pixels

    def start(self, body: Body, rig: Rig) -> ColourMemory:
        """Nothing is known."""
        cameras, parts = len(rig.cameras), len(body.segment_names)
        return ColourMemory(np.zeros((cameras, parts, 3)), np.zeros((cameras, parts)))

    def measure(self, sight: Sight, memory: ColourMemory, level: Level) -> Evidence | None:
        """The term of one camera, on a grid of pixels of the parts that it remembers."""
        part = sight.seen.part
        grid = np.zeros(part.shape, bool)
        grid[:: self.every, :: self.every] = True
        known = memory.frames[sight.camera_index] > 0
        rows, columns = np.nonzero(grid & (part >= 0) & known[part])
        if not len(rows):
            return None
        points = sight.seen.surface_points(rows.astype(np.int32), columns.astype(np.int32))
        smooth = gaussian_filter(colours(sight.view.image).mean(axis=2), self.blur * level.reach)
        expected = memory.mean[sight.camera_index, part[rows, columns]].mean(axis=1)
        weight = np.full(len(rows), self.independent / self.sigma**2)
        term = LevelTerm(points, weight, sight.view.camera.P, smooth, expected)
        return Evidence(term, len(rows), None)

    def learn(self, memory: ColourMemory, fit: Fit, lesson: int) -> ColourMemory:
        """The means go towards this frame's."""
        if lesson == 0:
            return memory
        mean, frames = memory.mean.copy(), memory.frames.copy()
        for sight in fit.sights:
            camera, part = sight.camera_index, sight.seen.part
            image = colours(sight.view.image)
            for k in np.unique(part[part >= 0]):
                now = image[part == k].mean(axis=0)
                frames[camera, k] += lesson
                step = lesson / min(frames[camera, k], self.memory_frames)
                mean[camera, k] += min(step, 1.0) * (now - mean[camera, k])
        return ColourMemory(mean, frames)
