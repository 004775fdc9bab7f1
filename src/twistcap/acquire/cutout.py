"""A silhouette cut out by hand: a rectangle, strokes on person and background, and GrabCut between them.

Rother, Kolmogorov and Blake, *GrabCut: Interactive Foreground Extraction using Iterated Graph Cuts*, ACM TOG 23(3),
2004 (DOI 10.1145/1015706.1015720), in OpenCV's implementation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from twistcap.acquire.silhouette import one_person
from twistcap.arrays import Bool, Float, UInt8

_ROUNDS = 4
_SURE = 0.02  # of the image's height: an earlier silhouette is certain farther than this from its edge
_LARGEST = 640  # px; a larger image is made smaller for the cut, and the silhouette is enlarged again


@dataclass(frozen=True)
class Stroke:
    """A line drawn on the person (`inside`) or on the background: points (N, 2) x, y and width, px."""

    inside: bool
    points: Float
    width: float


@dataclass(frozen=True)
class Hints:
    """The user's drawing on one image, in its pixels: x and y of two corners of a rectangle around the person (None
    where an earlier silhouette is mended), and strokes in the order drawn; later ones paint over earlier ones."""

    rectangle: tuple[float, float, float, float] | None = None
    strokes: Sequence[Stroke] = field(default_factory=tuple)


def cut_out(image: UInt8, hints: Hints, known: Bool | None = None) -> Bool | None:
    """The person's silhouette (H, W) in an image (H, W, 3), one piece without small holes; None without any hint. An
    earlier silhouette `known` (H, W) counts where there is no rectangle."""
    height, width = image.shape[:2]
    factor = min(1.0, _LARGEST / max(height, width))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    labels = _labels(size, hints, known, factor)
    if labels is None:
        return None
    inside = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    if inside.any() and not inside.all():
        cv2.setRNGSeed(0)  # its mixtures begin at random
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.grabCut(small, labels, (0, 0, 1, 1), *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)
        inside = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    person = one_person(inside).astype(np.float32)
    return cv2.resize(person, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5


def _labels(size: tuple[int, int], hints: Hints, known: Bool | None, factor: float) -> UInt8 | None:
    """(h, w) OpenCV's labels before the cut."""
    if hints.rectangle is not None:
        labels = np.full(size[::-1], cv2.GC_BGD, np.uint8)
        corners = np.sort(np.reshape(hints.rectangle, (2, 2)) * factor, axis=0)
        (x0, y0), (x1, y1) = np.clip(np.rint(corners), 0, size).astype(int)
        labels[y0:y1, x0:x1] = cv2.GC_PR_FGD
    elif known is not None and known.any():
        labels = _doubted(cv2.resize(known.astype(np.uint8), size, interpolation=cv2.INTER_AREA) > 0)
    else:
        return None
    for stroke in hints.strokes:
        points = np.rint((stroke.points + 0.5) * factor - 0.5).astype(np.int32).reshape(-1, 1, 2)
        value = cv2.GC_FGD if stroke.inside else cv2.GC_BGD
        wide = max(1, round(stroke.width * factor))
        cv2.polylines(labels, [points], False, int(value), wide)
        for x, y in points[[0, -1], 0].tolist():  # a single click is a dot
            cv2.circle(labels, (x, y), wide // 2, int(value), -1)
    return labels


def _doubted(mask: Bool) -> UInt8:
    """Labels of an earlier silhouette: its edge is open, the rest is not."""
    reach = max(2.0, _SURE * mask.shape[0])
    within, without = (cv2.distanceTransform(a.astype(np.uint8), cv2.DIST_L2, 3) for a in (mask, ~mask))
    labels = np.where(mask, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[within > reach] = cv2.GC_FGD
    labels[without > reach] = cv2.GC_BGD
    return labels
