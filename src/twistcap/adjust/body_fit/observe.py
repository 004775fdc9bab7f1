"""Where the images put the body's visible contour: what the shape is fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap._typing import AnyArray, Bool, Float, Int
from twistcap.adjust.body_fit.subpixel import refined
from twistcap.adjust.first_pose.outline import match, outline_of
from twistcap.body import Posed
from twistcap.camera import Camera, Rig
from twistcap.cues.direct import DirectContour
from twistcap.cues.view import View, crop_view
from twistcap.features import Channels
from twistcap.render import ContourPoints, contour_on_edges, render
from twistcap.render.contour import reprojected
from twistcap.terms import PointNormalTerm

_MARGIN = 0.15  # m about the body that is looked at
_CONTRAST = 1.5  # standard deviations between the sides' colours at which an edge counts by half


@dataclass(frozen=True)
class Observed:
    """N contour points of one view of one frame, and how far off the image has them.

    Attributes:
        camera: the pinhole camera.
        contour: points of the body as it was looked at.
        ends, shares: (N, 2) vertices of the edge each lies on, and their shares.
        distance: (N,) px outward along the image normal.
        weight: (N,) information, 1/px².
        px_per_m: scale of the image at the body.
    """

    camera: Camera
    contour: ContourPoints
    ends: Int
    shares: Float
    distance: Float
    weight: Float
    px_per_m: float


@dataclass(frozen=True)
class Contours:
    """How contours are observed.

    Attributes:
        direct: the tracker's cue by which the edge is found along the normals.
        spacing: m on the body between points.
        channels: of the images, as the tracker's.
        reach: m within which a given mask's outline is looked for.
        mask_sigma: standard deviation of a given mask's outline, px.
    """

    direct: DirectContour = field(default_factory=DirectContour)
    spacing: float = 0.025
    channels: Channels = "lab"
    reach: float = 0.06
    mask_sigma: float = 0.7


def observe(images: Sequence[AnyArray | None], rig: Rig, posed: Posed, rule: Contours) -> list[Observed]:
    """The contour in all views of one frame; views without image or body are left out.

    Args:
        images: rectified, of the (pinhole) rig.
        posed: the body where it is thought to be.
    """
    out: list[Observed] = []
    for image, camera in zip(images, rig, strict=True):
        view = None if image is None else crop_view(image, camera, posed, _MARGIN, rule.channels)
        if view is not None:
            out.append(_observed(view, posed, rule))
    return out


def observe_masks(masks: Sequence[Bool | None], rig: Rig, posed: Posed, rule: Contours) -> list[Observed]:
    """The contour against the outlines of given silhouettes (H, W), in the pixels of the (pinhole) rig."""
    out: list[Observed] = []
    for mask, camera in zip(masks, rig, strict=True):
        if mask is None or not mask.any():
            continue
        seen = render(posed, camera)
        contour, ends, shares = contour_on_edges(seen, max(1.0, rule.spacing * seen.px_per_m))
        found = match(contour, outline_of(mask, rule.spacing * seen.px_per_m), rule.reach * seen.px_per_m)
        on = replace(reprojected(contour, posed, camera.P)[found.index], normals=found.normals)
        weight = found.weight / rule.mask_sigma**2
        out.append(Observed(camera, on, ends[found.index], shares[found.index], found.distance, weight, seen.px_per_m))
    return out


def _observed(view: View, posed: Posed, rule: Contours) -> Observed:
    seen = render(posed, view.camera)
    contour, ends, shares = contour_on_edges(seen, max(1.0, rule.spacing * seen.px_per_m))
    nothing = np.zeros((len(posed.body.segment_names), 1 + 2 * view.features.shape[2]))  # remembered colours
    found = rule.direct.locate(view, seen, contour, 1.0, nothing)
    assert isinstance(found.term, PointNormalTerm)
    distance, contrast = refined(view.image, contour.pixels, contour.normals, found.displacement)
    doubt = 1.0 + (_CONTRAST / np.maximum(contrast, 1e-6)) ** 2
    weight = np.where(contour.outer, found.term.weight / doubt, 0.0)
    placed = reprojected(contour, posed, view.camera.P)  # where the points are that are bound to the surface
    return Observed(view.camera, placed, ends, shares, distance, weight, seen.px_per_m)
