"""Cameras about a board that is carried about, and what they see of it: projected points with noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap.calibrate.board import Board, board_of
from twistcap.calibrate.lens import Kind, Lens
from twistcap.calibrate.sightings import Sighting
from twistcap.camera import Camera, Rig, look_at

SIZE = (1280, 720)
BIG = board_of("charuco:9x6:120:90:4X4_50")


@dataclass(frozen=True)
class Filmed:
    """The truth, and sightings of it; `boards` (4, 4) board to world, by moment."""

    rig: Rig
    boards: dict[int, np.ndarray]
    sightings: list[Sighting]
    board: Board


def ring_rig(
    count: int, rng: np.random.Generator, kind: Kind = "brown", distance: float = 3.0, arc: float = 2 * np.pi
) -> Rig:
    """Cameras in a ring, or an arc (rad) of it, that look at its middle."""
    cameras = list[Camera]()
    for c in range(count):
        angle = arc * c / count + 0.1 * rng.normal()
        eye = distance * np.array([np.cos(angle), np.sin(angle), 0.4 + 0.1 * rng.normal()])
        focal = (900.0 if kind == "brown" else 400.0) * np.exp(0.1 * rng.normal())
        K = np.array([[focal, 0, 640 + 8 * rng.normal()], [0, focal, 360 + 8 * rng.normal()], [0, 0, 1]])
        spread = [0.1, 0.05, 1e-3, 1e-3, 0.01] if kind == "brown" else [0.05, 0.01, 3e-3, 1e-3, 0.0]
        dist = np.array(spread) * rng.normal(size=5)
        cameras.append(Camera(f"cam{c}", K, look_at(eye, [0, 0, 1.0]), SIZE, dist, kind == "fisheye"))
    return Rig(tuple(cameras))


def carried(rng: np.random.Generator, reach: float = 0.8) -> np.ndarray:
    """(4, 4) board to world of a board that is held upright or tilted, facing anywhere."""
    upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
    turn = se3.exp_rotation([0, 0, rng.uniform(0, 2 * np.pi)]) @ se3.exp_rotation(0.4 * rng.normal(size=3)) @ upright
    return se3.transform(turn, rng.uniform(-reach, reach, 3) + np.array([0, 0, 1.0]))


def seen_by(camera: Camera, T: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """Ids and pixels of the points of a board at T that a camera sees on its face."""
    world = se3.apply(T, board.points)
    view = world.mean(axis=0) - camera.centre
    pixels, depth = camera.project(world)
    inside = (depth > 0.2) & np.all((pixels > 0) & (pixels < np.array(camera.size)), axis=1)
    if view @ T[:3, 2] < 0.35 * np.linalg.norm(view) or inside.sum() < 8:
        inside[:] = False
    return np.flatnonzero(inside).astype(np.int32), pixels[inside]


def filmed(
    seed: int, cameras: int = 4, moments: int = 60, noise: float = 0.2, wrong: float = 0.02, kind: Kind = "brown",
    board: Board = BIG,
) -> Filmed:  # fmt: skip
    """A rig, and what it sees; `wrong` of the points are 30 px off. The board lies on the floor at moment 0."""
    rng = np.random.default_rng(seed)
    rig = ring_rig(cameras, rng, kind, 3.0 if kind == "brown" else 1.6)
    boards, out = dict[int, np.ndarray](), list[Sighting]()
    for m in range(moments):
        boards[m] = se3.transform(np.diag([1.0, -1, -1]), [-0.4, 0.3, 0.0]) if m == 0 else carried(rng)
        for c, camera in enumerate(rig):
            ids, pixels = seen_by(camera, boards[m], board)
            bad = rng.uniform(size=len(ids)) < wrong
            pixels = (
                pixels + noise * rng.normal(size=pixels.shape) + 30.0 * bad[:, None] * rng.normal(size=pixels.shape)
            )
            if len(ids):
                out.append(Sighting(c, m, ids, pixels, 2.0))
    return Filmed(rig, boards, out, board)


def numbers_of(camera: Camera) -> tuple[Lens, np.ndarray]:
    """The lens of a camera, and its numbers."""
    lens = Lens("fisheye" if camera.fisheye else "brown", camera.size)
    return lens, lens.numbers(camera.K, camera.dist)


def in_world_of(rig: Rig, T: np.ndarray) -> Rig:
    """The rig in the world into which `T` (4, 4) leads from its own."""
    back = se3.inverse(T)
    return Rig(tuple(replace(camera, T_cam_world=camera.T_cam_world @ back) for camera in rig))
