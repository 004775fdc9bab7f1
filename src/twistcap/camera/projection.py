"""A projection and its derivative, for any camera: a pinhole's or scaled orthography's 3×4 matrix P.

A point X has ``(x / w, y / w, 1 / w) = P (X, 1)``: its pixel (x, y), and w, which is a pinhole's inverse depth in 1/m
and 1 for a parallel projection, whose P ends in (0, 0, 0, 1). Nearness is linear in the image and grows towards the
camera: an inverse depth (1/m), or for scaled views a negative depth plus a constant (m).
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np
from numba import njit

from twistcap.arrays import Float

NEAR = 1e-3  # m before the camera; nearer points have no image
OF_W = np.array([0.0, 0.0, 0.0, 1.0])
"""`AnyCamera.nearness_row` where nearness is w itself."""


class AnyCamera(Protocol):
    """A camera, as far as rendering a body and comparing it with an image need it."""

    @cached_property
    def P(self) -> Float:
        """(3, 4) projection; the third row of a pinhole's has unit direction, so that it gives metres."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        ...

    @property
    def inverse_depth(self) -> bool:
        """Whether nearness is the inverse depth w, 1/m; otherwise a negative depth plus a constant, m."""
        ...

    @cached_property
    def nearness_row(self) -> Float:
        """(4,) n, with which the nearness of a point X is ``n (X, 1)`` times its w."""
        ...

    def px_per_m(self, nearness: Float) -> float:
        """Image scale at points of these nearnesses (N,), px/m; those of 0 are left out."""
        ...


def projected(camera: AnyCamera, points: Float) -> tuple[Float, Float]:
    """Pixels (N, 2) and nearness (N,) of points (N, 3); nearness 0 where a point is not before the camera."""
    pixels, w = project(camera.P, points)
    row = camera.nearness_row
    return pixels, w if camera.inverse_depth else w * (points @ row[:3] + row[3])


@njit(cache=True, nogil=True)
def project(P: Float, points: Float) -> tuple[Float, Float]:
    """Pixels (N, 2) and w (N,) of points (N, 3); 0 where a point is not before the camera."""
    N = len(points)
    pixels, inverse_depth = np.empty((N, 2)), np.empty(N)
    for n in range(N):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        w = 1.0 / depth if depth > NEAR else 0.0
        inverse_depth[n] = w
        pixels[n, 0] = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) * w
        pixels[n, 1] = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) * w
    return pixels, inverse_depth


def project_reference(P: Float, points: Float) -> tuple[Float, Float]:
    """Readable twin of `project`."""
    homogeneous = points @ P[:, :3].T + P[:, 3]
    depth = homogeneous[:, 2]
    w = 1.0 / np.where(depth > NEAR, depth, np.inf)
    return homogeneous[:, :2] * w[:, None], w


@njit(cache=True, nogil=True, inline="always")
def depth_at(nearness: float, inverse: bool) -> float:
    """Depth, m, of a nearness other than 0; up to a constant where that is no `inverse` depth."""
    return 1.0 / nearness if inverse else -nearness


@njit(cache=True, nogil=True, inline="always")
def along(P: Float, x: float, y: float, a: float, b: float) -> tuple[float, float, float]:
    """Derivative of ``a x + b y`` by the point with the pixel (x, y), divided by its w."""
    return (
        a * (P[0, 0] - x * P[2, 0]) + b * (P[1, 0] - y * P[2, 0]),
        a * (P[0, 1] - x * P[2, 1]) + b * (P[1, 1] - y * P[2, 1]),
        a * (P[0, 2] - x * P[2, 2]) + b * (P[1, 2] - y * P[2, 2]),
    )


def depth_at_reference(nearness: float, inverse: bool) -> float:
    """Readable twin of `depth_at`."""
    return 1.0 / nearness if inverse else -nearness


def along_reference(P: Float, x: float, y: float, a: float, b: float) -> tuple[float, float, float]:
    """Readable twin of `along`."""
    out = np.array([a, b]) @ (P[:2, :3] - np.outer([x, y], P[2, :3]))
    return float(out[0]), float(out[1]), float(out[2])
