"""Pairs of images of an analytic texture whose motion is known exactly."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool, Float, Float32

H, W = 96, 120
Y, X = np.mgrid[:H, :W].astype(float)
MIDDLE = np.array([(W - 1) / 2, (H - 1) / 2])


def texture(x: Float, y: Float, seed: int = 0) -> Float32:
    """Smooth analytic texture at any place, in [0, 1]: the same places give the same values."""
    rng = np.random.default_rng(seed)
    total = np.zeros_like(x)
    for _ in range(40):
        k = rng.normal(size=2) * rng.choice([0.12, 0.3, 0.6])
        total += rng.uniform(0.5, 1.0) * np.cos(k[0] * x + k[1] * y + rng.uniform(0, 2 * np.pi))
    return (0.5 + 0.035 * total).astype(np.float32)


def moved(matrix: Float, shift: Float) -> tuple[Float32, Float32, Float32]:
    """Two images and the flow (H, W, 2) of the affine motion x -> A (x - middle) + middle + shift."""
    place = np.stack([X, Y], axis=-1) - MIDDLE
    flow = place @ (matrix - np.eye(2)).T + shift
    back = (place - shift) @ np.linalg.inv(matrix).T + MIDDLE
    return texture(X, Y), texture(back[..., 0], back[..., 1]), flow.astype(np.float32)


def turn(degrees: float) -> Float:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s], [s, c]])


def limb_scene(degrees: float) -> tuple[Float32, Float32, Float32, Bool]:
    """A textured bar of 11 px turns about its upper end before a still background."""
    hinge = np.array([60.0, 12.0])
    flow = (np.stack([X, Y], axis=-1) - hinge) @ (turn(degrees) - np.eye(2)).T
    mask = (np.abs(X - 60) <= 5) & (Y >= 12) & (Y <= 76)
    before = np.stack([X, Y], axis=-1) - hinge
    back = before @ turn(degrees) + hinge  # inverse turn
    there = (np.abs(back[..., 0] - 60) <= 5) & (back[..., 1] >= 12) & (back[..., 1] <= 76)
    behind = texture(X, Y, seed=2)
    second = np.where(there, texture(back[..., 0], back[..., 1]), behind)
    return np.where(mask, texture(X, Y), behind), second.astype(np.float32), flow.astype(np.float32), mask
