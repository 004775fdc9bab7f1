"""Z-buffer rasteriser: visible triangle and nearness at each pixel."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import AnyArray, Float, Float32, Int

_EDGE = 1e-9  # triangles overlap by this much, so that rounding leaves no crack along a common edge


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"}, error_model="numpy")
def rasterise(
    pixels: Float, nearness: Float, faces: Int, origin: tuple[int, int], size: tuple[int, int]
) -> tuple[Int, Float32]:
    """(H, W) visible triangle, -1 for none, and its nearness, 0 there, at the pixel centres of a window of the image.

    Args:
        pixels, nearness: (V, 2) and (V,) of the vertices (`camera.projection`); those of nearness 0 are not drawn.
        faces: (F, 3), counter-clockwise seen from outside; back faces are culled.
        origin, size: (x, y) of the window's first pixel; its (width, height).
    """
    width, height = size
    face_index = np.full((height, width), -1, dtype=np.int32)
    buffer = np.zeros((height, width), dtype=np.float32)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        wa, wb, wc = nearness[a], nearness[b], nearness[c]
        if wa == 0.0 or wb == 0.0 or wc == 0.0:
            continue
        xa, ya = pixels[a, 0] - origin[0], pixels[a, 1] - origin[1]
        xb, yb = pixels[b, 0] - origin[0], pixels[b, 1] - origin[1]
        xc, yc = pixels[c, 0] - origin[0], pixels[c, 1] - origin[1]
        area = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
        if area >= 0.0:  # y points down: a front face runs clockwise in pixel coordinates' own sense
            continue
        x0, x1 = max(0, int(np.ceil(min(xa, xb, xc)))), min(width - 1, int(np.floor(max(xa, xb, xc))))
        y0, y1 = max(0, int(np.ceil(min(ya, yb, yc)))), min(height - 1, int(np.floor(max(ya, yb, yc))))
        if x0 > x1 or y0 > y1:
            continue
        # Barycentric coordinates and nearness are linear in the image: walk them by increments.
        scale = 1.0 / area
        ax, ay = (yb - yc) * scale, (xc - xb) * scale
        bx, by = (yc - ya) * scale, (xa - xc) * scale
        dw = ax * (wa - wc) + bx * (wb - wc)
        for y in range(y0, y1 + 1):
            la = ax * (x0 - xb) + ay * (y - yb)
            lb = bx * (x0 - xc) + by * (y - yc)
            w = wc + la * (wa - wc) + lb * (wb - wc)
            for x in range(x0, x1 + 1):
                if min(la, lb, 1.0 - la - lb) >= -_EDGE and w > buffer[y, x]:
                    buffer[y, x] = w
                    face_index[y, x] = f
                la += ax
                lb += bx
                w += dw
    return face_index, buffer


def rasterise_reference(
    pixels: Float, nearness: Float, faces: Int, origin: tuple[int, int], size: tuple[int, int]
) -> tuple[Int, Float32]:
    """Readable twin of `rasterise`: every triangle tried at every pixel."""
    width, height = size
    x, y = np.meshgrid(np.arange(width) + origin[0], np.arange(height) + origin[1])
    face_index = np.full((height, width), -1, dtype=np.int32)
    buffer = np.zeros((height, width), dtype=np.float32)
    for f, corners in enumerate(faces):
        w = nearness[corners]
        (xa, ya), (xb, yb), (xc, yc) = pixels[corners]
        area = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
        if np.any(w == 0) or area >= 0:
            continue
        la = ((yb - yc) * (x - xb) + (xc - xb) * (y - yb)) / area
        lb = ((yc - ya) * (x - xc) + (xa - xc) * (y - yc)) / area
        lc = 1.0 - la - lb
        depth = (la * w[0] + lb * w[1] + lc * w[2]).astype(np.float32)
        nearer = (la >= -_EDGE) & (lb >= -_EDGE) & (lc >= -_EDGE) & (depth > buffer)
        face_index[nearer], buffer[nearer] = f, depth[nearer]
    return face_index, buffer


@njit(cache=True, nogil=True)
def barycentric(face_index: Int, faces: Int, pixels: Float, w_of: Float, at: AnyArray) -> Float:
    """Perspective-correct barycentric coordinates (N, 3) on the given triangles (N,) at pixel positions (N, 2)."""
    out = np.empty((len(face_index), 3))
    for n in range(len(face_index)):
        a, b, c = faces[face_index[n], 0], faces[face_index[n], 1], faces[face_index[n], 2]
        x1, y1 = pixels[b, 0] - pixels[a, 0], pixels[b, 1] - pixels[a, 1]
        x2, y2 = pixels[c, 0] - pixels[a, 0], pixels[c, 1] - pixels[a, 1]
        x, y = at[n, 0] - pixels[a, 0], at[n, 1] - pixels[a, 1]
        area = x1 * y2 - y1 * x2
        lb, lc = (x * y2 - y * x2) / area, (x1 * y - y1 * x) / area
        wa, wb, wc = (1.0 - lb - lc) * w_of[a], lb * w_of[b], lc * w_of[c]
        total = wa + wb + wc
        out[n, 0], out[n, 1], out[n, 2] = wa / total, wb / total, wc / total
    return out


def barycentric_reference(face_index: Int, faces: Int, pixels: Float, inverse_depth: Float, at: AnyArray) -> Float:
    """Readable twin of `barycentric`: areas of the image, weighted by nearness."""
    corners = faces[face_index]
    ones = np.ones((len(at), 1))
    triangles = np.concatenate([pixels[corners], np.ones((*corners.shape, 1))], axis=2)  # (N, 3 corners, 3)
    in_image = np.linalg.solve(np.swapaxes(triangles, 1, 2), np.concatenate([at, ones], axis=1)[..., None])[..., 0]
    nearness = in_image * inverse_depth[corners]
    return nearness / nearness.sum(axis=1, keepdims=True)
