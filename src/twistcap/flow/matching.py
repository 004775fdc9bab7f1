"""Large displacements: blocks that move and turn rigidly, matched by propagation and random search.

Coarse-to-fine warping loses a limb that moves farther than it is wide (Brox and Malik 2011, "Large displacement
optical flow", DOI 10.1109/TPAMI.2010.143). Here each node of a grid has a rigid motion of its block, of which only the
masked pixels count: the background behind a limb does not. Good motions spread to neighbours (Barnes, Shechtman,
Finkelstein and Goldman 2009, "PatchMatch", DOI 10.1145/1531326.1531330), carried by the neighbour's turn or bent at a
hinge between the two. Neighbours that move apart cost energy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float32
from twistcap.flow.solver import FAST

LABEL = 4  # of a node: u, v (px), cos θ - 1, sin θ
_FORGIVEN = 0.9  # fraction of a block's squared mean difference that is put down to a change of light
NEIGHBOURS = ((-1, 0), (0, -1), (1, 0), (0, 1))

Images = tuple[Float32, Float32, Bool]
"""Two images (H, W, C) and the mask (H, W) of the pixels that are compared."""
PartingRule = tuple[int, float, float]
"""Px from node to node, cost of each px by which two neighbours disagree, px beyond which it no longer grows."""


class BlockRule(NamedTuple):
    """See `SearchSettings`; `turn` in rad."""

    step: int
    half: int
    spacing: int
    radius: float
    turn: float
    ceiling: float
    apart: float
    most_apart: float
    draws: int


@njit(cache=True, nogil=True, fastmath=FAST)
def match_blocks(
    images: Images, nodes: Bool, start: Float32, table: Float32, rule: BlockRule, rounds: int
) -> tuple[Float32, Float32]:
    """Rigid motion (h, w, 4) of the block at each node (step i, step j): u, v (px), cos θ - 1, sin θ; and its cost.

    Nodes (h, w) are matched in some passes (`rounds`), the others keep their `start` (h, w, 4). The `table` (N, 3) is
    of random numbers: places in the unit disc, turns in [-1, 1].
    """
    (first, second, mask), step, radius, turn = images, rule.step, rule.radius, rule.turn
    parting_rule, block = (step, rule.apart, rule.most_apart), (rule.half, rule.spacing, rule.ceiling)
    h, w, _ = start.shape
    labels, cost = start.copy(), np.zeros((h, w), dtype=np.float32)
    candidate, count = np.empty(LABEL, dtype=np.float32), 0
    for i in range(h):
        for j in range(w):
            if nodes[i, j]:
                cost[i, j] = block_cost(first, second, mask, (step * i, step * j), labels[i, j], block, 1e9)
    for turn_of in range(rounds):
        ahead = turn_of % 2 == 0
        for a in range(h):
            i = a if ahead else h - 1 - a
            for b in range(w):
                j = b if ahead else w - 1 - b
                if not nodes[i, j]:
                    continue
                mine = labels[i, j]
                data = cost[i, j]
                total = data + _parting(labels, nodes, i, j, mine, parting_rule)
                for k in range(8 + rule.draws):
                    draw = table[count % len(table)]
                    count += 1
                    if k < 8:
                        di, dj = NEIGHBOURS[k % 4]
                        m, n = i + di, j + dj
                        if not is_node(nodes, m, n):
                            continue
                        bend = np.float32(turn) * draw[2] if k >= 4 else np.float32(0.0)
                        carried(labels[m, n], np.float32(-dj * step), np.float32(-di * step), bend, candidate)
                    else:
                        _disturbed(mine, draw, radius * 0.5 ** (k - 8), turn * 0.5 ** (k - 8), candidate)
                    if candidate[0] ** 2 + candidate[1] ** 2 > radius * radius:
                        continue
                    parting = _parting(labels, nodes, i, j, candidate, parting_rule)
                    if parting >= total:
                        continue
                    left = float(total - parting)
                    here = block_cost(first, second, mask, (step * i, step * j), candidate, block, left)
                    if here + parting < total:
                        data, total = here, here + parting
                        for c in range(LABEL):
                            mine[c] = candidate[c]
                cost[i, j] = data
    return labels, cost


@njit(cache=True, nogil=True, fastmath=FAST)
def block_cost(
    first: Float32, second: Float32, mask: Bool, at: tuple[int, int], label: Float32, block: tuple[int, int, float],
    limit: float,
) -> np.float32:  # fmt: skip
    """Root mean square difference over a block without most of its mean, since light changes as limbs turn.

    Of images (H, W, C), a mask (H, W), the row and column of its middle and its motion (4,). Pixels off the mask count
    as equal, pixels outside the image as different by the ceiling. `block` holds samples each way from the middle,
    their spacing (px) and that ceiling; beyond the cost `limit` the sum is broken off.
    """
    (r, c), (half, spacing, ceiling) = at, block
    H, W, C = first.shape
    top, size = np.float32(ceiling), np.float32((2 * half + 1) ** 2 * C)
    most = np.float32(limit) ** 2 * size
    squares, total, n, lost = np.float32(0.0), np.float32(0.0), np.float32(1e-6), np.float32(0.0)
    for dy in range(-half * spacing, half * spacing + 1, spacing):
        if not 0 <= r + dy < H:
            continue
        for dx in range(-half * spacing, half * spacing + 1, spacing):
            if not 0 <= c + dx < W or not mask[r + dy, c + dx]:
                continue
            x = np.float32(c + dx) + label[0] + label[2] * dx - label[3] * dy + np.float32(0.5)
            y = np.float32(r + dy) + label[1] + label[3] * dx + label[2] * dy + np.float32(0.5)
            if x < 0.0 or y < 0.0 or x >= W or y >= H:
                lost += top * top * C
                continue
            for k in range(C):
                d = second[int(y), int(x), k] - first[r + dy, c + dx, k]
                d = min(max(d, -top), top)
                squares += d * d
                total += d
                n += np.float32(1.0)
        if lost + squares - np.float32(_FORGIVEN) * total * total / n > most:
            break
    return np.sqrt(max(lost + squares - np.float32(_FORGIVEN) * total * total / n, np.float32(0.0)) / size)


@njit(cache=True, nogil=True, fastmath=FAST)
def _parting(labels: Float32, nodes: Bool, i: int, j: int, mine: Float32, rule: PartingRule) -> np.float32:
    """Cost by which four neighbours and a label at node (i, j) disagree; see `parting_of`."""
    total = np.float32(0.0)
    for k in range(4):
        di, dj = NEIGHBOURS[k]
        if is_node(nodes, i + di, j + dj):
            total += parting_of(mine, labels[i + di, j + dj], dj, di, rule)
    return total


@njit(cache=True, nogil=True, inline="always")
def is_node(nodes: Bool, i: int, j: int) -> bool:
    """Whether a place is within the grid (h, w) and a node."""
    return 0 <= i < nodes.shape[0] and 0 <= j < nodes.shape[1] and nodes[i, j]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def parting_of(mine: Float32, other: Float32, dj: int, di: int, rule: PartingRule) -> np.float32:
    """Cost by which two neighbours (dj, di) nodes apart disagree about the place of the middle between them."""
    step, apart, most_apart = rule
    x, y = np.float32(-0.5 * step * dj), np.float32(-0.5 * step * di)
    cosine, sine = mine[2] + other[2], mine[3] + other[3]
    du = mine[0] - other[0] - cosine * x + sine * y
    dv = mine[1] - other[1] - sine * x - cosine * y
    return np.float32(apart) * min(np.sqrt(du * du + dv * dv), np.float32(most_apart))


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _turned(label: Float32, angle: np.float32, out: Float32) -> None:
    """out = label, turned further by an angle."""
    square = angle * angle
    c = square * (square * np.float32(1.0 / 24.0) - np.float32(0.5))  # cos - 1 and sin to 1e-3 up to 60°
    s = angle * (np.float32(1.0) - square * (np.float32(1.0 / 6.0) - square * np.float32(1.0 / 120.0)))
    out[0], out[1] = label[0], label[1]
    out[2] = c + label[2] + c * label[2] - s * label[3]
    out[3] = s + label[3] + s * label[2] + c * label[3]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _disturbed(label: Float32, draw: Float32, radius: float, turn: float, out: Float32) -> None:
    """out = label, moved within a radius and turned within an angle as the random numbers (3,) say."""
    _turned(label, np.float32(turn) * draw[2], out)
    out[0] += np.float32(radius) * draw[0]
    out[1] += np.float32(radius) * draw[1]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def carried(label: Float32, x: np.float32, y: np.float32, bend: np.float32, out: Float32) -> None:
    """out = a neighbour's label at (x, y) px from it, bent by an angle (rad) at the middle between the two."""
    _turned(label, bend, out)
    cosine, sine = np.float32(0.5) * (label[2] + out[2]), np.float32(0.5) * (label[3] + out[3])
    out[0] = label[0] + cosine * x - sine * y
    out[1] = label[1] + sine * x + cosine * y


def spread(labels: Float32, step: int, height: int, width: int) -> Float32:
    """(height, width, 2) px: at each pixel the flow by the rigid motion of the nearest node."""
    h, w, _ = labels.shape
    i, j = (np.minimum((np.arange(n) + step // 2) // step, m - 1) for n, m in ((height, h), (width, w)))
    x = (np.arange(width) - step * j).astype(np.float32)
    y = (np.arange(height) - step * i).astype(np.float32)[:, None]
    u, v, cosine, sine = np.moveaxis(labels[i[:, None], j], 2, 0)
    return np.stack([u + cosine * x - sine * y, v + sine * x + cosine * y], axis=-1)
