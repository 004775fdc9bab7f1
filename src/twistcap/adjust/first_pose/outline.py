"""Outlines of masks, their matches with the model's contour both ways, and rows of these on a pose and on girths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial import KDTree

from twistcap.arrays import AnyArray, Float, Int
from twistcap.body import Body, Posed, rescaled
from twistcap.body.kinematics import skin_points
from twistcap.body.shape import RestMotion, rest_motion, stretch_maps
from twistcap.render import ContourPoints, SurfacePoints
from twistcap.solve import Variables, Vector
from twistcap.terms import Slope, Sums
from twistcap.terms.points import projected_rows
from twistcap.terms.robust import huber

_AGREE = 0.5  # least cosine between the normals of a match
_KNEE = 2.0  # standard deviations beyond which the loss is linear


@dataclass(frozen=True)
class Outline:
    """Points (M, 2) on the outline of a mask, pixels, and outward unit normals (M, 2)."""

    points: Float
    normals: Float


@dataclass(frozen=True)
class Matches:
    """Contour samples (N,) of the model and their distances, px, along normals (N, 2) to the outline of the mask. The
    weight is 1 over the square root of the number of outline points on the same sample."""

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
    Without the second direction, an arm before the torso in the model would never reach its mask."""
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


@dataclass(frozen=True, kw_only=True)
class Girths(Vector):
    """Log-girths (G,) of groups of segments of the `generic` body, by name, as a block of variables."""

    generic: Body
    groups: Mapping[str, Sequence[str]]

    @property
    def factors(self) -> dict[str, float]:
        """Factor of every segment of the groups."""
        return self._factors(self.values)

    @cached_property
    def body(self) -> Body:
        """Of these girths."""
        return rescaled(self.generic, girths=self.factors) if self.groups else self.generic

    def rest_motion(self) -> RestMotion:
        """How the rest pose moves with the log-girths."""
        return rest_motion(self.body, [], [dict.fromkeys(group, 1.0) for group in self.groups.values()], [])

    def maps_from(self, origin: Girths) -> Float | None:
        """(S, 4, 4) from the rest pose of `origin`'s body to that of these girths'; None where nothing moves."""
        if self is origin or not self.groups:
            return None
        return np.ascontiguousarray(stretch_maps(origin.body, {}, self._factors(self.values - origin.values)))

    def _factors(self, logs: Float) -> dict[str, float]:
        return {name: float(np.exp(g)) for g, group in zip(logs, self.groups.values(), strict=True) for name in group}


@dataclass(frozen=True)
class OutlineTerm:
    """Matches of one view at one instant, in a `frame` of the track: Huber's loss of the distances along their normals.

    Attributes:
        points: N samples on the body of `origin`, whose girths are the same in all terms of a problem.
        motion: of the rest pose with the log-girths; None where these are not free.
        normal, target: (N, 2) directions along which the distances count, and px on the outline or on its tangent.
        sigma, weight: px, standard deviation; (N,) of each match.
    """

    P: Float
    points: SurfacePoints
    origin: Girths
    motion: RestMotion | None
    normal: Float
    target: Float
    sigma: float
    weight: Float
    frame: int
    name: str = "outline"

    def energy(self, x: Variables) -> float:
        posed, points = self._placed(x)
        residual, _ = projected_rows(self.P, points.at(posed), self.normal, self.target)
        return float(self.weight @ huber(residual / self.sigma, _KNEE)[0])

    def add_to(self, sums: Sums, x: Variables) -> None:
        posed, points = self._placed(x)
        residual, gradient = projected_rows(self.P, points.at(posed), self.normal, self.target)
        residual, gradient = residual / self.sigma, gradient / self.sigma
        energy, weight = huber(residual, _KNEE)
        jacobian = posed.point_jacobian(points.segments, points.weights, points.local)
        slopes = [Slope("poses", np.einsum("ni,nid->nd", gradient, jacobian), self.frame * posed.body.dof)]
        if self.motion is not None:
            rates = self.motion.rates(posed, points.segments, points.weights, points.local, gradient)
            slopes.append(Slope("girths", rates))
        sums.add_rows(float(self.weight @ energy), slopes, self.weight * weight, residual)

    def _placed(self, x: Variables) -> tuple[Posed, SurfacePoints]:
        """The body, and the samples on it."""
        girths, key = x["girths"], ("posed", self.frame)
        if key not in x.memo:
            x.memo[key] = Posed(girths.body, x["poses"].poses[self.frame])
        if "maps" not in x.memo:
            x.memo["maps"] = girths.maps_from(self.origin)
        posed, maps, points = x.memo[key], x.memo["maps"], self.points
        if maps is None:
            return posed, points
        return posed, replace(points, local=skin_points(maps, points.segments, points.weights, points.local))
