"""Lenses as numbers that an adjustment moves: pinhole and distortion in one vector, with derivatives.

The numbers are ``log fx, log fy, (cx, cy) from the middle of the image`` in units of its longer side, and the
distortion: k1, k2, p1, p2, k3 of OpenCV's model (Brown 1966), or k1 … k4 of its fisheye model (Kannala and Brandt,
DOI 10.1109/TPAMI.2006.153). So all are of the size of an angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twistcap.arrays import Float
from twistcap.camera.calibrated import Camera, distort, distort_fisheye

Kind = Literal["brown", "fisheye"]
_NEWTON = 20  # steps
PINHOLE = 4  # numbers before those of the distortion
# Standard deviations of what is known of any lens before it has seen a board; the second is that of log fy/fx, the
# first is not used.
_KNOWN: dict[Kind, tuple[float, ...]] = {
    "brown": (1.0, 0.01, 0.03, 0.03, 0.5, 0.5, 0.01, 0.01, 0.5),
    "fisheye": (1.0, 0.01, 0.03, 0.03, 0.2, 0.2, 0.2, 0.2),
}


@dataclass(frozen=True)
class Lens:
    """The kind of a lens, and the size (w, h) px of its images; its numbers are kept apart, as a `Vector`."""

    kind: Kind
    size: tuple[int, int]

    @property
    def side(self) -> float:
        """Longer side of the image, px."""
        return float(max(self.size))

    @property
    def middle(self) -> Float:
        """(2,) px."""
        return 0.5 * (np.array(self.size, float) - 1.0)

    @property
    def sigmas(self) -> Float:
        """(n,) standard deviations of what is known before: see `KnownLens`."""
        return np.array(_KNOWN[self.kind])

    def numbers(self, K: Float, dist: Float) -> Float:
        """(n,) of an intrinsic matrix and distortion coefficients; those that are missing are 0."""
        centre = (K[:2, 2] - self.middle) / self.side
        bent = np.zeros(len(self.sigmas) - PINHOLE)
        bent[: len(dist)] = dist[: len(bent)]
        return np.concatenate([np.log([K[0, 0], K[1, 1]]), centre, bent])

    def matrix(self, numbers: Float) -> Float:
        """(3, 3) intrinsic matrix, px."""
        K = np.diag([*np.exp(numbers[:2]), 1.0])
        K[:2, 2] = self.middle + self.side * numbers[2:PINHOLE]
        return K

    def camera(self, name: str, numbers: Float, T_cam_world: Float) -> Camera:
        """The camera with these numbers at a place."""
        dist = np.zeros(5)
        dist[: len(numbers) - PINHOLE] = numbers[PINHOLE:]
        return Camera(name, self.matrix(numbers), T_cam_world, self.size, dist, self.kind == "fisheye")

    def normalised(self, numbers: Float, pixels: Float) -> Float:
        """(N, 2) image-plane coordinates at depth 1 of pixels (N, 2), by Newton's method; NaN where there are none."""
        wanted = (pixels - self.middle - self.side * numbers[2:PINHOLE]) / np.exp(numbers[:2])
        bend = _brown if self.kind == "brown" else _fisheye
        dist = numbers[PINHOLE:]
        xy = wanted.copy() if self.kind == "brown" else _equidistant(wanted)
        last = xy
        with np.errstate(all="ignore"):
            for left in reversed(range(_NEWTON)):
                bent, by_xy = bend(xy, dist)
                det = by_xy[:, 0, 0] * by_xy[:, 1, 1] - by_xy[:, 0, 1] * by_xy[:, 1, 0]
                r = wanted - bent
                by_x, by_y = by_xy[:, :, 0], by_xy[:, :, 1]
                across = by_y[:, 1] * r[:, 0] - by_y[:, 0] * r[:, 1]
                step = np.stack([across, by_x[:, 0] * r[:, 1] - by_x[:, 1] * r[:, 0]], axis=1)
                earlier, last, xy = last, xy, xy + np.clip(step / det[:, None], -0.5, 0.5)
                if np.array_equal(xy, earlier, equal_nan=True):  # it rests, or its last bits go to and fro for ever
                    xy = last if left % 2 else xy  # as after all steps
                    break
            missed = np.abs(bend(xy, dist)[0] - wanted).max(axis=1)
        return np.where((missed < 1e-6)[:, None], xy, np.nan)

    def pixels(self, numbers: Float, points: Float) -> Float:
        """Pixels (N, 2) of camera points (N, 3) before the camera."""
        xy = points[:, :2] / points[:, 2:]
        bent = distort_fisheye if self.kind == "fisheye" else distort
        return np.exp(numbers[:2]) * bent(xy, numbers[PINHOLE:]) + self.middle + self.side * numbers[2:PINHOLE]

    def project(self, numbers: Float, points: Float) -> tuple[Float, Float, Float]:
        """Pixels (N, 2) of camera points (N, 3) before the camera, with their derivatives by the points (N, 2, 3) and
        by the numbers (N, 2, n).
        """
        depth = points[:, 2:]
        xy = points[:, :2] / depth
        dist = numbers[PINHOLE:]
        bent, by_xy = _brown(xy, dist) if self.kind == "brown" else _fisheye(xy, dist)
        by_dist = _brown_by_dist(xy) if self.kind == "brown" else _fisheye_by_dist(xy)
        focal = np.exp(numbers[:2])
        pixels = focal * bent + self.middle + self.side * numbers[2:PINHOLE]
        by_xy = focal[:, None] * by_xy
        by_points = np.concatenate([by_xy, -by_xy @ xy[..., None]], axis=2) / depth[..., None]
        by_numbers = np.zeros((len(points), 2, len(numbers)))
        by_numbers[:, [0, 1], [0, 1]] = focal * bent
        by_numbers[:, [0, 1], [2, 3]] = self.side
        by_numbers[:, :, PINHOLE:] = focal[:, None] * by_dist
        return pixels, by_points, by_numbers


def _equidistant(bent: Float) -> Float:
    """Image-plane coordinates (N, 2) of those that a fisheye without distortion makes of them."""
    theta = np.linalg.norm(bent, axis=1)
    return bent * (np.tan(np.minimum(theta, 1.5)) / np.maximum(theta, 1e-9))[:, None]


def _brown(xy: Float, dist: Float) -> tuple[Float, Float]:
    """OpenCV's five-parameter model of image-plane coordinates (N, 2), with derivatives (N, 2, 2).

    Columns are written into whole arrays: `np.stack` took a third of the time of a calibration.
    """
    k1, k2, p1, p2, k3 = dist
    x, y = xy.T
    r2 = x * x + y * y
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    bent = xy * radial[:, None]
    bent[:, 0] += 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent[:, 1] += p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    by_xy = 2.0 * slope[:, None, None] * xy[:, :, None] * xy[:, None, :]
    by_xy[:, 0, 0] += radial + 2 * p1 * y + 6 * p2 * x
    by_xy[:, 1, 1] += radial + 6 * p1 * y + 2 * p2 * x
    cross = 2 * p1 * x + 2 * p2 * y
    by_xy[:, 0, 1] += cross
    by_xy[:, 1, 0] += cross
    return bent, by_xy


def _brown_by_dist(xy: Float) -> Float:
    """(N, 2, 5) derivative of `_brown` by the coefficients."""
    x, y = xy.T
    r2 = x * x + y * y
    out = np.empty((len(xy), 2, 5))
    for k, power in ((0, r2), (1, r2 * r2), (4, r2**3)):
        out[:, :, k] = xy * power[:, None]
    out[:, 0, 2] = out[:, 1, 3] = 2 * x * y
    out[:, 1, 2], out[:, 0, 3] = r2 + 2 * y * y, r2 + 2 * x * x
    return out


def _fisheye(xy: Float, dist: Float) -> tuple[Float, Float]:
    """OpenCV's fisheye model of image-plane coordinates (N, 2), with derivatives (N, 2, 2)."""
    r, r2, theta, powers = _radii(xy)
    bent = theta + powers @ dist
    slope = 1.0 + (powers / theta[:, None]) @ (dist * np.arange(3, 10, 2))
    ratio = bent / r
    by_r2 = (slope / (1.0 + r2) - ratio) / r2
    by_xy = by_r2[:, None, None] * xy[:, :, None] * xy[:, None, :] + ratio[:, None, None] * np.eye(2)
    return xy * ratio[:, None], by_xy


def _fisheye_by_dist(xy: Float) -> Float:
    """(N, 2, 4) derivative of `_fisheye` by the coefficients."""
    r, _, _, powers = _radii(xy)
    return (xy / r[:, None])[:, :, None] * powers[:, None, :]


def _radii(xy: Float) -> tuple[Float, Float, Float, Float]:
    """(N,) radius, its square, the angle from the axis; and (N, 4) the powers of the angle in the model."""
    r2 = np.maximum(np.sum(xy * xy, axis=1), 1e-12)
    r = np.sqrt(r2)
    theta = np.arctan(r)
    return r, r2, theta, theta[:, None] ** np.arange(3, 10, 2)
