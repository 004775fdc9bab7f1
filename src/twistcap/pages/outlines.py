"""The outline of a posed body in a camera's image, as polylines that a page can draw."""

from __future__ import annotations

import cv2
import numpy as np

from twistcap.arrays import Float
from twistcap.body import Posed
from twistcap.camera import Camera
from twistcap.render.raster import rasterise
from twistcap.report.overlay import visible_projection

_LARGEST = 800  # px; rendering larger would cost time and show nothing
_TOLERANCE = 0.6  # px of that rendering by which a polyline may leave the outline
_SMALLEST = 12.0  # px² below which a patch is a speck between two limbs


def body_outlines(camera: Camera, posed: Posed) -> list[Float]:
    """Closed polylines (M, 2) around the silhouette and its holes, in the camera's own (distorted) pixels."""
    small = camera.scaled(min(1.0, _LARGEST / max(camera.size)))
    pixels, inverse_depth = visible_projection(small, posed.vertices)
    face_index, _ = rasterise(pixels, inverse_depth, posed.body.faces, (0, 0), small.size)
    curves, _ = cv2.findContours((face_index >= 0).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    kept = [curve for curve in curves if cv2.contourArea(curve) > _SMALLEST]
    factor = np.array(camera.size) / np.array(small.size)
    return [(cv2.approxPolyDP(curve, _TOLERANCE, True)[:, 0] + 0.5) * factor - 0.5 for curve in kept]


def flat(curves: list[Float], factor: float = 1.0) -> list[list[float]]:
    """Polylines as JSON takes them: x, y, x, y, …, tenths of a pixel, of the image resized by `factor`."""
    shift = 0.5 * factor - 0.5
    return [np.round(curve * factor + shift, 1).ravel().tolist() for curve in curves]
