"""A coarse search for limbs that move farther between frames than gradients reach.

Bregler and Malik (CVPR 1998) propose such a first stage for motions too fast for a differential method. Pairs of joint
angles are tried on a grid about the present guess, limb by limb, and the best is where the descent goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body
from twistcap.differential.state import State

LIMBS = (("hip_flexion", "knee_angle"), ("arm_flex", "elbow_flex"))
"""Upper and lower coordinate of each limb, sides left out."""

_UPPER, _LOWER = (-1.0, -0.5, 0.0, 0.5, 1.0), (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)


def limbs_of(body: Body) -> list[tuple[int, int]]:
    """Upper and lower coordinate of every limb that the body has."""
    names = body.coordinate_names
    pairs = [(f"{upper}_{side}", f"{lower}_{side}") for upper, lower in LIMBS for side in "rl"]
    return [(names.index(u), names.index(w)) for u, w in pairs if u in names and w in names]


def moved_by(body: Body, coordinate: int) -> Bool:
    """(S,) which segments a coordinate moves."""
    return body.chain[:, coordinate]


def searched(body: Body, state: State, misfit: Callable[[State, Bool], float], reach: float, spread: float) -> State:
    """The state with each limb at the best of the angles tried.

    Args:
        body: whose limbs are tried.
        state: the guess.
        misfit: mean cost of a state on the pixels of some segments (S,).
        reach: rad; lower joints are tried up to one and a half of it, upper ones up to it.
        spread: rad, how far angles stray from the guess: a candidate pays half the square of its distance in these,
            in hundredths of the cost's own unit.
    """
    for upper, lower in limbs_of(body):
        segments = moved_by(body, upper)
        trials = [_turned(body, state, (upper, lower), (a * reach, b * reach)) for a, b in product(_UPPER, _LOWER)]
        pays = [0.005 * float(np.sum(((t.q - state.q) / spread) ** 2)) for t in trials]
        costs = [misfit(trial, segments) + pay for trial, pay in zip(trials, pays, strict=True)]
        state = trials[int(np.argmin(costs))]
    return state


def _turned(body: Body, state: State, which: Sequence[int], by: Sequence[float]) -> State:
    q: Float = state.q.copy()
    q[list(which)] += by
    return State(state.views, np.clip(q, *body.limits.T))
