"""Images, masks and flow from one size to another; pixel centres are at integers (CONVENTIONS.md)."""

from __future__ import annotations

import cv2
import numpy as np

from twistcap._typing import Bool, Float32

Shape = tuple[int, int]
_COVERED = 0.4  # share of a coarse pixel that the mask must cover: thin limbs stay


def level_shapes(shape: Shape, factor: float, least_size: int, finest: float = 1.0) -> list[Shape]:
    """(height, width) of each level, finest first, down to a shorter side of `least_size` px."""
    shapes = [_scaled(shape, finest)]
    while True:
        new = _scaled(shape, finest * factor ** len(shapes))
        if min(new) < least_size or new == shapes[-1]:
            return shapes
        shapes.append(new)


def _scaled(shape: Shape, scale: float) -> Shape:
    return max(1, round(shape[0] * scale)), max(1, round(shape[1] * scale))


def resized_image(image: Float32, shape: Shape, presmooth: float) -> Float32:
    """(h, w, C) of an image (H, W, C), smoothed by so much (px) in its new size, and against aliasing."""
    scale = image.shape[0] / shape[0]
    sigma = float(np.hypot(presmooth, 0.6 * np.sqrt(max(scale**2 - 1.0, 0.0))))
    if sigma > 0.05:
        image = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT).reshape(image.shape)
    return _resized(image, shape)


def resized_mask(mask: Bool, shape: Shape) -> Bool:
    """(h, w) of a mask (H, W)."""
    if mask.shape == shape:
        return mask
    return cv2.resize(mask.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA) > _COVERED


def resized_flow(flow: Float32, shape: Shape) -> Float32:
    """(h, w, 2) of a flow (H, W, 2), both in px of their own size."""
    if flow.shape[:2] == shape:
        return flow
    return _resized(flow, shape) * np.array([shape[1] / flow.shape[1], shape[0] / flow.shape[0]], np.float32)


def _resized(image: Float32, shape: Shape) -> Float32:
    if image.shape[:2] == shape:
        return image
    return cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(*shape, image.shape[2])


def filled(flow: Float32, mask: Bool) -> Float32:
    """The flow (H, W, 2) with each pixel off the mask (H, W) as the nearest one on it, so that it may be interpolated."""
    if mask.all() or not mask.any():
        return flow
    off = np.logical_not(mask).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(off, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL)
    table = np.empty((int(labels.max()) + 1, 2), np.float32)
    table[labels[mask]] = flow[mask]
    return np.take(table, labels, axis=0)
