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

from twistcap._typing import Bool, Float, Float32
from twistcap.body import Body, Posed
from twistcap.differential.render import OrthographicView, render
from twistcap.differential.view import ScaledView

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

    def cost(self, frame: int, seen: OrthographicView) -> float:
        """Negative log likelihood of a picture under both layers, less that of nothing but the layer behind."""
        mask = seen.mask
        face = seen.face_index[mask]
        residual = self.images[frame][mask] - self.surface[face]
        return float(np.sum(cauchy(residual, self.spread[face]) - self.behind[frame][mask]))


def cauchy(residual: Float, sigma: Float | float) -> Float:
    """``log σ + log(1 + (r / σ)²)``."""
    return np.log(sigma) + np.log1p((residual / sigma) ** 2)


def learnt(body: Body, images: Sequence[Float32], posed: Sequence[Posed], views: Sequence[ScaledView]) -> Layers:
    """The layers of one view.

    Args:
        body: that is seen.
        images: N grey pictures (H, W) by a camera that stands still.
        posed: the body in each, in its own frame.
        views: of it, in pixels of these pictures.
    """
    size = (images[0].shape[1], images[0].shape[0])
    seen = [render(p, view, size) for p, view in zip(posed, views, strict=True)]
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


def _surface(body: Body, lit: Float, seen: Sequence[OrthographicView]) -> tuple[Float, Float]:
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
