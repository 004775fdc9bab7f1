"""Limbs and branches of a body, by the coordinates that move its ends. The one definition of a limb."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool
from twistcap.body.model import Body


def branches(body: Body) -> list[Bool]:
    """Masks (6 + J,) of coordinates that move the same ends of the body: the root's, then those of most ends first."""
    root = np.arange(body.dof) < 6
    return [root, *(mask for _, mask in _by_ends(body))]


def limbs(body: Body) -> list[Bool]:
    """Masks (6 + J,) of the coordinates of each limb: those that move the same single end of the body. With a hand of
    jointed fingers the fingers are limbs, and the arm is none."""
    return [mask for ends, mask in _by_ends(body) if ends == 1]


def limb_parts(body: Body, limb: Bool) -> Bool:
    """(S,) the segments that a limb's coordinates (6 + J,) move."""
    return np.asarray(body.chain[:, limb[6:]].any(axis=1), np.bool_)


def same_limb(body: Body, one: int, other: int) -> bool:
    """Whether all coordinates that move one of the segments also move the other."""
    a, b = body.chain[one], body.chain[other]
    return bool(np.all(a <= b) or np.all(b <= a))


def segments_above(body: Body) -> Bool:
    """(S, S) whether a segment (column) is the other (row) itself or between it and the root."""
    chain = body.chain
    return np.asarray(np.all(chain <= chain[:, None], axis=2) & np.any(chain, axis=1), np.bool_)


def _by_ends(body: Body) -> list[tuple[int, Bool]]:
    """Number of ends of the body and mask (6 + J,) of each branch; those of most ends first."""
    carries = body.chain
    below = np.all(carries[:, None] >= carries, axis=2)  # all coordinates that move the column's segment move the row's
    ends = ~np.any(below & ~below.T, axis=0)
    groups: dict[bytes, list[int]] = {}
    for j, carried in enumerate(carries[ends].T):
        groups.setdefault(carried.tobytes(), []).append(j)
    return [(sum(key), np.isin(np.arange(body.dof) - 6, groups[key])) for key in sorted(groups, key=lambda k: -sum(k))]
