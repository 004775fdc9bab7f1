"""Readable twins of the kernels of `matching`: motions as complex numbers, a shift and a turn less one."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool, Float, Float32
from twistcap.flow.matching import NEIGHBOURS, BlockRule, Images, PartingRule

_FORGIVEN = 0.9


def _motion(label: Float32) -> tuple[complex, complex]:
    return complex(label[0], label[1]), complex(label[2], label[3])


def _label(shift: complex, turn: complex) -> Float32:
    return np.array([shift.real, shift.imag, turn.real, turn.imag], np.float32)


def block_cost_reference(
    first: Float32, second: Float32, mask: Bool, at: tuple[int, int], label: Float32, block: tuple[int, int, float],
    limit: float,
) -> float:  # fmt: skip
    """Readable twin of `block_cost`, without the limit."""
    (H, W, C), (half, spacing, ceiling), (shift, turn) = first.shape, block, _motion(label)
    squares, differences = 0.0, list[Float]()
    for dy, dx in spacing * (np.argwhere(np.ones((2 * half + 1, 2 * half + 1))) - half):
        r, c = at[0] + dy, at[1] + dx
        if 0 <= r < H and 0 <= c < W and mask[r, c]:
            there = complex(c + 0.5, r + 0.5) + shift + turn * complex(dx, dy)
            if 0.0 <= there.real < W and 0.0 <= there.imag < H:
                d = second[int(there.imag), int(there.real)].astype(float) - first[r, c]
                differences.append(np.clip(d, -ceiling, ceiling))
            else:
                squares += ceiling**2 * C
    d = np.array(differences)
    squares += float(np.sum(d**2)) - _FORGIVEN * float(d.sum()) ** 2 / max(d.size, 1e-6)
    return float(np.sqrt(max(squares, 0.0) / ((2 * half + 1) ** 2 * C)))


def parting_of_reference(mine: Float32, other: Float32, dj: int, di: int, rule: PartingRule) -> float:
    """Readable twin of `parting_of`."""
    step, apart, most_apart = rule
    (shift, turn), (their_shift, their_turn) = _motion(mine), _motion(other)
    return apart * min(abs(shift - their_shift + (turn + their_turn) * step * complex(dj, di) / 2), most_apart)


def carried_reference(label: Float32, x: float, y: float, bend: float, out: Float32) -> None:
    """Readable twin of `carried`."""
    shift, turn = _motion(label)
    bent = (1.0 + turn) * np.exp(1j * bend) - 1.0
    out[:] = _label(shift + (turn + bent) / 2 * complex(x, y), bent)


def is_node_reference(nodes: Bool, i: int, j: int) -> bool:
    """Readable twin of `is_node`."""
    return [i, j] in np.argwhere(nodes).tolist()


def match_blocks_reference(
    images: Images, nodes: Bool, start: Float32, table: Float32, rule: BlockRule, rounds: int
) -> tuple[Float32, Float]:
    """Readable twin of `match_blocks`: node by node, candidate by candidate."""
    block, labels, drawn = (rule.half, rule.spacing, rule.ceiling), start.copy(), 0
    places = [(int(i), int(j)) for i, j in np.argwhere(nodes)]

    def own_cost(p: tuple[int, int], label: Float32) -> float:
        return block_cost_reference(*images, (rule.step * p[0], rule.step * p[1]), label, block, np.inf)

    def parting(p: tuple[int, int], label: Float32) -> float:
        near = [(p[0] + di, p[1] + dj, di, dj) for di, dj in NEIGHBOURS if (p[0] + di, p[1] + dj) in places]
        return sum(parting_of_reference(label, labels[m, n], dj, di, rule[:1] + rule[6:8]) for m, n, di, dj in near)

    cost = np.zeros(nodes.shape)
    for p in places:
        cost[p] = own_cost(p, labels[p])
    for turn_of in range(rounds):
        for p in places[:: 1 if turn_of % 2 == 0 else -1]:
            for k in range(8 + rule.draws):
                draw, drawn = table[drawn % len(table)], drawn + 1
                candidate = _candidate(p, k, draw, labels, places, rule)
                if candidate is not None and np.hypot(*candidate[:2]) <= rule.radius:
                    data = own_cost(p, candidate)
                    if data + parting(p, candidate) < cost[p] + parting(p, labels[p]):
                        labels[p], cost[p] = candidate, data
    return labels, cost


def _candidate(
    p: tuple[int, int], k: int, draw: Float32, labels: Float32, places: list[tuple[int, int]], rule: BlockRule
) -> Float32 | None:
    """For k < 8 a neighbour's motion, carried here, bent from 4 on; then the node's own, disturbed less and less."""
    if k >= 8:
        shift, turn = _motion(labels[p])
        bent = (1.0 + turn) * np.exp(1j * rule.turn * 0.5 ** (k - 8) * draw[2]) - 1.0
        return _label(shift + rule.radius * 0.5 ** (k - 8) * complex(draw[0], draw[1]), bent)
    di, dj = NEIGHBOURS[k % 4]
    if (p[0] + di, p[1] + dj) not in places:
        return None
    out = np.empty(4, np.float32)
    bend = float(rule.turn * draw[2]) if k >= 4 else 0.0
    carried_reference(labels[p[0] + di, p[1] + dj], -dj * rule.step, -di * rule.step, bend, out)
    return out
