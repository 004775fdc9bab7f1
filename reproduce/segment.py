"""Segmentation of an image by a level set alone: no body and no pose, only two regions that look different.

The flow of Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", eq. 11.6: as `evolve`, without
the shape prior. Densities and contour take turns (EM).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Bool, Float32
from twistcap.errors import InputError
from twistcap.region.densities import heaviside
from twistcap.region.levelset import evolve, signed_distance
from twistcap.region.models import RegionModel


@dataclass(frozen=True)
class Evolution:
    """How the contour moves.

    Attributes:
        rounds: how often, at most, densities are estimated anew.
        steps, tau: explicit steps in each round and their size.
        nu: weight of the contour's length, nats · px.
        width: standard deviation of H' in px: from how far the contour feels the image.
        clip: largest log density ratio, nats.
    """

    rounds: int = 100
    steps: int = 4
    tau: float = 4.0
    nu: float = 4.0
    width: float = 3.0
    clip: float = 3.0


def segment(features: Float32, start: Bool, model: RegionModel, how: Evolution | None = None) -> Bool:
    """(H, W) the inner region, grown from `start` (H, W) on channels (H, W, C).

    Every round asks the region model for log p₁/p₂ under the present regions, moves the contour a few steps, and makes
    Φ a signed distance again. It ends early where the contour rests, or
    only wavers. Lengths of the model are in pixels here.

    Raises:
        InputError: if start and image differ in size, or start has no inside or no outside.
    """
    how = how or Evolution()
    if start.shape != features.shape[:2]:
        raise InputError(f"segment: the start is {start.shape}, the image {features.shape[:2]}; give them one size.")
    if start.all() or not start.any():
        raise InputError("segment: the start must leave pixels both inside and outside.")
    region = before = np.asarray(start, dtype=np.bool_)
    for _ in range(how.rounds):
        phi = signed_distance(region)
        inside = heaviside(phi, 0.7)
        ratio = model.log_ratio(features, inside, np.float32(1.0) - inside, 1.0)
        phi = evolve(phi, ratio, how.steps, how.tau * how.width, how.nu, 0.0, how.width, how.clip)
        after = phi > 0.0
        if after.all() or not after.any():
            return region
        if np.array_equal(after, region) or np.array_equal(after, before):
            return after
        before, region = region, after
    return region
