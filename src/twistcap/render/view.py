"""`RenderedView`: one body at one pose in one camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit

from twistcap._cached import cached
from twistcap.arrays import AnyArray, Bool, Float, Float32, Int
from twistcap.body import Body, Posed
from twistcap.camera import AnyCamera
from twistcap.camera.projection import depth_at, project, projected
from twistcap.render.raster import barycentric, rasterise

_JUMP = 0.04  # m; a larger step of depth between neighbouring pixels is the rim of one part before another
_KEEP = 4  # segments that a surface point is bound to, at most

SurfaceArrays = tuple[Float, Int, Float, Float]
"""Surface points at a pose, for kernels: segment motions (S, 4, 4), segments (N, K), weights (N, K), rest places
(N, 3), m. A plain tuple, which numba dispatches 1 to 2 µs faster than a named one; a frame has some 60 such calls."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points carried by the surface: `segments` and `weights` (N, K) of their binding, `local` (N, 3) rest places m."""

    segments: Int
    weights: Float
    local: Float

    def __len__(self) -> int:
        return len(self.local)

    @cached
    def part(self) -> Int:
        """(N,) the segment that each point is bound to most."""
        best = np.argmax(self.weights, axis=1)
        return np.take_along_axis(self.segments, best[:, None], axis=1)[:, 0].astype(np.int32)

    def __getitem__(self, which: Bool | Int) -> SurfacePoints:
        if which.dtype == np.bool_:
            which = np.flatnonzero(which).astype(np.int32)
        taken = (np.take(own, which, axis=0) for own in self._arrays)  # much faster than indexing
        return SurfacePoints(*taken)

    def __add__(self, other: SurfacePoints) -> SurfacePoints:
        return SurfacePoints(*(np.concatenate(pair) for pair in zip(self._arrays, other._arrays, strict=True)))

    @property
    def _arrays(self) -> tuple[Any, Any, Any]:
        return self.segments, self.weights, self.local

    def bound_to(self, posed: Posed) -> SurfaceArrays:
        """The points at a pose, for kernels."""
        return posed.segment_transforms, self.segments, self.weights, self.local

    def at(self, posed: Posed) -> Float:
        """(N, 3) world positions."""
        return posed.points(self.segments, self.weights, self.local)


@dataclass(frozen=True)
class RenderedView:
    """What one camera without distortion sees of a body.

    Attributes:
        pixels, nearness: (V, 2) and (V,) of the vertices (`camera.projection`): 1/m for a pinhole; 0 behind the camera.
        face_index, nearness_image: (H, W) visible triangle, -1 for none, and its nearness, 0 for none.
    """

    posed: Posed
    camera: AnyCamera
    pixels: Float
    nearness: Float
    face_index: Int
    nearness_image: Float32

    @cached
    def px_per_m(self) -> float:
        """Image scale at the body, px/m (0 where none of it is before the camera)."""
        return self.camera.px_per_m(self.nearness)

    @cached
    def mask(self) -> Bool:
        """(H, W) silhouette."""
        return self.face_index >= 0

    @cached
    def part(self) -> Int:
        """(H, W) visible segment, -1 off the body."""
        table = np.append(self.posed.body.face_part, np.int32(-1))  # −1 picks the last one
        return table.take(self.face_index, mode="wrap")

    @cached
    def inside(self) -> Float32:
        """(H, W) distance (px) from the nearest rim: of the silhouette, or of one part before another."""
        kept = off_rims(self.nearness_image, self.camera.inverse_depth)
        kept = cv2.copyMakeBorder(kept, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)  # the image's border is no rim
        return np.asarray(cv2.distanceTransform(kept, cv2.DIST_L2, 3)[1:-1, 1:-1], np.float32)

    def surface_points(self, rows: Int, columns: Int) -> SurfacePoints:
        """The surface seen at pixels (N,), all of which must lie on the body."""
        return surface_points(self.posed.body, *self._corners(rows, columns))

    def surface_normals(self, rows: Int, columns: Int) -> Float:
        """(N, 3) unit outward normals, in the world, of the surface seen at pixels (N,) on the body."""
        normals = blended(self.posed.vertex_normals, *self._corners(rows, columns))
        return normals / np.maximum(np.sqrt((normals * normals).sum(axis=1, keepdims=True)), 1e-12)

    def _corners(self, rows: Int, columns: Int) -> tuple[Int, Float]:
        """Vertices (N, 3) of the triangles seen at pixels (N,), and their weights there."""
        body = self.posed.body
        face = self.face_index[rows, columns]
        at = np.stack([columns, rows], axis=1).astype(float)
        w = self.nearness if self.camera.inverse_depth else project(self.camera.P, self.posed.vertices)[1]
        return body.faces[face], barycentric(face, body.faces, self.pixels, w, at)

    def visible(self, points: SurfacePoints, tolerance: float, posed: Posed | None = None) -> tuple[Bool, Float]:
        """Which points (N,), at this or another pose, are at most `tolerance` m behind what is seen; all pixels."""
        pixels, nearness = projected(self.camera, points.at(posed or self.posed))
        return in_sight(pixels, nearness, self.nearness_image, self.camera.inverse_depth, tolerance), pixels


def render(posed: Posed, camera: AnyCamera) -> RenderedView:
    """Rasterise a posed body in a camera without distortion."""
    pixels, nearness = projected(camera, posed.vertices)
    face_index, buffer = rasterise(pixels, nearness, posed.body.faces, (0, 0), camera.size)
    return RenderedView(posed, camera, pixels, nearness, face_index, buffer)


@njit(cache=True, nogil=True)
def in_sight(pixels: Float, nearness: Float, image: Float32, inverse: bool, tolerance: float) -> Bool:
    """(N,) whether points at `pixels` lie in the image (H, W) of nearness, no more than `tolerance` m behind it."""
    height, width = image.shape
    out = np.zeros(len(pixels), dtype=np.bool_)
    for n in range(len(pixels)):
        x, y = pixels[n, 0], pixels[n, 1]
        if nearness[n] == 0.0 or not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):
            continue
        surface = image[int(y + 0.5), int(x + 0.5)]
        out[n] = surface > 0.0 and depth_at(nearness[n], inverse) < depth_at(surface, inverse) + tolerance
    return out


def in_sight_reference(pixels: Float, nearness: Float, image: Float32, inverse: bool, tolerance: float) -> Bool:
    """Readable twin of `in_sight`."""
    columns, rows = np.floor(pixels + 0.5).astype(int).T
    height, width = image.shape
    seen = (nearness != 0.0) & (rows >= 0) & (columns >= 0) & (rows < height) & (columns < width)
    surface = image[np.where(seen, rows, 0), np.where(seen, columns, 0)].astype(float)
    seen &= surface > 0.0
    behind, here = (1.0 / np.where(seen, n, 1.0) if inverse else -n for n in (nearness, surface))
    return seen & (behind < here + tolerance)


@njit(cache=True, nogil=True)
def off_rims(nearness: Float32, inverse: bool) -> AnyArray:
    """(H, W) uint8: 1 on the body, 0 off it and at rims: beside a pixel off it, or one 4 cm nearer or farther."""
    height, width = nearness.shape
    out = np.zeros((height, width), dtype=np.uint8)
    for r in range(height):
        for c in range(width):
            w, rim = nearness[r, c], False
            if w == 0.0:
                continue
            for dr, dc in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                if 0 <= r + dr < height and 0 <= c + dc < width:
                    other = nearness[r + dr, c + dc]
                    rim |= other == 0.0 or abs(depth_at(other, inverse) - depth_at(w, inverse)) > _JUMP
            out[r, c] = 0 if rim else 1
    return out


def off_rims_reference(nearness: Float32, inverse: bool) -> AnyArray:
    """Readable twin of `off_rims`."""
    body = nearness != 0.0
    depth = np.where(body, 1.0 / np.where(body, nearness, 1.0) if inverse else -nearness, np.inf)
    out = body.copy()
    for axis in (0, 1):
        before, after = (np.take(depth, range(a, depth.shape[axis] + b), axis) for a, b in ((0, -1), (1, 0)))
        with np.errstate(invalid="ignore"):
            jump = ~(np.abs(after - before) <= _JUMP)
        pad = np.zeros_like(np.take(jump, [0], axis))
        out &= ~np.concatenate([jump, pad], axis) & ~np.concatenate([pad, jump], axis)
    return out.astype(np.uint8)


def body_window(posed: Posed, camera: AnyCamera, margin: float) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Origin (x, y) and size (w, h) of the image window that holds the body and `margin` px about it; None off it."""
    left, top, right, bottom = _bounds(camera.P, posed.vertices)
    if left > right:
        return None
    width, height = camera.size
    left, top, right, bottom = left - margin, top - margin, right + margin, bottom + margin
    if right <= 0 or bottom <= 0 or left >= width - 1 or top >= height - 1:
        return None
    x, y = max(math.floor(left), 0), max(math.floor(top), 0)
    return (x, y), (min(math.ceil(right), width - 1) - x + 1, min(math.ceil(bottom), height - 1) - y + 1)


@njit(cache=True, nogil=True)
def _bounds(P: Float, points: Float) -> tuple[float, float, float, float]:
    """Least x, y and greatest x, y (px) of world points' (N, 3) projections; infinite where all are behind it."""
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    pixels, w = project(P, points)
    for n in range(len(points)):
        if w[n] > 0.0:
            left, right = min(left, pixels[n, 0]), max(right, pixels[n, 0])
            top, bottom = min(top, pixels[n, 1]), max(bottom, pixels[n, 1])
    return left, top, right, bottom


def surface_points(body: Body, corners: Int, weights: Float, keep: int = _KEEP) -> SurfacePoints:
    """Surface points from vertex indices (N, M) and their weights (N, M), bound to their `keep` strongest segments."""
    segments, skin = _blend_binding(body.skin_segments, body.skin_weights, corners, weights, keep)
    return SurfacePoints(segments, skin, blended(body.vertices, corners, weights))


@njit(cache=True, nogil=True)
def blended(values: Float, corners: Int, weights: Float) -> Float:
    """(N, C) means of values (V, C) over corners (N, M) with weights (N, M)."""
    out = np.zeros((len(corners), values.shape[1]))
    for n in range(len(corners)):
        for m in range(corners.shape[1]):
            for c in range(values.shape[1]):
                out[n, c] += weights[n, m] * values[corners[n, m], c]
    return out


def blended_reference(values: Float, corners: Int, weights: Float) -> Float:
    """Readable twin of `blended`."""
    return np.einsum("nm,nmc->nc", weights, values[corners])


@njit(cache=True, nogil=True)
def _blend_binding(
    skin_segments: Int, skin_weights: Float, corners: Int, weights: Float, keep: int
) -> tuple[Int, Float]:
    """Segments and weights (N, keep) of several vertices together; unused places have weight 0."""
    N, M = corners.shape
    K = skin_segments.shape[1]
    segments, out = np.zeros((N, keep), dtype=np.int32), np.zeros((N, keep))
    names, sums = np.zeros(M * K, dtype=np.int32), np.zeros(M * K)
    for n in range(N):
        count = 0
        for m in range(M):
            v = corners[n, m]
            for k in range(K):
                w = weights[n, m] * skin_weights[v, k]
                if w <= 0.0:
                    continue
                s = skin_segments[v, k]
                slot = 0
                while slot < count and names[slot] != s:
                    slot += 1
                if slot == count:
                    names[slot], sums[slot] = s, 0.0
                    count += 1
                sums[slot] += w
        total = 0.0
        for place in range(min(keep, count)):
            best = place
            for slot in range(place + 1, count):
                if sums[slot] > sums[best]:
                    best = slot
            names[place], names[best] = names[best], names[place]
            sums[place], sums[best] = sums[best], sums[place]
            segments[n, place], out[n, place] = names[place], sums[place]
            total += sums[place]
        for place in range(min(keep, count)):
            out[n, place] /= total
    return segments, out
