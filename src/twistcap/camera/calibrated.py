"""Calibrated cameras: pinhole with OpenCV's distortion, or its fisheye lens, and rigs of them.

x right, y down, z forward; pixel centres at integers; ``X_cam = T_cam_world X_world`` (metres).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike

from twistcap import se3
from twistcap.arrays import AnyArray, Float, Float32
from twistcap.camera.projection import OF_W


@dataclass(frozen=True)
class Camera:
    """One calibrated camera, its name as in the calibration file.

    Attributes:
        K, size: (3, 3) intrinsic matrix and (width, height), pixels.
        T_cam_world: (4, 4) world to camera, metres.
        dist: (5,) OpenCV distortion k1, k2, p1, p2, k3; of a fisheye lens k1, k2, k3, k4, 0.
        fisheye: whether the lens is OpenCV's fisheye model.
    """

    name: str
    K: Float
    T_cam_world: Float
    size: tuple[int, int]
    dist: Float = field(default_factory=lambda: np.zeros(5))
    fisheye: bool = False

    @property
    def distorts(self) -> bool:
        """Whether its images are others than those of `pinhole`."""
        return self.fisheye or bool(np.any(self.dist))

    @property
    def centre(self) -> Float:
        """(3,) optical centre in the world, metres."""
        R, t = self.T_cam_world[:3, :3], self.T_cam_world[:3, 3]
        return -R.T @ t

    @cached_property
    def P(self) -> Float:
        """(3, 4) pinhole projection matrix ``K [R | t]``; it knows nothing of distortion."""
        return self.K @ self.T_cam_world[:3]

    @property
    def inverse_depth(self) -> bool:
        """True: nearness is inverse depth; see `AnyCamera`."""
        return True

    @cached_property
    def nearness_row(self) -> Float:
        """(4,) by which nearness is the inverse depth, 1/m."""
        return OF_W

    def px_per_m(self, nearness: Float) -> float:
        """Image scale, px/m: focal length times mean inverse depth; 0 where nothing is before the camera."""
        seen = nearness[nearness > 0]
        return float(self.K[0, 0] * seen.mean()) if len(seen) else 0.0

    def project(self, points: ArrayLike) -> tuple[Float, Float]:
        """World points (..., 3) m to pixels (..., 2) and depths (...,) m; distortion included.

        Points at or behind the camera plane get NaN pixels.
        """
        X = np.asarray(points, float) @ self.T_cam_world[:3, :3].T + self.T_cam_world[:3, 3]
        depth = X[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.where(depth[..., None] > 0, X[..., :2] / depth[..., None], np.nan)
        xy = self.bent(xy)
        return xy @ self.K[:2, :2].T + self.K[:2, 2], depth

    def normalised(self, pixels: ArrayLike) -> Float:
        """Pixels (..., 2) to undistorted image-plane coordinates (..., 2) at depth 1."""
        px = np.asarray(pixels, float)
        (fx, skew), fy = self.K[0, :2], self.K[1, 1]
        y = (px[..., 1] - self.K[1, 2]) / fy
        x = (px[..., 0] - self.K[0, 2] - skew * y) / fx
        bent = np.stack([x, y], axis=-1)
        return undistort_fisheye(bent, self.dist) if self.fisheye else undistort(bent, self.dist)

    def bent(self, xy: Float) -> Float:
        """Image-plane coordinates (..., 2) as the lens shows them."""
        return distort_fisheye(xy, self.dist) if self.fisheye else distort(xy, self.dist)

    def rays(self, pixels: ArrayLike) -> tuple[Float, Float]:
        """Plücker rays through pixels: unit direction n and moment m = c × n, both (..., 3), world, metres.

        Source: Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", eq. 11.16-11.19.
        """
        xy = self.normalised(pixels)
        R = self.T_cam_world[:3, :3]
        n = xy @ R[:2] + R[2]
        n = n / np.sqrt(np.sum(n * n, axis=-1, keepdims=True))
        return n, n @ se3.hat(self.centre).T

    def scaled(self, factor: float) -> Camera:
        """The camera of the image resized by `factor`."""
        return self.resized((max(1, round(self.size[0] * factor)), max(1, round(self.size[1] * factor))))

    def resized(self, size: tuple[int, int]) -> Camera:
        """The camera of the image resized to `size` (w, h) pixels, whose centres stay at integers."""
        fx, fy = size[0] / self.size[0], size[1] / self.size[1]
        to_small = np.array([[fx, 0.0, 0.5 * fx - 0.5], [0.0, fy, 0.5 * fy - 0.5], [0.0, 0.0, 1.0]])
        return replace(self, K=to_small @ self.K, size=size)

    def cropped(self, origin: tuple[int, int], size: tuple[int, int]) -> Camera:
        """The camera of the window of its image that starts at pixel `origin` (x, y) and is `size` (w, h) large."""
        shift = np.array([[0.0, 0.0, origin[0]], [0.0, 0.0, origin[1]], [0.0, 0.0, 0.0]])
        return replace(self, K=self.K - shift, size=size)

    def pinhole(self) -> Camera:
        """The same camera without distortion, that of images from a `Rectifier`."""
        return replace(self, dist=np.zeros(5), fisheye=False)


def pinhole(P: Float, points: Float) -> tuple[Float, Float, Float]:
    """Pixels (..., 2), depths (...,) m, and the derivative (..., 2, 3) of the pixels by the points (..., 3), m.

    ``π(X) = (h₁, h₂) / h₃`` with ``h = P (X, 1)``; its derivative is ``(P₁₂ − π P₃) / h₃``. Behind the camera (depth 0
    or less) pixels have no meaning. P (..., 3, 4) is one for all points or one for each set (N, 3) of them.
    """
    h = points @ np.swapaxes(P[..., :3], -1, -2) + P[..., None, :, 3]
    depth = h[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = h[..., :2] / depth[..., None]
        by_point = (P[..., None, :2, :3] - pixels[..., None] * P[..., None, 2:, :3]) / depth[..., None, None]
    return pixels, depth, by_point


def distort(xy: Float, dist: Float) -> Float:
    """OpenCV's Brown-Conrady model on image-plane coordinates (..., 2)."""
    k1, k2, p1, p2, k3 = dist
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([u, v], axis=-1)


def undistort(xy: Float, dist: Float) -> Float:
    """Inverse of `distort` by fixed-point iteration; NaN where the model cannot be inverted."""
    if not np.any(dist):
        return xy
    guess = xy.copy()
    error = np.full(xy.shape[:-1], np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(100):
            step = xy - distort(guess, dist)
            guess = guess + step
            error = np.abs(step).max(axis=-1)
            if np.all(error < 1e-12):
                break
        # Beyond the fold of the distortion polynomial the iteration does not converge.
        return np.where((error < 1e-6)[..., None], guess, np.nan)


def distort_fisheye(xy: Float, dist: Float) -> Float:
    """OpenCV's fisheye model on image-plane coordinates (..., 2): a polynomial of the angle to the axis.

    Kannala and Brandt, "A Generic Camera Model and Calibration Method", DOI 10.1109/TPAMI.2006.153.
    """
    r = np.hypot(xy[..., 0], xy[..., 1])
    bent = _bent_angle(np.arctan(r), dist)
    return xy * np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)[..., None]


def undistort_fisheye(xy: Float, dist: Float) -> Float:
    """Inverse of `distort_fisheye` by Newton's method; NaN beyond the fold of the polynomial, or a right angle."""
    bent = np.hypot(xy[..., 0], xy[..., 1])
    theta, powers = np.minimum(bent, 1.5), np.arange(3, 10, 2)
    with np.errstate(all="ignore"):
        for _ in range(20):
            slope = 1.0 + (theta[..., None] ** (powers - 1)) @ (dist[:4] * powers)
            theta = theta - np.clip((_bent_angle(theta, dist) - bent) / slope, -0.3, 0.3)
        good = (np.abs(_bent_angle(theta, dist) - bent) < 1e-9) & (theta >= 0.0) & (theta < 0.499 * np.pi)
        good &= 1.0 + (theta[..., None] ** (powers - 1)) @ (dist[:4] * powers) > 0.0
        stretch = np.where(bent > 1e-9, np.tan(theta) / np.maximum(bent, 1e-9), 1.0)
    return np.where(good[..., None], xy * stretch[..., None], np.nan)


def _bent_angle(theta: Float, dist: Float) -> Float:
    return theta + (theta[..., None] ** np.arange(3, 10, 2)) @ dist[:4]


@dataclass(frozen=True)
class Rig:
    """The cameras of one recording, in one world frame."""

    cameras: tuple[Camera, ...]

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)

    def __getitem__(self, index: int) -> Camera:
        return self.cameras[index]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self.cameras)

    def scaled(self, factor: float) -> Rig:
        return Rig(tuple(camera.scaled(factor) for camera in self.cameras))

    def pinhole(self) -> Rig:
        return Rig(tuple(camera.pinhole() for camera in self.cameras))


class Rectifier:
    """Resamples a camera's images to those of `camera.pinhole()`, without distortion."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera.pinhole()
        self._maps: tuple[Float32, Float32] | None = None
        if camera.distorts:
            width, height = camera.size
            x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
            source = camera.bent(self.camera.normalised(np.stack([x, y], axis=-1)))
            source = source @ camera.K[:2, :2].T + camera.K[:2, 2]
            self._maps = (source[..., 0].astype(np.float32), source[..., 1].astype(np.float32))

    def __call__(self, image: AnyArray, nearest: bool = False) -> AnyArray:
        """One image (H, W[, C]) resampled; `nearest` for masks and labels."""
        if self._maps is None:
            return image
        mode = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        return cv2.remap(image, *self._maps, mode, borderMode=cv2.BORDER_REPLICATE)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Float:
    """(4, 4) `T_cam_world` of a camera at `eye` that looks at `target` with `up` upward in the image."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, np.asarray(up, float))
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return se3.transform(R, -R @ eye)
