"""What a view sees of a body: segment and depth at each pixel, and surface points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.differential.view import ScaledView
from twistcap.render import SurfacePoints
from twistcap.render.raster import barycentric, rasterise
from twistcap.render.view import surface_points

_JUMP = 0.04  # m; a step of depth between neighbouring pixels above this is the rim of one part before another


@dataclass(frozen=True)
class SeenBody:
    """A body at a pose in a view, scaled orthographic or a pinhole's.

    Attributes:
        posed: the body, in its own frame.
        view: the view.
        pixels: (V, 2) projected vertices.
        nearness: (V,) positive, falls by 1 per px of depth as `ScaledView.camera_points` has it.
        face_index: (H, W) visible triangle, -1 for none.
        buffer: (H, W) nearness of what is seen, 0 for none.
    """

    posed: Posed
    view: ScaledView
    pixels: Float
    nearness: Float
    face_index: Int
    buffer: Float32

    @cached_property
    def part(self) -> Int:
        """(H, W) visible segment, -1 off the body."""
        part = self.posed.body.face_part
        return np.where(self.face_index >= 0, part[self.face_index], -1).astype(np.int32)

    @property
    def mask(self) -> Bool:
        """(H, W) silhouette."""
        return self.face_index >= 0

    @cached_property
    def inside(self) -> Float32:
        """(H, W) px from the nearest rim: of the silhouette, or of one part before another."""
        kept = self.mask.astype(np.uint8)
        jump = _JUMP * self.view.scale
        for axis in (0, 1):
            step = np.abs(np.diff(self.buffer, axis=axis)) > jump
            if axis == 0:
                kept[1:][step] = kept[:-1][step] = 0
            else:
                kept[:, 1:][step] = kept[:, :-1][step] = 0
        kept = cv2.copyMakeBorder(kept, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)  # the image's border is no rim
        return cv2.distanceTransform(kept, cv2.DIST_L2, 3)[1:-1, 1:-1].astype(np.float32)

    def surface_points(self, rows: Int, columns: Int) -> SurfacePoints:
        """The surface seen at pixels (N,), all of which must lie on the body."""
        body, face = self.posed.body, self.face_index[rows, columns]
        level = self.view.nearness(self.posed.vertices)
        weights = barycentric(face, body.faces, self.pixels, level, np.stack([columns, rows], axis=1).astype(float))
        return surface_points(body, body.faces[face], weights)

    def visible(self, points: SurfacePoints, tolerance: float = 0.02) -> tuple[Bool, Int, Int]:
        """Which points (N,) lie in the image no more than `tolerance` m behind what is seen; their rows and columns."""
        at = self.view.camera_points(points.at(self.posed))
        x, y = np.rint(at[:, :2] + self.view.shift).astype(np.int32).T
        height, width = self.buffer.shape
        within = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        r, c = np.where(within, y, 0), np.where(within, x, 0)
        offset = self.nearness[0] + self._depth0
        seen = within & self.mask[r, c] & (offset - at[:, 2] > self.buffer[r, c] - tolerance * self.view.scale)
        return seen, r.astype(np.int32), c.astype(np.int32)

    @cached_property
    def _depth0(self) -> float:
        return float(self.view.camera_points(self.posed.vertices[:1])[0, 2])


def render(posed: Posed, view: ScaledView, size: tuple[int, int]) -> SeenBody:
    """Rasterise a body (posed in its own frame) in an image of (width, height)."""
    at = view.camera_points(posed.vertices)
    pixels = np.ascontiguousarray(at[:, :2] + view.shift)
    nearness = float(at[:, 2].max()) + 1.0 - at[:, 2]
    face_index, buffer = rasterise(pixels, nearness, posed.body.faces, (0, 0), size)
    return SeenBody(posed, view, pixels, nearness, face_index, buffer)
