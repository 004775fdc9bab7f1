"""Skin weights that are moved from segment to segment, outward from the root, and the rest pose under them."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Float, Int


class Binding:
    """Weights (V, S) of V vertices, all on the first segment at first."""

    def __init__(self, segments: tuple[str, ...], vertices: int) -> None:
        self.number = {name: i for i, name in enumerate(segments)}
        self.weights = np.zeros((vertices, len(segments)))
        self.weights[:, 0] = 1.0

    def move(self, above: str, below: str, fraction: Float) -> None:
        """Move a fraction (V,) of the weight to the segment below, if the body has both."""
        if above in self.number and below in self.number:
            moved = self.weights[:, self.number[above]] * fraction
            self.weights[:, self.number[above]] -= moved
            self.weights[:, self.number[below]] += moved


def ramp(x: Float, centre: float, half_width: float) -> Float:
    """Smooth step from 0 to 1 around a centre."""
    t = np.clip((x - centre) / (2 * half_width) + 0.5, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def strongest(weights: Float, count: int = 4, least: float = 0.0) -> tuple[Int, Float]:
    """The strongest segments (V, count) of each vertex and their weights, which sum to 1; those below `least` are 0."""
    segments = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(weights, segments, axis=1)
    kept[kept < least] = 0.0
    return segments.astype(np.int32), kept / kept.sum(axis=1, keepdims=True)


def unposed(motions: Float, weights: Float, points: Float) -> Float:
    """Rest positions (V, 3) that linear-blend skinning by motions (V, K, 4, 4) moves to the given points (V, 3)."""
    blended = np.einsum("vk,vkij->vij", weights, motions)
    return np.linalg.solve(blended[:, :3, :3], (points - blended[:, :3, 3])[..., None])[..., 0]
