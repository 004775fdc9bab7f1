"""Landmarks of a body against 2D keypoints, with rows on whatever is free: poses, shape, camera, clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import Posed
from twistcap.camera import Camera, pinhole
from twistcap.terms.protocols import Slope, Sums
from twistcap.terms.robust import geman_mcclure

if TYPE_CHECKING:
    from twistcap.solve.blocks import Moment, Variables

_NEAREST = 0.05  # m before the camera; nearer points get the residual _WRONG
_WRONG = 1e6  # standard deviations


@dataclass(frozen=True)
class ReprojectionTerm:
    """N landmarks at one frame of the track against keypoints in one view: Geman and McClure's loss of each distance.

    A camera whose clock has an offset of τ s shows the pose at τ after (below 0, before) the frame's time, interpolated
    between two frames of the track.

    Attributes:
        marks: (N,) landmarks of the body.
        target: (N, 2) px of the pinhole camera.
        weight, sigma: (N,) confidence, 0 for missing keypoints; standard deviation, px.
        reach: standard deviations from which a keypoint is down-weighted.
        camera, poses, shape: names of the blocks: a `CameraBlock`, a `PoseTrack`, and one with `body`, and
            `rates(posed)` (L, 3, K), the derivative of the landmarks by its step.
        clock: name of the block of the clock's offset, a `Vector` of τ (s) alone; None for an offset of 0.
    """

    marks: Int
    target: Float
    weight: Float
    sigma: Float
    reach: float
    camera: str
    poses: str = "poses"
    shape: str = "shape"
    frame: int = 0
    clock: str | None = None
    name: str = "keypoints"

    def energy(self, x: Variables) -> float:
        pixels, depth, _ = pinhole(x[self.camera].camera.P, self._posed(x).landmarks[self.marks])
        return float(np.sum(self.weight * geman_mcclure(self._squares(pixels, depth), self.reach)[0]))

    def add_to(self, sums: Sums, x: Variables) -> None:
        camera, points = x[self.camera].camera, self._posed(x).landmarks[self.marks]
        pixels, depth, by_point = pinhole(camera.P, points)
        squares, before = self._squares(pixels, depth), depth > _NEAREST
        energy, weight = geman_mcclure(squares, self.reach)
        scale = np.where(before, 1.0 / self.sigma, 0.0)[:, None]
        residual, by_point = scale * (pixels - self.target), scale[..., None] * by_point
        rows = np.repeat(np.where(before, self.weight * weight, 0.0), 2)
        slopes = self._slopes(x, by_point)
        if self.camera in x.free:
            by_camera = scale[..., None] * camera_rates(camera, points)[..., : x[self.camera].dof]
            slopes.append(Slope(self.camera, by_camera.reshape(len(rows), -1)))
        sums.add_rows(float(np.sum(self.weight * energy)), slopes, rows, residual.ravel())

    def _squares(self, pixels: Float, depth: Float) -> Float:
        offset = (pixels - self.target) / self.sigma[:, None]
        return np.where(depth > _NEAREST, np.sum(offset * offset, axis=1), _WRONG**2)

    def _slopes(self, x: Variables, by_point: Float) -> list[Slope]:
        """Rows (2 N, …) by poses, shape and clock, of residuals whose derivatives by the points are (N, 2, 3)."""
        posed, N = self._posed(x), 2 * len(self.marks)
        by_pose = self._once(x, "pose", lambda: _landmark_jacobian(posed))[self.marks]
        rows = (by_point @ by_pose).reshape(N, -1)
        if self.clock is None:
            slopes = [Slope(self.poses, rows, self.frame * rows.shape[1])]
        else:
            at = self._moment(x)
            pairs = zip(at.frames, at.by_frame, strict=True)
            slopes = [Slope(self.poses, rows @ by_frame, k * rows.shape[1]) for k, by_frame in pairs]
            slopes.append(Slope(self.clock, (rows @ at.velocity)[:, None]))
        if self.shape in x.free:
            by_shape = self._once(x, "shape", lambda: x[self.shape].rates(posed))[self.marks]
            slopes.append(Slope(self.shape, (by_point @ by_shape).reshape(N, -1)))
        return slopes

    def _moment(self, x: Variables) -> Moment:
        assert self.clock is not None
        track, late = x[self.poses], x[self.clock].values[0]
        return self._once(x, "moment", lambda: track.at(float(track.times[self.frame] + late)))

    def _posed(self, x: Variables) -> Posed:
        def make() -> Posed:
            pose = x[self.poses].poses[self.frame] if self.clock is None else self._moment(x).pose
            return Posed(x[self.shape].body, pose)

        return self._once(x, "posed", make)

    def _once(self, x: Variables, what: str, make: Callable[[], Any]) -> Any:
        """A result that other views of the same instant need too, computed once."""
        key = (what, self.poses, self.shape, self.frame, self.clock)
        if key not in x.memo:
            x.memo[key] = make()
        return x.memo[key]


def _landmark_jacobian(posed: Posed) -> Float:
    """(L, 3, 6 + J) derivative of the landmarks by the pose step."""
    marks = posed.body.landmarks
    return posed.point_jacobian(marks.segments[:, None], np.ones((len(marks.segments), 1)), marks.points)


def camera_rates(camera: Camera, points: Float) -> Float:
    """(N, 2, 7) derivative of the pinhole pixels of points (N, 3) by the camera: left twist of `T_cam_world`, log f."""
    seen = se3.apply(camera.T_cam_world, points)
    pixels, _, by_seen = pinhole(np.concatenate([camera.K, np.zeros((3, 1))], axis=1), seen)
    by_focal = pixels - camera.K[:2, 2]
    return np.concatenate([by_seen @ -se3.hat(seen), by_seen, by_focal[..., None]], axis=2)
