"""Where the images show the body's visible contour, to which the shape is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twistcap.adjust.first_pose.outline import match, outline_of
from twistcap.arrays import AnyArray, Bool, Float, Int
from twistcap.body import Posed
from twistcap.camera import Camera, Rig
from twistcap.cues.direct import DirectContour
from twistcap.cues.view import View, crop_view
from twistcap.features import Channels
from twistcap.render import ContourPoints, contour_on_edges, render
from twistcap.render.contour import reprojected
from twistcap.terms import PointNormalTerm

CHANNELS: Channels = "lab"
"""Of the images, as the tracker's default."""
MARGIN = 0.15
"""m about the body that an image is cropped to."""
_CUE = DirectContour()  # finds the edge along the normals
_SPACING = 0.025  # m on the body between points
_REACH = 0.06  # m within which the outline of a given mask is searched for
_MASK_SIGMA = 0.7  # px, standard deviation of the outline of a given mask
_CONTRAST = 1.5  # standard deviations between the sides' colours at which an edge counts by half
_STEP = 0.25  # px between samples
_HALF, _FAR = 1.75, 4.0  # px: half the window in which the edge lies; where the sides' colours end


@dataclass(frozen=True)
class Observed:
    """N contour points of one view of one frame, and their distances to the edge in the image.

    The contour is of the body as rendered, `ends` and `shares` (N, 2) are vertices of the mesh edge of each point and
    their weights, `distance` (N,) px is outward along the image normal, `weight` (N,) its information, 1/px², and
    `px_per_m` the scale of the image at the body.
    """

    camera: Camera
    contour: ContourPoints
    ends: Int
    shares: Float
    distance: Float
    weight: Float
    px_per_m: float


def observe(images: Sequence[AnyArray | None], rig: Rig, posed: Posed) -> list[Observed]:
    """The contour in all rectified images of one frame; views without image or body are left out."""
    return [_observed(view, posed) for view in cropped(images, rig, posed)]


def cropped(images: Sequence[AnyArray | None], rig: Rig, posed: Posed) -> list[View]:
    """The images of a (pinhole) rig about the body; views without image or body are left out."""
    pairs = [(image, camera) for image, camera in zip(images, rig, strict=True) if image is not None]
    views = [crop_view(image, camera, posed, MARGIN, CHANNELS) for image, camera in pairs]
    return [view for view in views if view is not None]


def observe_masks(masks: Sequence[Bool | None], rig: Rig, posed: Posed) -> list[Observed]:
    """The contour against the outlines of given silhouettes (H, W), in the pixels of the (pinhole) rig."""
    out: list[Observed] = []
    for mask, camera in zip(masks, rig, strict=True):
        if mask is None or not mask.any():
            continue
        seen = render(posed, camera)
        contour, ends, shares = contour_on_edges(seen, max(1.0, _SPACING * seen.px_per_m))
        matches = match(contour, outline_of(mask, _SPACING * seen.px_per_m), _REACH * seen.px_per_m)
        on, own = reprojected(contour, posed, camera.P)[matches.index], matches.index
        on, weight = replace(on, normals=matches.normals), matches.weight / _MASK_SIGMA**2
        out.append(Observed(camera, on, ends[own], shares[own], matches.distance, weight, seen.px_per_m))
    return out


def _observed(view: View, posed: Posed) -> Observed:
    seen = render(posed, view.camera)
    contour, ends, shares = contour_on_edges(seen, max(1.0, _SPACING * seen.px_per_m))
    nothing = np.zeros((len(posed.body.segment_names), 1 + 2 * view.features.shape[2]))  # remembered colours
    evidence = _CUE.locate(view, seen, contour, 1.0, nothing)
    assert isinstance(evidence.term, PointNormalTerm)
    distance, contrast = refined(view.image, contour.pixels, contour.normals, evidence.displacement)
    doubt = 1.0 + (_CONTRAST / np.maximum(contrast, 1e-6)) ** 2
    weight = np.where(contour.outer, evidence.term.weight / doubt, 0.0)
    placed = reprojected(contour, posed, view.camera.P)  # of the points on the surface
    return Observed(view.camera, placed, ends, shares, distance, weight, seen.px_per_m)


def refined(image: AnyArray, pixels: Float, normals: Float, distance: Float) -> tuple[Float, Float]:
    """Distances (N,) px along the normals, and the contrast (N,) there in standard deviations of the colours.

    They are exact to a small fraction of a pixel: along a line across an edge, the integral of the inside's coverage is
    the length inside. A blur that is alike on both sides preserves it (moments: Tabatabai and Mitchell,
    DOI 10.1109/TPAMI.1984.4767502). The image (H, W[, 3]) is nearly linear in light. Points and unit directions (N, 2)
    lead from the inside outward, and `distance` (N,) px to the edge is known to about a pixel.
    """
    values, contrast, start = np.ascontiguousarray(image, dtype=np.float32), np.zeros(len(pixels)), distance
    for _ in range(2 if len(pixels) else 0):
        shift, contrast = _shift(values, pixels + distance[:, None] * normals, normals)
        distance = start + np.clip(distance + shift - start, -_HALF, _HALF)
    return distance, contrast


def _shift(image: AnyArray, pixels: Float, normals: Float) -> tuple[Float, Float]:
    at = np.arange(-_FAR, _FAR + _STEP / 2, _STEP)
    where = (pixels[:, None] + at[:, None] * normals[:, None]).astype(np.float32)
    line = cv2.remap(image, where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    line = line.reshape(len(pixels), len(at), -1).astype(np.float64)
    inside, outside = line[:, at < -_HALF], line[:, at > _HALF]
    inner, outer = inside.mean(axis=1), outside.mean(axis=1)
    apart = inner - outer
    size = np.maximum(np.sum(apart**2, axis=1), 1e-12)
    cover = np.einsum("nsc,nc->ns", line[:, np.abs(at) <= _HALF] - outer[:, None], apart) / size[:, None]
    spread = np.sqrt(0.5 * (inside.var(axis=1) + outside.var(axis=1)).sum(axis=1))
    weight = np.full(cover.shape[1], _STEP)
    weight[[0, -1]] *= 0.5  # trapezoids
    return np.clip(cover, -0.5, 1.5) @ weight - _HALF, np.sqrt(size) / np.maximum(spread, 1e-3 * 255)
