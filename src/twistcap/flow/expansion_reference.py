"""Readable twin of `expansion.expand`: nodes as keys, costs of pairs as 2 × 2 tables."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.flow.matching import BlockRule, Images
from twistcap.flow.matching_reference import block_cost_reference, carried_reference, parting_of_reference

Node = tuple[int, int]
_SWEEPS = 4


def expand_reference(
    images: Images, nodes: Bool, labels: Float32, cost: Float32, proposed: Float32, order: Int, rule: BlockRule,
    move: tuple[int, float],
) -> int:  # fmt: skip
    """Readable twin of `expand`."""
    block, (window, least), accepted = (rule.half, rule.spacing, rule.ceiling), move, 0
    every = [(int(a), int(b)) for a, b in np.argwhere(nodes)]
    for i, j in order.tolist():
        if np.abs(proposed[i, j, :2] - labels[i, j, :2]).sum() < least:
            continue
        box = [(a, b) for a, b in every if abs(a - i) <= window and abs(b - j) <= window]
        proposal, price = labels.copy(), dict[Node, float]()
        for a, b in box:
            carried_reference(proposed[i, j], rule.step * (b - j), rule.step * (a - i), 0.0, proposal[a, b])
            price[a, b] = 1e3
            if np.hypot(*proposal[a, b, :2]) <= rule.radius:
                at = (rule.step * a, rule.step * b)
                price[a, b] = block_cost_reference(*images, at, proposal[a, b], block, np.inf)
        own = {p: price[p] - float(cost[p]) for p in box}
        pairs = _pairs(box, every, labels, proposal, own, rule)
        changed = _changed(own, pairs)
        energy = sum(own[p] for p in changed)
        energy += sum(V[int(p in changed), int(q in changed)] - V[0, 0] for (p, q), V in pairs.items())
        if energy < -1e-6:
            accepted += 1
            for p in changed:
                labels[p], cost[p] = proposal[p], price[p]
    return accepted


def _pairs(
    box: list[Node], every: list[Node], labels: Float32, proposal: Float32, own: dict[Node, float], rule: BlockRule
) -> dict[tuple[Node, Node], Float]:
    """Cost of each pair of neighbours in the box if none, one or both change; edges out of it are added to `own`."""
    parting, pairs = (rule.step, rule.apart, rule.most_apart), dict[tuple[Node, Node], Float]()
    for p in box:
        for di, dj in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            q = (p[0] + di, p[1] + dj)
            if q in own and (di > 0 or dj > 0):
                pairs[p, q] = np.array(
                    [[parting_of_reference(x[p], y[q], dj, di, parting) for y in (labels, proposal)]
                     for x in (labels, proposal)]
                )  # fmt: skip
                pairs[p, q][1, 1] = 0.0  # one rigid motion
            elif q in every and q not in own:
                own[p] += parting_of_reference(proposal[p], labels[q], dj, di, parting)
                own[p] -= parting_of_reference(labels[p], labels[q], dj, di, parting)
    return pairs


def _changed(own: dict[Node, float], pairs: dict[tuple[Node, Node], Float]) -> set[Node]:
    """The nodes that accept, by sequential min-sum belief propagation, forward and backward in turn."""
    messages = {(p, q): 0.0 for pair in pairs for p, q in (pair, pair[::-1])}

    def belief(p: Node) -> float:
        return own[p] + sum(message for (_, q), message in messages.items() if q == p)

    for sweep in range(_SWEEPS):
        for p in sorted(own, reverse=sweep % 2 == 1):
            total = belief(p)
            for q in own:
                V = pairs.get((p, q)) if sweep % 2 == 0 else pairs.get((q, p), np.zeros((0, 0))).T
                if V is not None and V.size:
                    h = np.array([0.0, total - messages[q, p]])
                    messages[p, q] = float((h + V[:, 1]).min() - (h + V[:, 0]).min())
    return {p for p in own if belief(p) < 0.0}
