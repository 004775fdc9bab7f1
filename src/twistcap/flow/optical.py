"""`optical_flow`: checks its input and computes the flow."""

from __future__ import annotations

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Bool, Float32
from twistcap.errors import InputError, check
from twistcap.features import to_float
from twistcap.flow.settings import PRESETS, FlowSettings, Preset
from twistcap.flow.variational import coarse_to_fine


def optical_flow(
    image1: AnyArray, image2: AnyArray, *, mask: Bool | None = None, preset: Preset = "accurate",
    settings: FlowSettings | None = None,
) -> Float32:  # fmt: skip
    """Where the points of the first image are in the second: (H, W, 2) px, (x, y) to (x + u, y + v).

    Source: Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", eq. 11.24, and Brox et al. 2004;
    `FlowSettings` lists what was added. The same images give the same flow.

    Args:
        image1, image2: (H, W) or (H, W, C), uint8 or float in [0, 1]; all channels count alike.
        mask: (H, W), the foreground in the first image: other pixels do not count and nothing is smoothed across its
            edge. Off it the flow is that of the nearest pixel on it. Within a mask, displacements up to
            `SearchSettings.radius` are searched: limbs may move farther than they are wide.
        preset: "accurate" (some tenths of a second for a person) or "fast" (some milliseconds).
        settings: used instead of the preset's; `BROX_2004` is the published form.

    Raises InputError for images that differ in size or channels, are empty or not finite, a mask of another size or
    without a pixel, an unknown preset, or settings out of range.
    """
    chosen = _chosen(preset, settings)
    first, second = _channels(image1, "first"), _channels(image2, "second")
    if first.shape != second.shape:
        sizes = f"{image1.shape} and {image2.shape}"
        raise InputError(f"optical_flow: the images have sizes {sizes}; give two of the same size.")
    shape = (first.shape[0], first.shape[1])
    inside = np.ones(shape, bool) if mask is None else _mask(mask, shape)
    return coarse_to_fine(first, second, inside, chosen)


def flow_confidence(forward: Float32, backward: Float32) -> Float32:
    """(H, W) in [0, 1]: forward-backward consistency of flows (H, W, 2) px; 0 where the flow leaves the image.

    ``exp(-d² / 2b)`` for the distance d (px) between a point and its place after the forward and the backward flow. b
    is 0.5 px² plus 1 % of both squared lengths, the bound of Sundaram, Brox and Keutzer 2010
    (DOI 10.1007/978-3-642-15549-9_32). A vector below exp(-1/2) = 0.61 fails their test; most points that are occluded
    in the second image do. Raises InputError if the two differ in size.
    """
    if forward.shape != backward.shape or forward.ndim != 3 or forward.shape[2] != 2:
        sizes = f"{forward.shape} and {backward.shape}"
        raise InputError(f"flow_confidence: sizes {sizes} must both be the same (H, W, 2).")
    H, W, _ = forward.shape
    x, y = np.meshgrid(np.arange(W, dtype=np.float32), np.arange(H, dtype=np.float32))
    x, y = x + forward[..., 0], y + forward[..., 1]
    back = cv2.remap(backward, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    distance2 = np.square(forward + back).sum(axis=-1)
    bound = 0.5 + 0.01 * (np.square(forward).sum(axis=-1) + np.square(back).sum(axis=-1))
    seen = (x >= -0.5) & (y >= -0.5) & (x <= W - 0.5) & (y <= H - 0.5)
    return np.where(seen, np.exp(-0.5 * distance2 / bound), 0.0).astype(np.float32)


def moved_mask(mask: Bool, flow: Float32) -> Bool:
    """(H, W) the mask (H, W) moved by a flow (H, W, 2) px, gaps of a px or two closed: the mask of the flow back."""
    H, W = mask.shape
    rows, columns = np.nonzero(mask)
    at = np.rint(np.stack([columns, rows], axis=1) + flow[rows, columns]).astype(int)
    at = at[(at >= 0).all(axis=1) & (at < (W, H)).all(axis=1)]
    out = np.zeros((H, W), np.uint8)
    out[at[:, 1], at[:, 0]] = 1
    return cv2.morphologyEx(out, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0


def _chosen(preset: str, settings: FlowSettings | None) -> FlowSettings:
    check("optical_flow", preset in PRESETS, f"preset is {preset!r}; it must be one of {', '.join(map(repr, PRESETS))}")
    s = PRESETS[preset] if settings is None else settings
    for name, holds, wanted in (
        ("factor", 0 < s.factor < 1, "between 0 and 1"),
        ("finest", 0 < s.finest <= 1, "above 0 and at most 1"),
        ("omega", 0 < s.omega < 2, "between 0 and 2"),
        ("median", s.median in (0, 3, 5), "0, 3 or 5"),
    ):
        check("optical_flow", holds, f"{name} is {getattr(s, name)!r}; it must be {wanted}")
    return s


def _channels(image: AnyArray, which: str) -> Float32:
    """(H, W, C) float32 of an image."""
    if image.ndim not in (2, 3) or image.size == 0:
        raise InputError(f"optical_flow: the {which} image has size {image.shape}; give (H, W) or (H, W, C).")
    values = to_float(image)
    if not np.isfinite(values).all():
        raise InputError(f"optical_flow: the {which} image has values that are not finite; replace them first.")
    return np.ascontiguousarray(values.reshape(*image.shape[:2], -1))


def _mask(mask: AnyArray, shape: tuple[int, int]) -> Bool:
    if mask.shape != shape:
        raise InputError(f"optical_flow: the mask has size {mask.shape}, the images {shape}; give one of their size.")
    inside = np.ascontiguousarray(mask, dtype=bool)
    check("optical_flow", inside.any(), "the mask has no pixel; leave it out for the flow of the whole image")
    return inside
