"""Two layers of one view over a whole sequence: what stands still behind, and the brightness of the body's surface.

Both are learnt from the sequence itself, given where the body is thought to be; a state is then judged by how well the
two together explain a picture. This is the mixture of the support maps (Bregler and Malik, CVPR 1998) seen from the
whole picture: pixels that the body leaves must look like the layer behind, those it covers like its surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import AnyArray, Bool, Float, Float32, Int
from twistcap.body import Body, Posed
from twistcap.camera import ScaledView
from twistcap.camera.projection import projected
from twistcap.render import RenderedView, render
from twistcap.render.raster import rasterise

_FEWEST = 50
_CLEAR = 4  # px about the silhouette that are not taken for what is behind
_NOISE = 0.008  # brightness; least scale of the residuals of either layer
_ROUNDS = 2


@dataclass(frozen=True)
class Layers:
    """What one view shows, N pictures.

    Attributes:
        images: (N, H, W) all at the exposure of the first.
        behind: (N, H, W) cost of each pixel as one of the layer behind.
        surface: (F,) brightness of the body's faces.
        spread: (F,) scale of the residuals under it.
    """

    images: Float
    behind: Float
    surface: Float
    spread: Float

    def cost(self, frame: int, seen: RenderedView) -> float:
        """Negative log likelihood of a picture under both layers, less that of nothing but the layer behind."""
        rows, columns = np.nonzero(seen.mask)
        return float(np.sum(self.less_behind(frame, seen.face_index[rows, columns], rows, columns)))

    def less_behind(self, frame: int, faces: AnyArray, rows: AnyArray, columns: AnyArray) -> Float:
        """(P,) cost of pixels as ones of the body's faces, less that as ones of the layer behind."""
        residual = self.images[frame, rows, columns] - self.surface[faces]
        return cauchy(residual, self.spread[faces]) - self.behind[frame, rows, columns]


@dataclass(frozen=True)
class LimbCost:
    """How the cost of a picture changes with one limb, all else of the body being where it is.

    Attributes:
        layers: of the view.
        frame: the picture.
        view: of the body.
        vertices: (V',) of the faces that move with the limb.
        corners: (F', 3) of those faces, numbered within `vertices`.
        surface: their brightness (F',) and the scale of the residuals under it (F',).
        before: (H, W) cost of what is seen without the limb, less that of the layer behind.
        nearness: (H, W) of it, 0 where there is nothing of the body.
    """

    layers: Layers
    frame: int
    view: ScaledView
    vertices: Int
    corners: Int
    surface: tuple[Float, Float]
    before: Float
    nearness: Float32

    @staticmethod
    def of(layers: Layers, frame: int, posed: Posed, view: ScaledView, segments: Bool) -> LimbCost:
        """For the limb of some segments (S,)."""
        body, (height, width) = posed.body, layers.images.shape[1:]
        moved = _carried_faces(body, segments)
        rest = np.flatnonzero(~moved)
        face, near = rasterise(*projected(view, posed.vertices), body.faces[rest], (0, 0), (width, height))
        rows, columns = np.nonzero(face >= 0)
        before = np.zeros((height, width))
        before[rows, columns] = layers.less_behind(frame, rest[face[rows, columns]], rows, columns)
        vertices, corners = np.unique(body.faces[moved], return_inverse=True)
        corners = corners.reshape(-1, 3).astype(np.int32)
        own = layers.surface[moved], layers.spread[moved]
        return LimbCost(layers, frame, view, vertices.astype(np.int32), corners, own, before, near)

    def __call__(self, posed: Posed) -> float:
        """With the limb as it is posed: that of the whole body less that of the body without the limb."""
        pixels, nearness = projected(self.view, np.take(posed.vertices, self.vertices, axis=0))
        height, width = self.before.shape
        x0, x1 = max(0, int(pixels[:, 0].min())), min(width - 1, int(pixels[:, 0].max()) + 1)
        y0, y1 = max(0, int(pixels[:, 1].min())), min(height - 1, int(pixels[:, 1].max()) + 1)
        if x0 > x1 or y0 > y1:
            return 0.0
        size = (x1 - x0 + 1, y1 - y0 + 1)
        face, near = rasterise(pixels, nearness, self.corners, (x0, y0), size)
        image, behind = self.layers.images[self.frame], self.layers.behind[self.frame]
        return _gained((face, near), (x0, y0), self.nearness, image, behind, self.before, *self.surface)


def _carried_faces(body: Body, segments: Bool) -> Bool:
    """(F,) faces of which some vertex moves with one of these segments (S,)."""
    carried = (body.skin_weights * segments[body.skin_segments]).sum(axis=1) > 0
    return carried[body.faces].any(axis=1)


@njit(cache=True, nogil=True)
def _gained(
    limb: tuple[Int, Float32], origin: tuple[int, int], there: Float32, image: Float, behind: Float, before: Float,
    surface: Float, spread: Float,
) -> float:  # fmt: skip
    """Sum of what changes where a limb's faces in a window lie before what is there: their cost less that before."""
    total, (face, near) = 0.0, limb
    for r in range(face.shape[0]):
        for c in range(face.shape[1]):
            f, y, x = face[r, c], r + origin[1], c + origin[0]
            if f >= 0 and near[r, c] > there[y, x]:
                z = (image[y, x] - surface[f]) / spread[f]
                total += np.log(spread[f] * (1.0 + z * z)) - behind[y, x] - before[y, x]
    return total


def cauchy(residual: Float, sigma: Float | float) -> Float:
    """``log σ + log(1 + (r / σ)²)``."""
    return np.log(sigma) + np.log1p((residual / sigma) ** 2)


def learnt(body: Body, images: Sequence[Float32], posed: Sequence[Posed], views: Sequence[ScaledView]) -> Layers:
    """The layers of one view.

    Args:
        body: that is seen.
        images: N grey pictures (H, W) by a camera that stands still.
        posed: the body in each, in its own frame.
        views: of it, in pixels of these pictures and of their size.
    """
    seen = [render(p, view) for p, view in zip(posed, views, strict=True)]
    clear = np.stack([_clear(s.mask) for s in seen])
    lit, still = _still(np.stack([np.asarray(image, np.float64) for image in images]), clear)
    known = np.isfinite(still)
    residual = lit - np.where(known, still, 0.0)
    told = clear & known
    sigma = max(_NOISE, 1.48 * float(np.median(np.abs(residual[told])))) if told.any() else _NOISE
    unknown = float(np.log(sigma)) + 1.5
    behind = np.where(known, cauchy(residual, sigma), unknown)
    return Layers(lit, behind, *_surface(body, lit, seen))


def _clear(mask: Bool) -> Bool:
    width = 2 * _CLEAR + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((width, width), np.uint8)) == 0, np.bool_)


def _still(images: Float, clear: Bool) -> tuple[Float, Float]:
    """Pictures (N, H, W) at the first one's exposure, and the layer behind (H, W), NaN where it is never clear."""
    lit, still = images.copy(), np.where(clear[0], images[0], np.nan)
    for _ in range(_ROUNDS):
        for n, image in enumerate(images):
            told = clear[n] & np.isfinite(still)
            if n > 0 and np.count_nonzero(told) > _FEWEST:
                gain, offset = _exposure(image[told], still[told])
                lit[n] = gain * image + offset
        still = _median(np.where(clear, lit, np.nan))
    return lit, still


def _exposure(value: Float, wanted: Float) -> tuple[float, float]:
    """Gain and offset that bring values (N,) to those wanted (N,): least squares, once more without what is far off."""
    kept = np.ones(len(value), dtype=bool)
    gain, offset = 1.0, 0.0
    for _ in range(2):
        gain, offset = (float(c) for c in np.polyfit(value[kept], wanted[kept], 1))
        off = np.abs(gain * value + offset - wanted)
        kept = off <= 3.0 * np.median(off)
    return gain, offset


def _surface(body: Body, lit: Float, seen: Sequence[RenderedView]) -> tuple[Float, Float]:
    """Brightness and scale of the residuals of every face; a face never seen is taken to be like its segment."""
    F, part = len(body.faces), body.face_part
    values = np.full((len(seen), F), np.nan)
    for n, look in enumerate(seen):
        face = look.face_index[look.mask]
        count = np.bincount(face, minlength=F)
        total = np.bincount(face, weights=lit[n][look.mask], minlength=F)
        values[n, count > 0] = total[count > 0] / count[count > 0]
    middle = _median(np.concatenate([values, values[:1], values[:1]]))  # the first state is known
    spread = np.zeros(F)
    for s in np.unique(part):
        own = part == s
        found = np.isfinite(middle) & own
        typical, wide = _middle_and_scale(middle[found])
        _, narrow = _middle_and_scale((values - middle)[:, found].ravel())
        spread[own] = np.where(found[own], narrow, max(wide, narrow))
        middle[own & ~found] = typical
    return middle, spread


def _middle_and_scale(values: Float) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return 0.5, 0.3
    middle = float(np.median(known))
    return middle, max(_NOISE, 1.48 * float(np.median(np.abs(known - middle))))


def _median(values: Float) -> Float:
    """Over the first axis, NaN left out; NaN where nothing is known."""
    known = np.isfinite(values).any(axis=0)
    out = np.full(values.shape[1:], np.nan)
    out[known] = np.nanmedian(values[:, known], axis=0)
    return out
