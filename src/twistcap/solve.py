"""The one least-squares system: sum the terms' quadratics, damp, step, accept only if the energy falls."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import get_lapack_funcs

from twistcap._typing import Float
from twistcap.body import Pose, Posed
from twistcap.terms import PointTerm, Quadratic, SegmentSums, Term

# Cholesky, without the cost of scipy's batching
_posv, _potrf, _potri = get_lapack_funcs(("posv", "potrf", "potri"), dtype=np.float64)

Status = Literal["converged", "max_iterations", "stalled", "failed"]


@dataclass(frozen=True)
class SolveResult:
    """Outcome of `least_squares`.

    Attributes:
        posed: the body at the best pose reached; at the first one where nothing better was found.
        status: "converged" (step below tolerance), "max_iterations", "stalled" (no step lowered the energy) or
            "failed" (a number was not finite, or the system could not be solved).
        steps: accepted steps.
        energies: at that pose, by name of term.
        quadratic: of all terms, at the pose where the last step was taken from.
    """

    posed: Posed
    status: Status
    steps: int
    energies: Mapping[str, float]
    quadratic: Quadratic

    @property
    def pose(self) -> Pose:
        """The best pose reached."""
        return self.posed.pose

    @property
    def energy(self) -> float:
        """Sum of the energies there."""
        return sum(self.energies.values())


def energies_at(terms: Sequence[Term], posed: Posed) -> dict[str, float]:
    """Energies by name of term; terms of the same name are summed."""
    out: dict[str, float] = {}
    for term in terms:
        out[term.name] = out.get(term.name, 0.0) + term.energy(posed)
    return out


def linearized(terms: Sequence[Term], posed: Posed) -> Quadratic:
    """Sum of the terms' quadratics; point terms are summed by segment first and brought to the pose's step once."""
    sums, total = SegmentSums(posed), Quadratic.zero(posed.body.dof)
    for term in terms:
        if isinstance(term, PointTerm):
            sums.add_rows(*term.rows(posed))
        else:
            total = total + term.linearize(posed)
    return total + sums.quadratic()


def least_squares(
    posed: Posed, terms: Sequence[Term], steps: int = 1, damping: float = 1e-3, tolerance: float = 1e-6
) -> SolveResult:
    """Levenberg-Marquardt over the pose.

    Args:
        posed: what is moved, and from where.
        terms: whose energies are summed.
        steps: how many steps to accept at most.
        damping: first Levenberg factor on the Hessian's diagonal.
        tolerance: largest entry (rad, m) of a step that counts as standing still.
    """
    quadratic = linearized(terms, posed)
    energies: Mapping[str, float] | None = None  # known where a step has been taken
    status, taken = "max_iterations", 0
    if not _finite(quadratic):
        return SolveResult(posed, "failed", 0, energies_at(terms, posed), quadratic)
    while taken < steps:
        if taken:
            fresh = linearized(terms, posed)
            if not _finite(fresh):
                status = "failed"
                break
            quadratic = fresh
        accepted = _downhill(terms, posed, quadratic, damping)
        if accepted is None:
            status = "stalled"
            break
        posed, energies, size = accepted
        taken += 1
        if size < tolerance:
            status = "converged"
            break
    return SolveResult(posed, status, taken, energies or energies_at(terms, posed), quadratic)


def damped_step(quadratic: Quadratic, damping: float) -> Float | None:
    """Minimiser of the quadratic with its diagonal raised, no entry above 1 rad (m); None where there is none."""
    H = quadratic.hessian.copy()
    diagonal = np.diagonal(quadratic.hessian)
    np.fill_diagonal(H, (1.0 + damping) * diagonal + 1e-9 * (1.0 + diagonal.max()))
    _, step, failed = _posv(H, -quadratic.gradient)
    if failed:
        return None
    return step / max(1.0, float(np.abs(step).max()))  # beyond 1 rad no linearisation holds


def _downhill(
    terms: Sequence[Term], posed: Posed, quadratic: Quadratic, damping: float, tries: int = 5
) -> tuple[Posed, dict[str, float], float] | None:
    """The first damped step that lowers the energy: its posed body, energies and size."""
    for _ in range(tries):
        step = damped_step(quadratic, damping)
        if step is not None and np.all(np.isfinite(step)):
            candidate = Posed(posed.body, posed.pose.retract(step))
            energies = energies_at(terms, candidate)
            energy = sum(energies.values())
            if np.isfinite(energy) and energy <= quadratic.value + 1e-12 * abs(quadratic.value):
                return candidate, energies, float(np.abs(step).max())
        damping = max(10.0 * damping, 1e-3)
    return None


def _finite(quadratic: Quadratic) -> bool:
    # A sum is finite only where every number is; that it overflows with all of them finite is no use either.
    return math.isfinite(quadratic.value + float(quadratic.gradient.sum()) + float(quadratic.hessian.sum()))


def covariance(quadratic: Quadratic) -> Float:
    """(6 + J, 6 + J) inverse of the Hessian; directions without any information get a variance of at least 10² rad²."""
    H = 0.5 * (quadratic.hessian + quadratic.hessian.T)
    found = inverse(H)
    if found is not None and 1.0 / np.linalg.norm(found) > 1e-2:  # no eigenvalue can be below that
        return found
    values, vectors = np.linalg.eigh(H)
    return (vectors / np.maximum(values, 1e-2)) @ vectors.T


def inverse(H: Float) -> Float | None:
    """Inverse of a symmetric matrix by Cholesky; None where it is not positive definite."""
    factor, failed = _potrf(H)
    if failed:
        return None
    upper, failed = _potri(factor)
    if failed:
        return None
    out = upper + upper.T
    out.flat[:: len(H) + 1] *= 0.5
    return out
