"""Images, masks and flow from one size to another; pixel centres are at integers (CONVENTIONS.md)."""

from __future__ import annotations

import cv2
import numpy as np

from twistcap.arrays import Bool, Float32

Shape = tuple[int, int]
_COVERED = 0.4  # fraction of a coarse pixel that the mask must cover: thin limbs stay


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


def pyramid(image: Float32, shapes: list[Shape], presmooth: float) -> list[Float32]:
    """The image (H, W, C) in each of these sizes, finest first, smoothed by `presmooth` px in its new size."""
    out, at, sigma = list[Float32](), image, presmooth * image.shape[0] / shapes[0][0]
    for shape in shapes:
        if out:
            sigma = presmooth * float(np.sqrt((at.shape[0] / shape[0]) ** 2 - 1.0))  # there is some already
        at = _resized(smoothed(at, sigma), shape)
        out.append(at)
    return out


def smoothed(image: Float32, sigma: float) -> Float32:
    """(H, W, C) after a Gaussian of `sigma` px; reflecting borders."""
    if sigma < 0.05:
        return image
    size = 2 * int(np.ceil(3.0 * sigma)) + 1
    blurred = cv2.GaussianBlur(image, (size, size), sigma, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float32).reshape(image.shape)


def resized_mask(mask: Bool, shape: Shape) -> Bool:
    """(h, w) of a mask (H, W)."""
    if mask.shape == shape:
        return mask
    return cv2.resize(mask.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA) > _COVERED


def resized_flow(flow: Float32, shape: Shape) -> Float32:
    """(h, w, 2) of a flow (H, W, 2), both in px of their own size."""
    if flow.shape[:2] == shape:
        return flow
    out = _resized(flow, shape)
    out[..., 0] *= shape[1] / flow.shape[1]
    out[..., 1] *= shape[0] / flow.shape[0]
    return out


def _resized(image: Float32, shape: Shape) -> Float32:
    if image.shape[:2] == shape:
        return image
    new = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(new, np.float32).reshape(*shape, image.shape[2])


def box_of(mask: Bool, margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold a mask (H, W) and a margin (px) about it."""
    places = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(at[0]) - margin, 0), int(at[-1]) + margin + 1) for at in places)
    return rows, columns


def filled(flow: Float32, mask: Bool) -> Float32:
    """The flow (H, W, 2) with each pixel off the mask (H, W) as the nearest one on it, for interpolation."""
    if mask.all() or not mask.any():
        return flow
    off = np.logical_not(mask).astype(np.uint8)
    found = cv2.distanceTransformWithLabels(off, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL)
    labels = np.asarray(found[1], np.int32)
    table = np.empty((int(labels.max()) + 1, 2), dtype=np.float32)
    table[labels[mask]] = flow[mask]
    return table[labels]
