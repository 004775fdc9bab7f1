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
    """(K, K) covariance of all free numbers but the boards' poses; `sightings` are terms that add the rows of
    one picture after the other.

    Raises InputError where the sightings do not determine the cameras.
    """
    system = problem.linearised(x)
    try:
        shared = system.marginals().shared if isinstance(system, Arrow) else problem.covariance(x)
    except InputError as error:
        raise InputError(_TOO_FEW) from error
    sums = _Pulls(x, system)
    for term in sightings:
        term.add_to(sums, x)
    pulls = np.array(sums.pulls)
    return shared * float(np.clip(np.sum((pulls @ shared) * pulls) / len(shared), 1.0, _MOST))


@dataclass
class _Pulls:
    """The pull (K,) of each picture on all but the poses, which follow it."""

    x: Variables
    system: object
    pulls: list[Float] = field(default_factory=list[Float])

    def add_rows(self, energy: float, slopes: list[Slope], weight: Float, residual: Float) -> None:
        """The pull of the rows of one picture."""
        gradient, touched = np.zeros(self.x.dof), set[int]()
        for slope in slopes:
            if slope.block in self.x.slices:
                start = self.x.slices[slope.block].start + slope.first
                gradient[start : start + slope.by.shape[1]] += slope.by.T @ (weight * residual)
                if slope.block == "boards":
                    touched.add(slope.first // 6)
        system = self.system
        if isinstance(system, Arrow):
            poses, gradient = np.split(gradient, [system.pull.size])
            for t in touched:
                gradient -= system.border[t].T @ np.linalg.solve(system.band[t, 0], poses[6 * t : 6 * t + 6])
        self.pulls.append(gradient)

    def add_quadratic(self, places: list[Place], value: float, gradient: Float, hessian: Float) -> None:
        """A sighting adds rows only."""
        raise NotImplementedError
