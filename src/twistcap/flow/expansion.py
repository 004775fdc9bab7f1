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
from twistcap.flow.matching import (
    FAST,
    LABEL,
    NEIGHBOURS,
    BlockRule,
    Images,
    PartingRule,
    block_cost,
    carried,
    is_node,
    parting_of,
)

_SWEEPS = 4
_HUGE = np.float32(1e3)

Window = tuple[Bool, Int]
"""Nodes of a window, as a mask (h, w) and as places (N, 2) row by row."""


@njit(cache=True, nogil=True, fastmath=FAST)
def expand(
    images: Images, nodes: Bool, labels: Float32, cost: Float32, proposed: Float32, order: Int, rule: BlockRule,
    move: tuple[int, float],
) -> int:  # fmt: skip
    """Propose the motions `proposed` (h, w, 4) of the nodes in `order` (N, 2), one after the other.

    Present motions (`labels`, h, w, 4) and their block costs (h, w) change in place. `move` holds the nodes each way to
    which a motion is proposed, and the least difference (px) from the node's present one. The rest is as for
    `match_blocks`. Returns the number of motions that some nodes accepted.
    """
    (reach, least), parting = move, (rule.step, rule.apart, rule.most_apart)
    h, w, _ = labels.shape
    proposal, price = np.zeros((h, w, LABEL), np.float32), np.zeros((h, w), np.float32)
    field, messages = np.zeros((h, w), np.float32), np.zeros((h, w, 4), np.float32)
    edges = np.zeros((h, w, 2, 4), np.float32)
    accepted = 0
    for n in range(len(order)):
        i, j = order[n]
        motion, present = proposed[i, j], labels[i, j]
        if abs(motion[0] - present[0]) + abs(motion[1] - present[1]) < least:
            continue
        window = _window(nodes, i, j, reach)
        _propose(images, motion, (i, j), rule, window, (proposal, price))
        _edges(labels, proposal, parting, window, edges)
        _fields(labels, proposal, nodes, (cost, price), parting, window, field)
        _propagate(field, edges, window, messages)
        if _change(field, edges, messages, window) < -1e-6:
            accepted += 1
            for a, b in window[1]:
                if _belief(field, messages, a, b) < 0.0:
                    cost[a, b] = price[a, b]
                    for c in range(LABEL):
                        labels[a, b, c] = proposal[a, b, c]
    return accepted


@njit(cache=True, nogil=True)
def _window(nodes: Bool, i: int, j: int, reach: int) -> Window:
    """The nodes at most `reach` rows and columns from (i, j)."""
    h, w = nodes.shape
    inside, places, count = np.zeros((h, w), np.bool_), np.empty((h * w, 2), np.int32), 0
    for a in range(max(i - reach, 0), min(i + reach + 1, h)):
        for b in range(max(j - reach, 0), min(j + reach + 1, w)):
            if nodes[a, b]:
                inside[a, b], places[count, 0], places[count, 1] = True, a, b
                count += 1
    return inside, places[:count]


@njit(cache=True, nogil=True, fastmath=FAST)
def _propose(
    images: Images, motion: Float32, at: tuple[int, int], rule: BlockRule, window: Window, out: tuple[Float32, Float32]
) -> None:
    """out (h, w, 4) and (h, w): the motion of the node `at` carried to each node of the window, and its block cost."""
    (first, second, mask), (proposal, price) = images, out
    step, radius, block = rule.step, rule.radius, (rule.half, rule.spacing, rule.ceiling)
    for a, b in window[1]:
        label, x, y = proposal[a, b], np.float32(step * (b - at[1])), np.float32(step * (a - at[0]))
        carried(motion, x, y, np.float32(0.0), label)
        if label[0] ** 2 + label[1] ** 2 > radius * radius:
            price[a, b] = _HUGE
        else:
            price[a, b] = block_cost(first, second, mask, (step * a, step * b), label, block, 1e9)


@njit(cache=True, nogil=True, fastmath=FAST)
def _edges(labels: Float32, proposal: Float32, rule: PartingRule, window: Window, out: Float32) -> None:
    """out (h, w, 2, 4): cost of edges right and down if no node, the other, this or both change (one rigid motion)."""
    for a, b in window[1]:
        for k in range(2):
            m, n, edge = a + k, b + 1 - k, out[a, b, k]
            edge[:] = 0.0
            if is_node(window[0], m, n):
                edge[0] = parting_of(labels[a, b], labels[m, n], 1 - k, k, rule)
                edge[1] = parting_of(labels[a, b], proposal[m, n], 1 - k, k, rule)
                edge[2] = parting_of(proposal[a, b], labels[m, n], 1 - k, k, rule)


@njit(cache=True, nogil=True, fastmath=FAST)
def _fields(
    labels: Float32, proposal: Float32, nodes: Bool, costs: tuple[Float32, Float32], rule: PartingRule, window: Window,
    out: Float32,
) -> None:  # fmt: skip
    """out (h, w): cost of a node's change, with that of its edges to neighbours outside the window."""
    cost, price = costs
    for a, b in window[1]:
        out[a, b] = price[a, b] - cost[a, b]
        for k in range(4):
            da, db = NEIGHBOURS[k]
            m, n = a + da, b + db
            if is_node(nodes, m, n) and not window[0][m, n]:
                out[a, b] += parting_of(proposal[a, b], labels[m, n], db, da, rule)
                out[a, b] -= parting_of(labels[a, b], labels[m, n], db, da, rule)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _belief(field: Float32, messages: Float32, a: int, b: int) -> np.float32:
    return field[a, b] + messages[a, b, 0] + messages[a, b, 1] + messages[a, b, 2] + messages[a, b, 3]


@njit(cache=True, nogil=True, fastmath=FAST)
def _propagate(field: Float32, edges: Float32, window: Window, messages: Float32) -> None:
    """Sequential min-sum belief propagation; messages (from left, above, right, below) above 0 favour no change. The
    message of a node whose change costs h goes right and down in one sweep, left and up in the next."""
    messages[:] = 0.0
    for sweep in range(_SWEEPS):
        ahead = sweep % 2 == 0
        for a, b in window[1] if ahead else window[1][::-1]:
            total = _belief(field, messages, a, b)
            for k in range(2):
                m, n = (a + k, b + 1 - k) if ahead else (a - k, b - 1 + k)
                if is_node(window[0], m, n):
                    edge = edges[a, b, k] if ahead else edges[m, n, k]
                    other, own = (edge[1], edge[2]) if ahead else (edge[2], edge[1])
                    h = total - messages[a, b, k + 2 if ahead else k]
                    messages[m, n, k if ahead else k + 2] = min(other, h) - min(edge[0], h + own)


@njit(cache=True, nogil=True, fastmath=FAST)
def _change(field: Float32, edges: Float32, messages: Float32, window: Window) -> np.float32:
    """Energy after the change minus that before it."""
    total = np.float32(0.0)
    for a, b in window[1]:
        this = _belief(field, messages, a, b) < 0.0
        if this:
            total += field[a, b]
        for k in range(2):
            m, n, edge = a + k, b + 1 - k, edges[a, b, k]
            if is_node(window[0], m, n):
                other = _belief(field, messages, m, n) < 0.0
                total += np.float32(edge[2 * int(this) + int(other)] - edge[0])
    return np.float32(total)
