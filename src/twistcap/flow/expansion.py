"""Rigid expansion: whole limbs change their motion at once.

A single node cannot leave its neighbours, even where all of them together would gain. So the rigid motion of one node
is proposed to all nodes around it: a fusion of two labellings (Lempitsky, Rother, Roth and Blake 2010, "Fusion moves
for Markov random field optimization", DOI 10.1109/TPAMI.2009.143). Belief propagation decides which nodes accept. The
move is carried out only if the energy falls.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float32, Int
from twistcap.flow.matching import FAST, LABEL, BlockRule, Images, PartingRule, block_cost, carried, parting_of

_SWEEPS = 4
_HUGE = np.float32(1e3)

Box = tuple[int, int, int, int]
"""First row of nodes and the one after the last, first column and the one after the last."""


@njit(cache=True, nogil=True, fastmath=FAST)
def expand(
    images: Images, nodes: Bool, labels: Float32, cost: Float32, proposed: Float32, order: Int, rule: BlockRule,
    move: tuple[int, float],
) -> int:  # fmt: skip
    """Propose the motions `proposed` (h, w, 4) of the nodes in `order` (N, 2), one after the other.

    Args:
        images, nodes, rule: as for `match_blocks`.
        labels, cost: (h, w, 4) present motions and (h, w) their block costs; both change in place.
        move: nodes each way to which a motion is proposed, and the least difference (px) from the node's present one.

    Returns:
        Number of motions that some nodes accepted.
    """
    (window, least), parting = move, (rule.step, rule.apart, rule.most_apart)
    h, w, _ = labels.shape
    proposal, price = np.zeros((h, w, LABEL), np.float32), np.zeros((h, w), np.float32)
    field, messages = np.zeros((h, w), np.float32), np.zeros((h, w, 4), np.float32)
    edges = np.zeros((h, w, 2, 3), np.float32)
    accepted = 0
    for n in range(len(order)):
        i, j = order[n]
        motion, present = proposed[i, j], labels[i, j]
        if abs(motion[0] - present[0]) + abs(motion[1] - present[1]) < least:
            continue
        box = (max(i - window, 0), min(i + window + 1, h), max(j - window, 0), min(j + window + 1, w))
        _propose(images, nodes, motion, (i, j), rule, box, (proposal, price))
        _edges(labels, proposal, nodes, parting, box, edges)
        _fields(labels, proposal, nodes, (cost, price), parting, box, field)
        _propagate(field, edges, nodes, box, messages)
        if _change(field, edges, messages, nodes, box) < -1e-6:
            accepted += 1
            for a in range(box[0], box[1]):
                for b in range(box[2], box[3]):
                    if nodes[a, b] and _belief(field, messages, a, b) < 0.0:
                        labels[a, b] = proposal[a, b]
                        cost[a, b] = price[a, b]
    return accepted


@njit(cache=True, nogil=True, fastmath=FAST)
def _propose(
    images: Images, nodes: Bool, motion: Float32, at: tuple[int, int], rule: BlockRule, box: Box,
    out: tuple[Float32, Float32],
) -> None:  # fmt: skip
    """out (h, w, 4) and (h, w): the motion of the node `at` carried to each node of the box, and its block cost."""
    (first, second, mask), (proposal, price), (top, bottom, left, right) = images, out, box
    step, radius, block = rule.step, rule.radius, (rule.half, rule.spacing, rule.ceiling)
    for a in range(top, bottom):
        for b in range(left, right):
            if nodes[a, b]:
                label, x, y = proposal[a, b], np.float32(step * (b - at[1])), np.float32(step * (a - at[0]))
                carried(motion, x, y, np.float32(0.0), label)
                if label[0] ** 2 + label[1] ** 2 > radius * radius:
                    price[a, b] = _HUGE
                else:
                    price[a, b] = block_cost(first, second, mask, (step * a, step * b), label, block, 1e9)


@njit(cache=True, nogil=True, fastmath=FAST)
def _edges(labels: Float32, proposal: Float32, nodes: Bool, rule: PartingRule, box: Box, out: Float32) -> None:
    """out (h, w, 2, 3): cost of the edges to the right and down if no node, the other node or this node changes."""
    top, bottom, left, right = box
    for a in range(top, bottom):
        for b in range(left, right):
            for k in range(2):
                m, n = a + k, b + 1 - k
                if m >= bottom or n >= right or not nodes[a, b] or not nodes[m, n]:
                    out[a, b, k, :] = 0.0
                    continue
                out[a, b, k, 0] = parting_of(labels[a, b], labels[m, n], 1 - k, k, rule)
                out[a, b, k, 1] = parting_of(labels[a, b], proposal[m, n], 1 - k, k, rule)
                out[a, b, k, 2] = parting_of(proposal[a, b], labels[m, n], 1 - k, k, rule)


@njit(cache=True, nogil=True, fastmath=FAST)
def _fields(
    labels: Float32, proposal: Float32, nodes: Bool, costs: tuple[Float32, Float32], rule: PartingRule, box: Box,
    out: Float32,
) -> None:  # fmt: skip
    """out (h, w): cost of a node's change, with that of its edges to neighbours outside the window."""
    (h, w, _), (cost, price), (top, bottom, left, right) = labels.shape, costs, box
    for a in range(top, bottom):
        for b in range(left, right):
            if not nodes[a, b]:
                continue
            out[a, b] = price[a, b] - cost[a, b]
            for k in range(4):
                da, db = (k - 1) % 2 * (1 if k == 2 else -1), (k % 2) * (1 if k == 1 else -1)
                m, n = a + da, b + db
                if top <= m < bottom and left <= n < right:
                    continue
                if 0 <= m < h and 0 <= n < w and nodes[m, n]:
                    out[a, b] += parting_of(proposal[a, b], labels[m, n], db, da, rule)
                    out[a, b] -= parting_of(labels[a, b], labels[m, n], db, da, rule)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _belief(field: Float32, messages: Float32, a: int, b: int) -> np.float32:
    return field[a, b] + messages[a, b, 0] + messages[a, b, 1] + messages[a, b, 2] + messages[a, b, 3]


@njit(cache=True, nogil=True, fastmath=FAST)
def _propagate(field: Float32, edges: Float32, nodes: Bool, box: Box, messages: Float32) -> None:
    """Sequential min-sum belief propagation; messages (from left, above, right, below) above 0 favour no change."""
    top, bottom, left, right = box
    messages[top:bottom, left:right] = 0.0
    for sweep in range(_SWEEPS):
        for s in range(bottom - top):
            a = top + s if sweep % 2 == 0 else bottom - 1 - s
            for t in range(right - left):
                b = left + t if sweep % 2 == 0 else right - 1 - t
                if not nodes[a, b]:
                    continue
                total = _belief(field, messages, a, b)
                if sweep % 2 == 0:
                    if b + 1 < right and nodes[a, b + 1]:
                        messages[a, b + 1, 0] = _message(total - messages[a, b, 2], edges[a, b, 0], False)
                    if a + 1 < bottom and nodes[a + 1, b]:
                        messages[a + 1, b, 1] = _message(total - messages[a, b, 3], edges[a, b, 1], False)
                else:
                    if b > left and nodes[a, b - 1]:
                        messages[a, b - 1, 2] = _message(total - messages[a, b, 0], edges[a, b - 1, 0], True)
                    if a > top and nodes[a - 1, b]:
                        messages[a - 1, b, 3] = _message(total - messages[a, b, 1], edges[a - 1, b, 1], True)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _message(h: np.float32, edge: Float32, back: bool) -> np.float32:
    """Message of a node whose change costs h to its neighbour; the edge costs nothing if both change."""
    other, own = (edge[2], edge[1]) if back else (edge[1], edge[2])
    return min(other, h) - min(edge[0], h + own)


@njit(cache=True, nogil=True, fastmath=FAST)
def _change(field: Float32, edges: Float32, messages: Float32, nodes: Bool, box: Box) -> np.float32:
    """Energy after the change minus that before it."""
    top, bottom, left, right = box
    total = np.float32(0.0)
    for a in range(top, bottom):
        for b in range(left, right):
            if not nodes[a, b]:
                continue
            this = _belief(field, messages, a, b) < 0.0
            if this:
                total += field[a, b]
            for k in range(2):
                m, n = a + k, b + 1 - k
                if m >= bottom or n >= right or not nodes[m, n]:
                    continue
                other, edge = _belief(field, messages, m, n) < 0.0, edges[a, b, k]
                if this and other:
                    total -= edge[0]
                elif other:
                    total += edge[1] - edge[0]
                elif this:
                    total += edge[2] - edge[0]
    return total
