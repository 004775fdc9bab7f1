"""Outlines of masks, and their matches with the contour of the model in both directions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import KDTree

from twistcap.arrays import AnyArray, Float, Int
from twistcap.render import ContourPoints

_AGREE = 0.5  # least cosine between the normals of a match


@dataclass(frozen=True)
class Outline:
    """Points (M, 2) on the outline of a mask, pixels, and outward unit normals (M, 2)."""

    points: Float
    normals: Float


@dataclass(frozen=True)
class Matches:
    """Contour samples (N,) of the model and their distances, px, along normals (N, 2) to the outline of the mask.

    The weight is 1 over the square root of the number of outline points on the same sample.
    """

    index: Int
    normals: Float
    distance: Float
    weight: Float

    def target(self, contour: ContourPoints) -> Float:
        """(N, 2) px on the outline, or on its tangent."""
        return contour.pixels[self.index] + self.distance[:, None] * self.normals


def outline_of(mask: AnyArray, spacing: float) -> Outline:
    """Outline of a mask (H, W) between its pixels, about `spacing` px apart; the edge of the image is no outline."""
    inside = np.asarray(mask) > 0
    outward, inward = (cv2.distanceTransform(a.astype(np.uint8), cv2.DIST_L2, 5) for a in (~inside, inside))
    distance = np.where(inside, 0.5 - inward, outward - 0.5).astype(np.float32)  # to midway between pixel centres
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.5)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3)
    curves, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    pixels = np.concatenate([c[:: max(1, round(spacing)), 0] for c in curves if len(c) > 20] or [np.zeros((0, 2), int)])
    pixels = pixels[np.all((pixels > 1) & (pixels < np.subtract(inside.shape[::-1], 2)), axis=1)]
    x, y = pixels.T
    normals = np.stack([gx[y, x], gy[y, x]], axis=1).astype(np.float64)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    # Pixel centres of the border are half a pixel inside the outline.
    return Outline(pixels - normals * distance[y, x, None], normals)


def match(contour: ContourPoints, outline: Outline, reach: float) -> Matches:
    """Every outer contour sample to the nearest outline point within `reach` px, and every outline point to a sample.

    Without the second direction, an arm before the torso in the model would never reach its mask.
    """
    outer = np.flatnonzero(contour.outer)
    if not len(outer) or not len(outline.points):
        return Matches(np.zeros(0, np.int32), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    ours, theirs = contour.pixels[outer], outline.points
    near = _nearest(theirs, outline.normals, ours, contour.normals[outer], reach)
    back = _nearest(ours, contour.normals[outer], theirs, outline.normals, reach)
    a, b = near >= 0, back >= 0
    index = np.concatenate([outer[a], outer[back[b]]]).astype(np.int32)
    normals = np.concatenate([outline.normals[near[a]], contour.normals[outer][back[b]]])
    target = np.concatenate([theirs[near[a]], theirs[b]])
    distance = np.sum(normals * (target - contour.pixels[index]), axis=1)
    shared = np.bincount(back[b], minlength=len(outer))
    weight = np.concatenate([np.ones(a.sum()), 1.0 / np.sqrt(shared[back[b]])])
    return Matches(index, normals, distance, weight)


def _nearest(points: Float, normals: Float, queries: Float, query_normals: Float, reach: float) -> Int:
    """(Q,) index of the nearest point with a like normal, -1 for none; of 8 neighbours tried."""
    distance, index = KDTree(points).query(queries, k=min(8, len(points)), distance_upper_bound=reach)
    distance, index = distance.reshape(len(queries), -1), index.reshape(len(queries), -1)
    safe = np.minimum(index, len(points) - 1)
    like = np.isfinite(distance) & (np.einsum("qki,qi->qk", normals[safe], query_normals) > _AGREE)
    first = np.argmax(like, axis=1)
    found = np.take_along_axis(safe, first[:, None], axis=1)[:, 0]
    return np.where(like.any(axis=1), found, -1).astype(np.int32)
