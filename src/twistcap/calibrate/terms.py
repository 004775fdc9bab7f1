"""Points of a solid (a board, a measured scene) against their pixels in images, with rows on all that is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.calibrate.lens import Lens
from twistcap.terms.protocols import Slope, Sums
from twistcap.terms.robust import geman_mcclure

if TYPE_CHECKING:
    from twistcap.solve import Variables

_NEAREST = 0.02  # m before the camera; nearer points get the residual _WRONG
_WRONG = 1e6  # standard deviations


@dataclass(frozen=True)
class Solid:
    """Points that may be a little elsewhere than they were said to be: ``points + bases · numbers``.

    Attributes:
        points: (P, 3) m.
        bases: (P, 3, k), the derivative of the points by the numbers of its shape.
        sigmas: (k,) standard deviations of these numbers.
    """

    points: Float
    bases: Float
    sigmas: Float

    def at(self, numbers: Float) -> Float:
        """(P, 3) points, m."""
        return self.points + self.bases @ numbers


def flat(points: Float) -> Solid:
    """A board that may be stretched along its height and bent: share of its height; depths at its rim, m.

    A board calibrates itself: Strobl and Hirzinger, DOI 10.1109/ICCVW.2011.6130369.
    """
    reach = 0.5 * np.ptp(points[:, :2], axis=0)
    middle = points[:, :2].min(axis=0) + reach
    x, y = ((points[:, :2] - middle) / reach.max()).T
    bases = np.zeros((len(points), 3, 4))
    bases[:, 1, 0] = points[:, 1] - middle[1]
    bases[:, 2, 1:] = np.stack([x * x, x * y, y * y], axis=1)
    return Solid(points, bases, np.array([0.002, *[0.002 + 0.01 * float(reach.max())] * 3]))


def measured(points: Float, sigma: float) -> Solid:
    """Points that were each measured to `sigma` m in every direction."""
    N = len(points)
    return Solid(points, np.eye(3 * N).reshape(N, 3, 3 * N), np.full(3 * N, sigma))


@dataclass(frozen=True)
class SightingTerm:
    """N points of a solid in M images of a camera: Geman and McClure's loss of each distance, or its square where
    `reach` is None. They are projected together, since an image has few points; each image adds rows of its own.

    Attributes:
        solid, ids: the points, and which of them (N,), one image after the other.
        target, sigma: (N, 2) px, and their standard deviations (N,).
        images: which of the points are of each image.
        frames: of the track, one for each image.
        reach: standard deviations from which a point is down-weighted.
        lens: what the numbers in the block `numbers` mean.
        camera, numbers, poses, shape: names of the blocks: a `CameraBlock` for its place, `Vector` of the lens,
            `PoseTrack` of the solid, and `Vector` of its shape.
        clock: name of the block of the camera's clock, a `Vector` of the frames by which it is late; None for a clock
            that is right. `motion` (2, N, 2) says where its points were (see `Sighting`).
    """

    solid: Solid
    ids: Int
    target: Float
    sigma: Float
    images: Sequence[slice]
    frames: Sequence[int]
    reach: float | None
    lens: Lens
    camera: str
    numbers: str
    poses: str
    shape: str
    clock: str | None = None
    motion: Float | None = None
    name: str = "sightings"

    def energy(self, x: Variables) -> float:
        return float(np.sum(self._loss(self._offsets(x))[0]))

    def add_to(self, sums: Sums, x: Variables) -> None:
        turns, world, seen = self._points(x)
        before = seen[:, 2] > _NEAREST
        safe = np.where(before[:, None], seen, [0.0, 0.0, 1.0])
        pixels, by_seen, by_numbers = self.lens.project(x[self.numbers].values, safe)
        scale = np.where(before, 1.0 / self.sigma, 0.0)[:, None]
        residual, by_seen = scale * (pixels - self._target(x)), scale[..., None] * by_seen
        energy, weight = self._loss(np.where(before, np.sum(residual * residual, axis=1), _WRONG**2))
        by_world = by_seen @ x[self.camera].camera.T_cam_world[:3, :3]
        by_pose, weight = by_world @ _moved(world), np.stack([np.where(before, weight, 0.0)] * 2, axis=1)
        shared = dict[str, Float]()
        if self.camera in x.free:
            shared[self.camera] = by_seen @ _moved(seen)
        if self.numbers in x.free:
            shared[self.numbers] = scale[..., None] * by_numbers
        if self.shape in x.free:
            shared[self.shape] = by_world @ turns @ self.solid.bases[self.ids]
        if self.clock is not None and self.motion is not None:
            by_late = self.motion[0] - 2.0 * x[self.clock].values[0] * self.motion[1]
            shared[self.clock] = (scale * by_late)[..., None]
        for own, frame in zip(self.images, self.frames, strict=True):
            slopes = [Slope(self.poses, _rows(by_pose[own]), 6 * frame)]
            slopes += [Slope(block, _rows(by[own])) for block, by in shared.items()]
            sums.add_rows(float(np.sum(energy[own])), slopes, weight[own].ravel(), residual[own].ravel())

    def residuals(self, x: Variables) -> Float:
        """(N, 2) px, seen less measured; NaN behind the camera."""
        seen = self._points(x)[2]
        pixels = self.lens.pixels(x[self.numbers].values, np.where(seen[:, 2:] > _NEAREST, seen, np.nan))
        return pixels - self._target(x)

    def _target(self, x: Variables) -> Float:
        """(N, 2) px, where the points were at the moment that the camera should have shown."""
        if self.clock is None or self.motion is None:
            return self.target
        late = x[self.clock].values[0]
        return self.target - late * self.motion[0] + late * late * self.motion[1]

    def _points(self, x: Variables) -> tuple[Float, Float, Float]:
        """Rotation (N, 3, 3) of the solid at each point; points (N, 3) m in the world, and before the camera."""
        local, poses = self.solid.at(x[self.shape].values)[self.ids], x[self.poses].poses
        roots = np.array([poses[frame].root for frame in self.frames])
        roots = roots.repeat([own.stop - own.start for own in self.images], axis=0)
        world = se3.apply(roots, local[:, None])[:, 0]
        return roots[:, :3, :3], world, se3.apply(x[self.camera].camera.T_cam_world, world)

    def _offsets(self, x: Variables) -> Float:
        """(N,) squares of the distances, in standard deviations."""
        squares = np.sum((self.residuals(x) / self.sigma[:, None]) ** 2, axis=1)
        return np.where(np.isfinite(squares), squares, _WRONG**2)

    def _loss(self, squares: Float) -> tuple[Float, Float]:
        return (0.5 * squares, np.ones_like(squares)) if self.reach is None else geman_mcclure(squares, self.reach)


@dataclass(frozen=True)
class KnownLens:
    """What is known of any lens: square pixels, axis in the middle, little distortion; not its focal length."""

    lens: Lens
    block: str
    name: str = "lens"

    def energy(self, x: Variables) -> float:
        residual = self._rows(x) @ x[self.block].values
        return 0.5 * float(residual @ residual)

    def add_to(self, sums: Sums, x: Variables) -> None:
        rows = self._rows(x)
        residual = rows @ x[self.block].values
        sums.add_rows(self.energy(x), [Slope(self.block, rows)], np.ones(len(rows)), residual)

    def _rows(self, x: Variables) -> Float:
        """(n − 1, n), from which the first number, a common focal length, is left out."""
        rows = np.eye(x[self.block].dof)[1:]
        rows[0, 0] = -1.0
        return rows / self.lens.sigmas[1:, None]


def _moved(points: Float) -> Float:
    """(N, 3, 6) derivative of points by a left twist (ω, v) of the motion that brought them there."""
    return np.concatenate([-se3.hat(points), np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=2)


def _rows(by: Float) -> Float:
    return by.reshape(2 * len(by), -1)
