"""Draws of a limb's pose: anywhere within its joints' limits, and about the best so far."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose

_ROOT = 6  # coordinates of the root, which come first


def anywhere(rng: np.random.Generator, limb: Bool, pose: Pose, body: Body, count: int) -> Float:
    """(count, 6 + J) steps to places anywhere within the limits of a limb's joints, half a turn where none are."""
    joints = np.flatnonzero(limb) - _ROOT
    limits, here = body.limits[joints], pose.q[joints, None]
    low, high = np.where(np.isfinite(limits), limits, here + np.array([-np.pi, np.pi])).T
    return _outward(limb, rng.uniform(low, high, (count, len(joints))) - pose.q[joints])


def about(rng: np.random.Generator, limb: Bool, sd: float, count: int) -> Float:
    """(count, 6 + J) steps of a limb's joints with a standard deviation (rad)."""
    return _outward(limb, sd * rng.standard_normal((count, int(limb.sum()))))


def _outward(limb: Bool, drawn: Float) -> Float:
    """(N, 6 + J) steps from those (N, K) of a limb's coordinates: of the whole limb, and of its outer ends alone.

    A forearm that folded over while the upper arm was right would seldom be found by turning both.
    """
    K = drawn.shape[1]
    steps = np.zeros((len(drawn), len(limb)))
    steps[:, limb] = np.where(np.arange(K) < (np.arange(len(drawn)) % K)[:, None], 0.0, drawn)
    return steps
