"""Large displacements within a mask: candidates gathered node by node, then proposed to whole limbs."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from twistcap.arrays import Bool, Float32, Int
from twistcap.flow.expansion import expand
from twistcap.flow.matching import LABEL, BlockRule, match_blocks, spread
from twistcap.flow.pyramid import resized_flow, smoothed
from twistcap.flow.settings import SearchSettings

_LEAST = 1.0  # px by which a motion must differ to be proposed
_LOOSE = 0.0007  # `SearchSettings.apart` while candidates are gathered: nearly each node for itself
_PRESMOOTH = 0.7  # px, standard deviation of the Gaussian over the images before they are compared
_WINDOW = 40.0  # px each way to which a motion is proposed


def large_displacements(
    first: Float32, second: Float32, mask: Bool, flow: Float32, settings: SearchSettings
) -> Float32:
    """(H, W, 2) px: a flow (h, w, 2) px of its own size, with limbs moved where the images then agree better. Of the
    images (H, W, C) only pixels on the mask (H, W) are compared."""
    s = settings
    a, b = (smoothed(image, _PRESMOOTH) for image in (first, second))
    nodes = np.ascontiguousarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))[:: s.step, :: s.step] > 0)
    window, images = round(_WINDOW / s.step), (a, b, mask)
    rule = BlockRule(
        s.step, s.half, s.spacing, s.radius, float(np.deg2rad(s.turn_deg)), s.ceiling, s.apart, s.most_apart, s.draws
    )

    def matched(labels: Float32, apart: float, rounds: int, loop: int) -> tuple[Float32, Float32]:
        return match_blocks(images, nodes, labels, _table(loop), rule._replace(apart=apart), rounds)

    here = resized_flow(flow, (mask.shape[0], mask.shape[1]))[:: s.step, :: s.step]
    still = np.concatenate([here, np.zeros((*here.shape[:2], LABEL - 2), np.float32)], axis=2)  # not turned
    labels, cost = matched(still, s.apart, 0, 0)
    for loop in range(s.loops):
        proposed, _ = matched(labels, _LOOSE, s.rounds, loop)
        order = _order(nodes, s.every, loop)
        expand(images, nodes, labels, cost, proposed, order, rule, (window, _LEAST))
        labels, cost = matched(labels, s.apart, s.polish, loop)
    return spread(labels, s.step, *mask.shape)


def _order(nodes: Bool, every: int, loop: int) -> Int:
    """(N, 2) one node in `every`, in a random order that is always the same."""
    places = np.argwhere(nodes).astype(np.int32)
    return places[np.random.default_rng(loop).permutation(len(places))[::every]]


@cache
def _table(loop: int) -> Float32:
    """(N, 3) random places in the unit disc and turns in [-1, 1]; always the same."""
    rng = np.random.default_rng(loop)
    n = 4093  # a prime: rounds of candidates do not meet the same draws again
    angle, radius = rng.uniform(0, 2 * np.pi, n), np.sqrt(rng.uniform(size=n))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-1, 1, n)], axis=1).astype(np.float32)
