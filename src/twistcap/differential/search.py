"""A coarse search for limbs that move farther between frames than gradients reach.

Bregler and Malik (CVPR 1998) propose such a first stage for motions too fast for a differential method. Pairs of joint
angles are tried on a grid about the present guess, limb by limb, and the best is where the descent goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from twistcap.arrays import Bool
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


def searched(body: Body, state: State, misfit: Callable[[State, Bool], float], reach: float, spread: float) -> State:
    """The state with each limb at the best of the angles tried, by the mean `misfit` on the pixels of segments (S,).

    Lower joints are tried up to one and a half of the reach (rad), upper ones up to it. A candidate pays half the
    square of its distance in `spread` (rad), in hundredths of the cost's own unit.
    """
    for limb in limbs_of(body):
        trials = np.tile(state.q, (len(_UPPER) * len(_LOWER), 1))
        trials[:, limb] += reach * np.array(list(product(_UPPER, _LOWER)))
        trials = np.clip(trials, *body.limits.T)
        pays = 0.005 * np.sum(((trials - state.q) / spread) ** 2, axis=1)
        costs = [misfit(State(state.views, q), body.chain[:, limb[0]]) for q in trials]
        state = State(state.views, trials[int(np.argmin(costs + pays))])
    return state
