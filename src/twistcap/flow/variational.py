"""Warping from coarse to fine: the outer fixed point over the flow, the inner one over the lagged weights.

Brox, Bruhn, Papenberg and Weickert 2004, "High accuracy optical flow estimation based on a theory for warping", DOI
10.1007/978-3-540-24673-2_3; with homogeneous smoothness within a mask, eq. 11.24-11.27 of Brox, Rosenhahn and Cremers,
"Contours, Optic Flow, and Prior Knowledge".
"""

from __future__ import annotations

import cv2
import numpy as np

from twistcap._typing import Bool, Float32
from twistcap.flow.data import derivative_maps, motion_tensors
from twistcap.flow.pyramid import filled, level_shapes, resized_flow, resized_image, resized_mask
from twistcap.flow.search import searched
from twistcap.flow.settings import FlowSettings
from twistcap.flow.solver import assemble, data_weights, diffusivity, relax


def coarse_to_fine(
    first: Float32, second: Float32, mask: Bool, settings: FlowSettings, initial: Float32 | None = None
) -> Float32:
    """(H, W, 2) flow in px from the first image to the second, both (H, W, C) in [0, 1], within a mask (H, W).

    An initial flow (H, W, 2) px enters where the levels are as coarse as `search_scale`: coarser ones would blur it.
    """
    s, shape = settings, first.shape[:2]
    shapes = level_shapes((shape[0], shape[1]), s.factor, s.least_size, s.finest)
    coarse = [h_w for h_w in reversed(shapes) if h_w[0] < s.search_scale * shape[0]]
    fine = shapes[len(shapes) - len(coarse) - 1 :: -1]
    flow = initial
    if flow is None:
        flow = np.zeros((*shapes[-1], 2), np.float32)
        for level in coarse:
            flow = _at_level(first, second, mask, flow, level, s)
    if s.search is not None and not mask.all():
        flow = searched(first, second, mask, flow, s.search)
    for level in fine:
        flow = _at_level(first, second, mask, flow, level, s)
    return resized_flow(flow, (shape[0], shape[1]))


def _at_level(
    first: Float32, second: Float32, mask: Bool, flow: Float32, level: tuple[int, int], s: FlowSettings
) -> Float32:
    inside, flow = resized_mask(mask, level), resized_flow(flow, level)
    if not inside.any():
        return flow
    maps = (derivative_maps(resized_image(image, level, s.presmooth)) for image in (first, second))
    return filled(refined(*maps, inside, flow, s), inside)


def refined(first: Float32, second: Float32, mask: Bool, flow: Float32, settings: FlowSettings) -> Float32:
    """(H, W, 2) flow after `warps` outer fixed points on one level; off the mask it stays as it is.

    Args:
        first, second: (C, H, W, 6) `derivative_maps` of the images.
        mask: (H, W).
        flow: (H, W, 2) px.
        settings: of the model.
    """
    s = settings
    u, v = (np.ascontiguousarray(flow[..., k]) for k in range(2))
    even = np.ones_like(u)
    for _ in range(s.warps):
        u0, v0 = u.copy(), v.copy()
        tensors = motion_tensors(first, second, u, v, mask, s.zeta, s.blend)
        for _ in range(s.inner):
            data = data_weights(tensors, u - u0, v - v0, s.gamma, s.epsilon_data, s.robust_data)
            g = diffusivity(u, v, mask, s.epsilon_smooth) if s.smoothness == "robust" else even
            relax(assemble(data, u0, v0, g, s.alpha, mask), u, v, s.sweeps, s.omega)
        if s.median:
            u, v = (np.asarray(cv2.medianBlur(x, s.median), np.float32) for x in (u, v))
    return np.stack([u, v], axis=-1)
