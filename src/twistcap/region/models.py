"""Appearance models of the two regions: each pixel's log density ratio, inside to outside.

After Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", section 11.2, which compares local
Gaussians with a global Parzen estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np

from twistcap.arrays import Bool, Float32, Int
from twistcap.errors import check_choice
from twistcap.region.densities import blockwise_log_ratio, global_log_ratio, parzen_log_ratio

Density = Literal["local", "global", "parzen"]
Statistics = Literal["part", "whole"]


_PARZEN_FLOOR = 0.05  # density per unit of brightness that is added everywhere


@dataclass(frozen=True)
class RegionModel:
    """Densities of two regions.

    Attributes:
        density: "local": one Gaussian per region and channel in a window about each pixel; "global": one of the whole
            region; "parzen": one smoothed histogram of it.
        rho: standard deviation of the window, m.
        floor: least variance of a Gaussian, brightness².
        prior_mass: fraction of a window at which global statistics have the weight of local ones.
        sigma: standard deviation of the Parzen kernel, brightness.

    Raises InputError for an unknown density.
    """

    density: Density
    rho: float = 0.04
    floor: float = 4e-4
    prior_mass: float = 0.02
    sigma: float = 0.02

    def __post_init__(self) -> None:
        check_choice("density", self.density, get_args(Density))

    @property
    def window(self) -> float:
        """Radius (m) about a pixel in which its densities are estimated; infinite for those of whole regions."""
        return math.sqrt(3.0) * self.rho if self.density == "local" else math.inf

    def log_ratio(
        self, features: Float32, inside: Float32, outside: Float32, px_per_m: float, wanted: Bool | None = None
    ) -> Float32:
        """(H, W) log p₁/p₂, nats, of channels (H, W, C) under the densities of the two regions.

        `inside` and `outside` (H, W) are memberships, 0 … 1; pixels in neither are ignored. The ratio is needed where
        `wanted` (H, W); elsewhere it may be 0.
        """
        if self.density == "parzen":
            return parzen_log_ratio(features, inside, outside, self.sigma, _PARZEN_FLOOR)
        if self.density == "global":
            return global_log_ratio(features, inside, self.floor, outside)
        rho = self.rho * px_per_m
        return blockwise_log_ratio(features, inside, rho, self.floor, self.prior_mass, wanted, outside=outside)


def log_ratio_by_part(
    model: RegionModel, features: Float32, inside: Float32, part: Int, px_per_m: float, wanted: Bool,
    outside: Float32 | None = None,
) -> Float32:  # fmt: skip
    """(H, W) log p₁/p₂ with p₁ the density of the pixel's own part of the body.

    Arguments as for `RegionModel.log_ratio`, `inside` of the whole body, `outside` by default its complement; where the
    ratio is not wanted it is 0. `part` (H, W) is that of each pixel, or the nearest just outside the body; -1 for none.
    """
    out = np.zeros(inside.shape, dtype=np.float32)
    outside = np.float32(1.0) - inside if outside is None else outside
    for s in np.unique(part[wanted]):
        own = part == s
        asked = own & wanted
        if s < 0 or not np.any(inside[own] > 0.5):
            continue
        box = _box(asked, model.window * px_per_m)
        ratio = model.log_ratio(
            np.ascontiguousarray(features[box]), np.ascontiguousarray(np.where(own, inside, 0.0)[box], np.float32),
            np.ascontiguousarray(outside[box]), px_per_m, np.ascontiguousarray(asked[box]),
        )  # fmt: skip
        out[box][asked[box]] = ratio[asked[box]]
    return out


def nearest_part(part: Int) -> Int:
    """(H, W) part of the nearest pixel on the body, from the part image (H, W; -1 off the body), to half a pixel."""
    off = (part < 0).astype(np.uint8)
    if off.all():
        return part
    label = np.asarray(
        cv2.distanceTransformWithLabels(off, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1], np.int32
    )
    of_label = np.full(int(label.max()) + 1, -1, dtype=np.int32)
    of_label[label[off == 0]] = part[off == 0]
    return of_label[label]


def _box(mask: Bool, margin: float) -> tuple[slice, slice]:
    """Rows and columns of the mask and `margin` px about it; the whole image for an infinite margin."""
    if math.isinf(margin):
        return slice(None), slice(None)
    m = math.ceil(margin)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = max(int(rows[0]) - m, 0), max(int(columns[0]) - m, 0)
    return slice(top, int(rows[-1]) + m + 1), slice(left, int(columns[-1]) + m + 1)
