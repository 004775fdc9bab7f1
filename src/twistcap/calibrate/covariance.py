"""Covariance of cameras, with what the points of one sighting err together.

Blur, light and a bent edge move all points of a picture alike, so that points are fewer than they seem. Each sighting's
pull on the cameras, the poses of the board eliminated, is compared with what independent points would pull: the mean of
their squares is the factor by which the covariance is too small (White 1982, DOI 10.2307/1912526, with the sightings as
clusters, and one factor for all directions, since sightings are few).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twistcap.arrays import Float
from twistcap.errors import InputError
from twistcap.solve import Arrow, BlockProblem, Variables
from twistcap.terms.protocols import BlockTerm, Place, Slope

_TOO_FEW = (
    "calibrate: too few pictures of the board fit together to determine the cameras; it was seen too little, or the"
    " cameras' clocks differ. Film it again, and turn it briskly where two cameras see it."
)
_MOST = 100.0  # a factor beyond it says that the fit is wrong, not that points are few


def marginals(problem: BlockProblem, x: Variables, sightings: Sequence[BlockTerm]) -> Float:
    """(K, K) covariance of all free numbers but the boards' poses; `sightings` are the terms of one picture each.

    Raises InputError where the sightings do not determine the cameras.
    """
    system = problem.linearised(x)
    try:
        shared = system.marginals().shared if isinstance(system, Arrow) else problem.covariance(x)
    except InputError as error:
        raise InputError(_TOO_FEW) from error
    pulls = np.array([_pull(term, x, system) for term in sightings])
    return shared * float(np.clip(np.sum((pulls @ shared) * pulls) / len(shared), 1.0, _MOST))


@dataclass
class _Pull:
    """The gradient of one term."""

    x: Variables
    gradient: Float
    touched: set[int] = field(default_factory=set[int])

    def add_rows(self, energy: float, slopes: list[Slope], weight: Float, residual: Float) -> None:
        """Add the gradient of its rows."""
        del energy
        for slope in slopes:
            if slope.block in self.x.slices:
                start = self.x.slices[slope.block].start + slope.first
                self.gradient[start : start + slope.by.shape[1]] += slope.by.T @ (weight * residual)
                if slope.block == "boards":
                    self.touched.add(slope.first // 6)

    def add_quadratic(self, places: list[Place], value: float, gradient: Float, hessian: Float) -> None:
        """A sighting adds rows only."""
        raise NotImplementedError


def _pull(term: BlockTerm, x: Variables, system: object) -> Float:
    """(K,) the pull of one sighting on all but the poses, which follow it."""
    pull = _Pull(x, np.zeros(x.dof))
    term.add_to(pull, x)
    if not isinstance(system, Arrow):
        return pull.gradient
    poses = system.pull.size
    out = pull.gradient[poses:].copy()
    for t in pull.touched:
        own = pull.gradient[6 * t : 6 * t + 6]
        out -= system.border[t].T @ np.linalg.solve(system.band[t, 0], own)
    return out
