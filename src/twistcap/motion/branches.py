"""The choice between the two sets of angles of joints with three axes.

A rotation by (a, b, c) about three orthogonal axes is also one by (a + π, π − b, c + π). Followed over time, a shoulder
that swings around a pole of its middle axis (b = ±π/2: arms straight forward) changes from one set to the other, and
stays beyond its limits. There the angles cross to the other set on a short bridge near the pole, where this turns the
limb least.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap.arrays import Bool, Float, Int
from twistcap.body import Body

_BRIDGE = 0.1  # s that a crossing takes
_CROSSING = 1.0  # rad²: a crossing at the pole costs as much as a frame 1 rad beyond the limits


def square_joints(body: Body) -> list[list[int]]:
    """Coordinates (three each, outermost first) of the joints with three orthogonal axes."""
    ends, out = {int(k) for k in body.segment_joint}, list[list[int]]()
    for k in ends - {-1}:
        chain = [k]
        while (above := int(body.parent[chain[0]])) >= 0 and above not in ends:
            chain.insert(0, above)
        axes = body.twists[chain, :3]
        if len(chain) == 3 and np.allclose(axes @ axes.T, np.eye(3), atol=1e-6):
            out.append(chain)
    return sorted(out)


def within_limits(body: Body, q: Float, rate: float) -> tuple[Float, Bool]:
    """The same poses q (N, J) rad, joints of three axes within their limits where their other set of angles is.

    They are continuous in time, `rate` per second. With them (N,) whether a frame is on a bridge and has changed.
    """
    q, bridged = q.copy(), np.zeros(len(q), dtype=bool)
    for joint in square_joints(body):
        angles, limits = q[:, joint], body.limits[joint]
        both = np.stack([angles, angles * [1.0, -1.0, 1.0] + np.pi])
        sets = both - 2 * np.pi * np.round((both - limits.mean(axis=1)) / (2 * np.pi))  # towards the limits' middle
        taken = _cheapest(sets, limits)
        q[:, joint] = sets[taken, np.arange(len(q))]
        for n in np.flatnonzero(np.diff(taken)):
            bridged |= _bridge(q, joint, int(n), max(1, round(0.5 * _BRIDGE * rate)))
    return q, bridged


def _cheapest(sets: Float, limits: Float) -> Int:
    """(N,) which of the sets (2, N, 3) is taken: least violation of limits and crossings, by dynamic programming."""
    beyond = np.sum((sets - np.clip(sets, limits[:, 0], limits[:, 1])) ** 2, axis=2)
    crossing = _CROSSING * (1.0 + (2.0 * np.minimum(*np.abs(np.cos(sets[..., 1])))) ** 2)
    cost, came = beyond[:, 0].copy(), np.zeros((2, sets.shape[1]), dtype=np.int32)
    for n in range(1, sets.shape[1]):
        other = cost[::-1] + crossing[n]
        came[:, n] = np.where(other < cost, [1, 0], [0, 1])
        cost = np.minimum(cost, other) + beyond[:, n]
    taken = np.zeros(sets.shape[1], dtype=np.int32)
    taken[-1] = np.argmin(cost)
    for n in range(len(taken) - 1, 0, -1):
        taken[n - 1] = came[taken[n], n]
    return taken


def _bridge(q: Float, joint: Sequence[int], n: int, half: int) -> Bool:
    """Smooth the step after frame n over `half` frames to both sides, in place; (N,) which frames it changed."""
    first, last = max(n - half + 1, 0), min(n + half, len(q) - 1)
    fraction = np.linspace(0.0, 1.0, last - first + 1)[:, None]
    fraction = fraction * fraction * (3.0 - 2.0 * fraction)
    a, b = q[first, joint], q[last, joint]
    q[first : last + 1, joint] = a + fraction * (b - a)
    changed = np.zeros(len(q), dtype=bool)
    changed[first : last + 1] = True
    return changed
