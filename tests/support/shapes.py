"""Bodies and cameras whose images are known in closed form, for the tests of rendering, regions and terms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twistcap.body import Body
from twistcap.camera import Camera, look_at

Array = NDArray[np.float64]


def round_mesh(centre: Array, radius: float, length: float = 0.0, rings: int = 128) -> tuple[Array, NDArray[np.int32]]:
    """Closed sphere, or capsule whose axis of `length` m runs up from `centre`: vertices on the surface, and faces."""
    sectors = 2 * rings
    polar = np.concatenate([np.linspace(0, np.pi / 2, rings // 2 + 1), np.linspace(np.pi / 2, np.pi, rings // 2 + 1)])
    lift = np.repeat([length, 0.0], rings // 2 + 1)
    keep = slice(None) if length else np.r_[0 : rings // 2 + 1, rings // 2 + 2 : rings + 2]
    polar, lift = polar[keep][1:-1], lift[keep][1:-1]
    turn = 2 * np.pi * np.arange(sectors) / sectors
    x, y = np.outer(np.sin(polar), np.cos(turn)), np.outer(np.sin(polar), np.sin(turn))
    z = np.repeat(np.cos(polar)[:, None], sectors, axis=1)
    side = radius * np.stack([x, y, z], axis=-1)
    side[..., 2] += lift[:, None]
    poles = np.array([[0, 0, radius + length], [0, 0, -radius]])
    return centre + np.concatenate([side.reshape(-1, 3), poles]), _grid_faces(len(polar), sectors)


def _grid_faces(rows: int, sectors: int) -> NDArray[np.int32]:
    r, s = np.meshgrid(np.arange(rows - 1), np.arange(sectors), indexing="ij")
    a, b = (r * sectors + s).ravel(), (r * sectors + (s + 1) % sectors).ravel()
    c, d = a + sectors, b + sectors
    s0, s1, last = np.arange(sectors), (np.arange(sectors) + 1) % sectors, (rows - 1) * sectors
    top = np.stack([np.full(sectors, rows * sectors), s0, s1], axis=1)
    bottom = np.stack([np.full(sectors, rows * sectors + 1), last + s1, last + s0], axis=1)
    sides = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return np.concatenate([sides, top, bottom]).astype(np.int32)


def two_part_body(first: tuple[Array, NDArray[np.int32]], second: tuple[Array, NDArray[np.int32]]) -> Body:
    """A root part and a second one on a hinge about the world's z axis, both rigid."""
    vertices = np.concatenate([first[0], second[0]])
    n = len(first[0])
    segments = (np.arange(len(vertices)) >= n).astype(np.int32)[:, None]
    return Body(
        name="two parts",
        coordinate_names=("hinge",),
        parent=np.array([-1], np.int32),
        twists=np.array([[0.0, 0, 1, 0, 0, 0]]),
        limits=np.array([[-3.0, 3.0]]),
        segment_names=("torso", "arm"),
        segment_joint=np.array([-1, 0], np.int32),
        vertices=vertices,
        faces=np.concatenate([first[1], second[1] + n]),
        skin_segments=segments,
        skin_weights=np.ones((len(vertices), 1)),
    )


def camera_at(eye: tuple[float, float, float], target: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Camera:
    """A 320 × 240 pinhole camera with f = 300 px and an off-centre principal point."""
    K = np.array([[300.0, 0, 163.3], [0, 310.0, 118.6], [0, 0, 1]])
    return Camera("test", K, look_at(eye, target), (320, 240))


def outline(camera: Camera, a: Array, b: Array, radius: float, pixels: Array) -> tuple[Array, Array]:
    """Signed px distance (N,) of pixels to the outline of the capsule a-b (positive outside), and unit normals (N, 2).

    The outline is where the ray through a pixel passes the axis at just `radius`; first order in the distance.
    """

    def clearance(px: Array) -> Array:
        n, _ = camera.rays(px)
        return _ray_to_segment(camera.centre, n, a, b) - radius

    step = 1e-3
    gradient = np.stack(
        [(clearance(pixels + h) - clearance(pixels - h)) / (2 * step) for h in step * np.eye(2)], axis=1
    )
    slope = np.linalg.norm(gradient, axis=1)
    return clearance(pixels) / slope, gradient / slope[:, None]


def _ray_to_segment(centre: Array, n: Array, a: Array, b: Array) -> Array:
    """Distance (N,) of rays from `centre` along unit n (N, 3) to the segment a-b."""
    u, w = b - a, a - centre
    along = n @ u
    # The place s on the segment that is nearest to the line, held to the segment.
    s = np.clip((along * (n @ w) - u @ w) / np.maximum(u @ u - along**2, 1e-12), 0, 1)
    to_point = w + s[:, None] * u
    return np.linalg.norm(np.cross(to_point, n), axis=1)
