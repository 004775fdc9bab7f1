"""Warping from coarse to fine: an outer fixed point over the flow, an inner one over the lagged weights.

Brox, Bruhn, Papenberg and Weickert 2004, "High accuracy optical flow estimation based on a theory for warping", DOI
10.1007/978-3-540-24673-2_3; within a mask, eq. 11.24-11.27 of Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and
Prior Knowledge".
"""

from __future__ import annotations

import cv2
import numpy as np

from twistcap.arrays import Bool, Float32
from twistcap.flow.data import derivative_maps, motion_tensors
from twistcap.flow.pyramid import box_of, filled, level_shapes, pyramid, resized_flow, resized_mask
from twistcap.flow.search import large_displacements
from twistcap.flow.settings import FlowSettings
from twistcap.flow.solver import assemble, data_weights, diffusivity, relax

_REACH = 8  # px about the mask that its derivatives need
_MARGIN = 2  # px about the mask that the next finer level may need
_EPSILON = 0.001  # of Ψ(s²) = sqrt(s² + ε²), in each term's own unit
_PRESMOOTH = 0.6  # px, standard deviation of the Gaussian over the images of every level
_SEARCH_SCALE = 0.5  # levels coarser than this come before the search, finer ones after it


def coarse_to_fine(first: Float32, second: Float32, mask: Bool, settings: FlowSettings) -> Float32:
    """(H, W, 2) flow in px from the first image to the second, both (H, W, C) in [0, 1], within a mask (H, W)."""
    s, shape = settings, (first.shape[0], first.shape[1])
    shapes = level_shapes(shape, s.factor, s.least_size, s.finest)
    levels = list(zip(pyramid(first, shapes, _PRESMOOTH), pyramid(second, shapes, _PRESMOOTH), strict=True))
    before = [level for level in levels if level[0].shape[0] < _SEARCH_SCALE * shape[0]]
    flow = np.zeros((*shapes[-1], 2), np.float32)
    for level in reversed(before):
        flow = _at_level(*level, mask, flow, s)
    if s.search is not None and not mask.all():
        flow = large_displacements(first, second, mask, flow, s.search)
        near = box_of(mask, _REACH)
        flow[near] = filled(flow[near], mask[near])
    for level in reversed(levels[: len(levels) - len(before)]):
        flow = _at_level(*level, mask, flow, s)
    return filled(resized_flow(flow, shape), mask)


def _at_level(first: Float32, second: Float32, mask: Bool, flow: Float32, s: FlowSettings) -> Float32:
    """The flow at the size of these images, refined in the window of the mask."""
    shape = (first.shape[0], first.shape[1])
    inside, flow = resized_mask(mask, shape), resized_flow(flow, shape)
    if not inside.any():
        return flow
    near, box = box_of(inside, _REACH), box_of(inside, _MARGIN)
    window = np.ascontiguousarray(inside[box])
    corner, (H, W) = (box[0].start, box[1].start), window.shape
    top, left = corner[0] - near[0].start, corner[1] - near[1].start
    maps = np.ascontiguousarray(derivative_maps(first[near])[:, top : top + H, left : left + W])
    out = flow.copy()
    out[box] = filled(refined(maps, derivative_maps(second), window, flow[box], corner, s), window)
    return out


def refined(
    first: Float32, second: Float32, mask: Bool, flow: Float32, corner: tuple[int, int], settings: FlowSettings
) -> Float32:
    """(H, W, 2) px flow after `warps` outer fixed points on one level; off the mask it has no meaning. Maps, mask and
    corner are as for `motion_tensors`, the flow (H, W, 2) px."""
    s = settings
    u, v = (np.ascontiguousarray(flow[..., k]) for k in range(2))
    for _ in range(s.warps):
        u0, v0 = u.copy(), v.copy()
        tensors = motion_tensors(first, second, u, v, mask, corner, s.zeta, s.blend)
        for _ in range(s.inner):
            data = data_weights(tensors, u - u0, v - v0, s.gamma, _EPSILON)
            g = diffusivity(u, v, mask, _EPSILON)
            relax(assemble(data, u0, v0, g, s.alpha, mask), u, v, s.sweeps, s.omega)
        if s.median:
            u, v = (np.asarray(cv2.medianBlur(x, s.median), np.float32) for x in (u, v))
    return np.stack([u, v], axis=-1)
