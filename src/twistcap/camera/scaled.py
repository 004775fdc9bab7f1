"""Scaled orthography: a view of a body is a turn, a scale and a shift in the image.

``(x, y) = shift + s (R X)_xy`` (Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998,
DOI 10.1109/CVPR.1998.698581). X is in the body's own frame, so that several views have only the joint angles in common.

Beyond the paper: with a known intrinsic matrix the same six numbers are the body's pose before that pinhole camera.
Without perspective, close views would be explained by a wrong turn of the trunk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.camera.calibrated import Camera
from twistcap.camera.projection import OF_W
from twistcap.errors import InputError

REACH = 4.0  # m; nearness at the origin of the body's frame, large enough to be above 0 on all of the body
ROOT = 6
"""Numbers of a view's own motion: relative scale, shift in x and y (px), turn about x, y and z of the camera (rad)."""


@dataclass(frozen=True)
class ScaledView:
    """The body's pose in one camera.

    Attributes:
        rotation: (3, 3) body frame to camera (x right, y down, z forward).
        scale, shift: px/m, and the image (2,) of the body frame's origin, px.
        K: (3, 3) intrinsic matrix of a pinhole camera, px; None for scaled orthography.
        size: (width, height) of its image, px; (0, 0) where it is not known yet.
    """

    rotation: Float
    scale: float
    shift: Float
    K: Float | None = None
    size: tuple[int, int] = (0, 0)

    def pixels(self, points: Float) -> Float:
        """Pixels (..., 2) of points (..., 3) m of the body frame. Raises InputError where one is behind a pinhole."""
        P = self.P
        homogeneous = points @ P[:, :3].T + P[:, 3]
        if not np.all(homogeneous[..., 2] > 0.0):
            raise InputError("differential: part of the body is behind a camera; perspective needs all of it in front.")
        return homogeneous[..., :2] / homogeneous[..., 2:]

    @cached_property
    def P(self) -> Float:
        """(3, 4) projection of a point of the body frame to its pixel; affine where no K is known."""
        if self.K is not None:
            return self.K @ self._T_cam_body(self.K)[:3]
        out = np.zeros((3, 4))
        out[:2, :3], out[:2, 3], out[2, 3] = self.scale * self.rotation[:2], self.shift, 1.0
        return out

    @property
    def inverse_depth(self) -> bool:
        """False; see `AnyCamera`."""
        return False

    @cached_property
    def nearness_row(self) -> Float:
        """(4,) for a nearness of `REACH` at the origin that falls, there or everywhere, by 1 per metre of depth."""
        if self.K is None:
            return np.append(-self.rotation[2], REACH)
        at = self.P[2, 3]
        return (REACH - at) * self.P[2] + at * at * OF_W

    def px_per_m(self, nearness: Float) -> float:
        """Image scale at the origin, px/m, whatever the nearness."""
        return self.scale

    @property
    def dof(self) -> int:
        return ROOT

    def retract(self, phi: Float) -> ScaledView:
        """The view after the motion φ = (s', v₁, v₂, ω_x, ω_y, ω_z), growth and turn about the image of the origin."""
        turned = se3.orthonormalised(se3.transform(se3.exp_rotation(phi[3:]) @ self.rotation, np.zeros(3)))[:3, :3]
        return replace(self, rotation=turned, scale=self.scale * float(np.exp(phi[0])), shift=self.shift + phi[1:3])

    def root_step(self) -> Float:
        """(6, 6) derivative by φ of the body's twist (ω, v; about its origin, in its frame); without K 0 by s'."""
        out = np.zeros((ROOT, ROOT))
        out[:3, 3:] = self.rotation.T
        if self.K is None:
            out[3:, 1:3] = self.rotation[:2].T / self.scale
            return out
        T = self._T_cam_body(self.K)
        at, far = T[:3, 3], float(np.linalg.norm(T[:3, 3]))
        moved = np.zeros((3, 3))  # of the origin by s', v₁, v₂
        moved[:, 0], moved[:2, 1:] = -at, at[2] * np.linalg.inv(self.K[:2, :2])
        n = at / far
        bisector = n + np.array([0.0, 0.0, 1.0])  # the least turn from the optical axis to n turns so as n moves
        out[:3, :3] = T[:3, :3].T @ se3.hat(bisector) @ (moved - np.outer(n, n @ moved)) / (far * bisector[2])
        out[3:, :3] = T[:3, :3].T @ moved
        return out

    def minus(self, other: ScaledView) -> Float:
        """The motion (6,) that `retract` needs to come from `other` to this view."""
        turn = se3.log_rotation(self.rotation @ other.rotation.T)
        return np.concatenate([[np.log(self.scale / other.scale)], self.shift - other.shift, turn])

    def scaled(self, factor: float) -> ScaledView:
        """The view in the image resized by `factor`, rounded down to whole pixels, whose centres stay at integers."""
        half = 0.5 * (factor - 1.0)
        K = None if self.K is None else np.array([[factor, 0, half], [0, factor, half], [0, 0, 1.0]]) @ self.K
        size = (int(factor * self.size[0]), int(factor * self.size[1]))
        return replace(self, scale=factor * self.scale, shift=factor * self.shift + half, K=K, size=size)

    def cropped(self, origin: tuple[int, int], size: tuple[int, int]) -> ScaledView:
        """The view in the window of its image that starts at pixel `origin` (x, y) and is `size` (w, h) large."""
        shift = np.array([[0.0, 0.0, origin[0]], [0.0, 0.0, origin[1]], [0.0, 0.0, 0.0]])
        K = None if self.K is None else self.K - shift
        return replace(self, shift=self.shift - np.array(origin), K=K, size=size)

    @staticmethod
    def of(camera: Camera, root: Float, perspective: bool = False) -> ScaledView:
        """A pinhole camera's view of a body at `root` (4, 4), exact at its origin, with `perspective` everywhere."""
        at = se3.apply(camera.T_cam_world, root[None, :3, 3])[0]
        towards = _towards(at)
        scale = 0.5 * float(camera.K[0, 0] + camera.K[1, 1]) / float(np.linalg.norm(at))
        stretch = float(np.linalg.norm(at) / at[2])  # off the axis a pinhole images things larger
        K = camera.K if perspective else None
        pixel = camera.K[:2, :2] @ (at[:2] / at[2]) + camera.K[:2, 2]
        return ScaledView(towards @ camera.T_cam_world[:3, :3] @ root[:3, :3], scale * stretch, pixel, K, camera.size)

    def root(self, camera: Camera) -> Float:
        """(4, 4) root motion of the body, rest to world, by a pinhole camera of known focal length; inverse of `of`."""
        T, R, t = self._T_cam_body(camera.K), camera.T_cam_world[:3, :3], camera.T_cam_world[:3, 3]
        return se3.transform(R.T @ T[:3, :3], R.T @ (T[:3, 3] - t))

    def _T_cam_body(self, K: Float) -> Float:
        """(4, 4) body frame to a pinhole camera."""
        xy = np.linalg.solve(K[:2, :2], self.shift - K[:2, 2])
        at = 0.5 * float(K[0, 0] + K[1, 1]) / self.scale * np.array([xy[0], xy[1], 1.0])
        return se3.transform(_towards(at).T @ self.rotation, at)


def _towards(at: Float) -> Float:
    """(3, 3) the smallest rotation that takes the direction of a camera point (3,) to the optical axis."""
    n = at / np.linalg.norm(at)
    axis = np.cross(n, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    return np.eye(3) if sine < 1e-12 else se3.exp_rotation(axis / sine * np.arctan2(sine, n[2]))
