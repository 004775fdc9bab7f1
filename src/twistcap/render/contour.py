"""Visible contour points of a rendered body, sub-pixel, each with its place on the surface.

Edges between a front-facing and a back-facing triangle project to the exact outline of the mesh where they are not
occluded. An outline traced on a mask would be up to half a pixel wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.camera.projection import along, project
from twistcap.render.view import RenderedView, SurfacePoints, surface_points

_HIDDEN, _OUTER, _INNER = 0, 1, 2
_INNER_GAP = 0.04  # m

MeshArrays = tuple[Int, Int, Int, Int, Int]
"""Faces (F, 3), edges (E, 2), the faces of each edge (E, 2), -1 for none, and the part of each face and vertex."""
Samples = tuple[Int, Float, Int, Bool, Float, Float, Float]
"""Of N samples the vertices (N, 2) at the ends of their edges and their weights (N, 2), part (N,), whether on the
silhouette (N,), pixels (N, 2), image normals (N, 2) and inverse depth (N,)."""


@dataclass(frozen=True)
class ContourPoints:
    """Samples of a body's visible contour in one view.

    Attributes:
        points, pixels: N places on the surface, and (N, 2) in the image, px.
        normals: (N, 2) unit image normals, outward of the part.
        part, outer: (N,) segment; True on the silhouette, False before another part of the body.
        inverse_depth: (N,) 1/m.
    """

    points: SurfacePoints
    pixels: Float
    normals: Float
    part: Int
    outer: Bool
    inverse_depth: Float

    def __len__(self) -> int:
        return len(self.pixels)

    def __getitem__(self, which: Bool | Int) -> ContourPoints:
        rest: tuple[Any, ...] = (self.pixels, self.normals, self.part, self.outer, self.inverse_depth)
        return ContourPoints(self.points[which], *(own[which] for own in rest))

    def moved_by(self, posed: Posed, P: Float) -> Float:
        """(N,) px by which the points move in the image when the body takes this pose."""
        return np.hypot(*(project(P, self.points.at(posed))[0] - self.pixels).T)


def reprojected(contour: ContourPoints, posed: Posed, P: Float) -> ContourPoints:
    """The same contour points after a small motion of the body; normals and visibility stay."""
    pixels, inverse_depth = project(P, contour.points.at(posed))
    return replace(contour, pixels=pixels, inverse_depth=inverse_depth)


def visible_contour(view: RenderedView, spacing: float = 3.0) -> ContourPoints:
    """Contour points about `spacing` px apart along the outline, and where another part is 4 cm behind."""
    return contour_on_edges(view, spacing)[0]


def contour_on_edges(view: RenderedView, spacing: float = 3.0) -> tuple[ContourPoints, Int, Float]:
    """`visible_contour`, and for each point the vertices (N, 2) of its edge and their weights (N, 2)."""
    body = view.posed.body
    mesh = body.faces, *body.edges, body.face_part, body.vertex_part
    drawn = view.face_index, view.nearness_image
    ends, weights, part, outer, pixels, image_normals, inverse_depth = contour_samples(
        view.camera.P, view.pixels, view.nearness, view.posed.vertex_normals, mesh, drawn, spacing, _INNER_GAP
    )
    points = surface_points(body, ends, weights)
    return ContourPoints(points, pixels, image_normals, part, outer, inverse_depth), ends, weights


@njit(cache=True, nogil=True)
def _faces_camera(pixels: Float, inverse_depth: Float, faces: Int) -> Int:
    """(F,) 1 front, -1 back, 0 behind the camera."""
    out = np.zeros(len(faces), dtype=np.int32)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if inverse_depth[a] == 0.0 or inverse_depth[b] == 0.0 or inverse_depth[c] == 0.0:
            continue
        area = (pixels[b, 0] - pixels[a, 0]) * (pixels[c, 1] - pixels[a, 1]) - (pixels[b, 1] - pixels[a, 1]) * (
            pixels[c, 0] - pixels[a, 0]
        )
        out[f] = 1 if area < 0.0 else -1
    return out


@njit(cache=True, nogil=True)
def _image_normal(P: Float, u: float, v: float, nx: float, ny: float, nz: float) -> tuple[float, float]:
    """Unit image direction in which a point moving along a surface normal moves."""
    u0, u1, u2 = along(P, u, v, 1.0, 0.0)
    v0, v1, v2 = along(P, u, v, 0.0, 1.0)
    a, b = u0 * nx + u1 * ny + u2 * nz, v0 * nx + v1 * ny + v2 * nz
    length = np.sqrt(a * a + b * b)
    if length < 1e-12:
        return 0.0, 0.0
    return a / length, b / length


@njit(cache=True, nogil=True)
def _visibility(
    at: tuple[float, float], normal: tuple[float, float], w: float, part: int, face_index: Int, buffer: Float32,
    face_part: Int, inner_gap: float,
) -> int:  # fmt: skip
    """Whether a contour point is hidden, on the silhouette or before another part, by the pixels inside and outside."""
    height, width = face_index.shape
    (x, y), (nx, ny) = at, normal
    column, row = int(np.round(x - nx)), int(np.round(y - ny))
    if not (0 <= column < width and 0 <= row < height):
        return _HIDDEN
    inside = face_index[row, column]
    depth = 1.0 / w
    if inside >= 0 and face_part[inside] != part and 1.0 / buffer[row, column] < depth - 0.03:
        return _HIDDEN
    column, row = int(np.round(x + 1.5 * nx)), int(np.round(y + 1.5 * ny))
    if not (0 <= column < width and 0 <= row < height):
        return _HIDDEN  # the outside is beyond the image's border
    outside = face_index[row, column]
    if outside < 0:
        return _OUTER
    return _INNER if 1.0 / buffer[row, column] > depth + inner_gap else _HIDDEN


@njit(cache=True, nogil=True)
def contour_samples(
    P: Float, pixels: Float, inverse_depth: Float, normals: Float, mesh: MeshArrays, drawn: tuple[Int, Float32],
    spacing: float, inner_gap: float,
) -> Samples:  # fmt: skip
    """Samples every `spacing` px along all contour edges; see `visible_contour`.

    Pixels (V, 2), inverse depths (V,) and normals (V, 3) are those of the vertices, `drawn` (H, W) the visible triangle
    and inverse depth at each pixel.
    """
    faces, edges, edge_faces, face_part, vertex_part = mesh
    face_index, buffer = drawn
    front = _faces_camera(pixels, inverse_depth, faces)
    capacity = 4096
    ends, weights = np.empty((capacity, 2), dtype=np.int32), np.empty((capacity, 2))
    at, normal_out, w_out = np.empty((capacity, 2)), np.empty((capacity, 2)), np.empty(capacity)
    part_out, outer = np.empty(capacity, dtype=np.int32), np.empty(capacity, dtype=np.bool_)
    count, walked = 0, 0.5 * spacing
    for e in range(len(edges)):
        f, g = edge_faces[e, 0], edge_faces[e, 1]
        if g < 0 or front[f] * front[g] != -1:
            continue
        i, j = edges[e, 0], edges[e, 1]
        dx, dy = pixels[j, 0] - pixels[i, 0], pixels[j, 1] - pixels[i, 1]
        length = np.sqrt(dx * dx + dy * dy)
        if length == 0.0:
            continue
        part = int(face_part[f] if front[f] == 1 else face_part[g])
        position = spacing - walked
        walked += length
        while position <= length and count < capacity:
            walked -= spacing
            s = position / length  # along the projected edge; the place on the 3D edge follows from perspective
            position += spacing
            w = (1.0 - s) * inverse_depth[i] + s * inverse_depth[j]
            t = s * inverse_depth[j] / w
            u, v = pixels[i, 0] + s * dx, pixels[i, 1] + s * dy
            n0 = (1.0 - t) * normals[i, 0] + t * normals[j, 0]
            n1 = (1.0 - t) * normals[i, 1] + t * normals[j, 1]
            n2 = (1.0 - t) * normals[i, 2] + t * normals[j, 2]
            a, b = _image_normal(P, u, v, n0, n1, n2)
            if a == 0.0 and b == 0.0:
                continue
            kind = _visibility((u, v), (a, b), w, part, face_index, buffer, face_part, inner_gap)
            if kind == _HIDDEN:
                continue
            ends[count, 0], ends[count, 1], weights[count, 0], weights[count, 1] = i, j, 1.0 - t, t
            part_out[count], outer[count] = vertex_part[i if t < 0.5 else j], kind == _OUTER
            at[count, 0], at[count, 1] = u, v
            normal_out[count, 0], normal_out[count, 1] = a, b
            w_out[count] = w
            count += 1
    return ends[:count], weights[:count], part_out[:count], outer[:count], at[:count], normal_out[:count], w_out[:count]


def contour_samples_reference(
    P: Float, pixels: Float, inverse_depth: Float, normals: Float, mesh: MeshArrays, drawn: tuple[Int, Float32],
    spacing: float, inner_gap: float,
) -> Samples:  # fmt: skip
    """Readable twin of `contour_samples`: edge by edge."""
    faces, edges, edge_faces, face_part, vertex_part = mesh
    a, b, c = (pixels[faces[:, k]] for k in range(3))
    areas = np.linalg.det(np.stack([b - a, c - a], axis=1))
    front = np.where((inverse_depth[faces] == 0.0).any(axis=1), 0, -np.sign(areas))
    found, walked = list[tuple[Any, ...]](), 0.5 * spacing
    for (i, j), (f, g) in zip(edges, edge_faces, strict=True):
        way = pixels[j] - pixels[i]
        length = float(np.hypot(*way))
        if g < 0 or front[f] * front[g] != -1 or length == 0.0:
            continue
        part = int(face_part[f if front[f] == 1 else g])
        positions = np.arange(spacing - walked, length, spacing)
        walked += length - spacing * len(positions)
        for s in positions / length:
            w = (1.0 - s) * inverse_depth[i] + s * inverse_depth[j]
            t, at = s * inverse_depth[j] / w, pixels[i] + s * way
            normal = (P[:2, :3] - np.outer(at, P[2, :3])) @ ((1.0 - t) * normals[i] + t * normals[j])
            normal = normal / max(float(np.hypot(*normal)), 1e-12)
            kind = _visibility((at[0], at[1]), (normal[0], normal[1]), w, part, *drawn, face_part, inner_gap)
            if normal.any() and kind != _HIDDEN:
                found.append(((i, j), (1.0 - t, t), vertex_part[i if t < 0.5 else j], kind == _OUTER, at, normal, w))
    ends, weights, parts, outer, places, directions, nearness = zip(*found, strict=True)
    return (
        np.array(ends, np.int32), np.array(weights), np.array(parts, np.int32), np.array(outer), np.array(places),
        np.array(directions), np.array(nearness),
    )  # fmt: skip
