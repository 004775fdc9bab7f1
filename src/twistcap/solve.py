"""The one least-squares system: sum the terms' quadratics, damp, step, accept only if the energy falls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg

from twistcap._typing import Float
from twistcap.body import Body, Pose, Posed
from twistcap.terms import PointTerm, Quadratic, SegmentSums, Term

Status = Literal["converged", "max_iterations", "stalled", "failed"]


@dataclass(frozen=True)
class SolveResult:
    """Outcome of `least_squares`.

    Attributes:
        pose: the best pose reached; the first one where nothing better was found.
        status: "converged" (step below tolerance), "max_iterations", "stalled" (no step lowered the energy) or
            "failed" (a number was not finite, or the system could not be solved).
        steps: accepted steps.
        energy: at `pose`.
        quadratic: of all terms, at the pose where the last step was taken from.
    """

    pose: Pose
    status: Status
    steps: int
    energy: float
    quadratic: Quadratic


def total_energy(terms: Sequence[Term], posed: Posed) -> float:
    """Sum of the terms' energies."""
    return sum(term.energy(posed) for term in terms)


def linearized(terms: Sequence[Term], posed: Posed) -> Quadratic:
    """Sum of the terms' quadratics; point terms are summed by segment first and brought to the pose's step once."""
    sums, total = SegmentSums(posed), Quadratic.zero(posed.body.dof)
    for term in terms:
        if isinstance(term, PointTerm):
            term.add_to(sums)
        else:
            total = total + term.linearize(posed)
    return total + sums.quadratic()


def least_squares(
    body: Body, pose: Pose, terms: Sequence[Term], steps: int = 1, damping: float = 1e-3, tolerance: float = 1e-6
) -> SolveResult:
    """Levenberg-Marquardt over the pose.

    Args:
        body, pose: what is moved, and from where.
        terms: whose energies are summed.
        steps: how many steps to accept at most.
        damping: first Levenberg factor on the Hessian's diagonal.
        tolerance: largest entry (rad, m) of a step that counts as standing still.
    """
    posed = Posed(body, pose)
    quadratic = linearized(terms, posed)
    energy = quadratic.value
    if not _finite(quadratic):
        return SolveResult(pose, "failed", 0, energy, quadratic)
    for taken in range(steps):
        if taken:
            fresh = linearized(terms, posed)
            if not _finite(fresh):
                return SolveResult(posed.pose, "failed", taken, energy, quadratic)
            quadratic = fresh
        accepted = _downhill(terms, posed, quadratic, damping)
        if accepted is None:
            return SolveResult(posed.pose, "stalled", taken, energy, quadratic)
        posed, energy, size = accepted
        if size < tolerance:
            return SolveResult(posed.pose, "converged", taken + 1, energy, quadratic)
    return SolveResult(posed.pose, "max_iterations", steps, energy, quadratic)


def damped_step(quadratic: Quadratic, damping: float) -> Float | None:
    """Minimiser of the quadratic with its diagonal raised, no entry above 1 rad (m); None where there is none."""
    diagonal = np.diagonal(quadratic.hessian)
    H = quadratic.hessian + np.diag(damping * diagonal + 1e-9 * (1.0 + diagonal.max()))
    try:
        step = -scipy.linalg.cho_solve(scipy.linalg.cho_factor(H, check_finite=False), quadratic.gradient)
    except np.linalg.LinAlgError:
        return None
    return step / max(1.0, float(np.abs(step).max()))  # beyond 1 rad no linearisation holds


def _downhill(
    terms: Sequence[Term], posed: Posed, quadratic: Quadratic, damping: float, tries: int = 5
) -> tuple[Posed, float, float] | None:
    """The first damped step that lowers the energy: its posed body, energy and size."""
    for _ in range(tries):
        step = damped_step(quadratic, damping)
        if step is not None and np.all(np.isfinite(step)):
            candidate = Posed(posed.body, posed.pose.retract(step))
            energy = total_energy(terms, candidate)
            if np.isfinite(energy) and energy <= quadratic.value + 1e-12 * abs(quadratic.value):
                return candidate, energy, float(np.abs(step).max())
        damping = max(10.0 * damping, 1e-3)
    return None


def _finite(quadratic: Quadratic) -> bool:
    parts = (quadratic.value, quadratic.gradient, quadratic.hessian)
    return all(bool(np.all(np.isfinite(part))) for part in parts)


def covariance(quadratic: Quadratic) -> Float:
    """(6 + J, 6 + J) inverse of the Hessian; directions without any information get a variance of at least 10² rad²."""
    H = 0.5 * (quadratic.hessian + quadratic.hessian.T)
    inverse = _inverse(H)
    if inverse is not None and 1.0 / np.linalg.norm(inverse) > 1e-2:  # no eigenvalue can be below that
        return inverse
    values, vectors = np.linalg.eigh(H)
    return (vectors / np.maximum(values, 1e-2)) @ vectors.T


def _inverse(H: Float) -> Float | None:
    """Inverse of a symmetric matrix by Cholesky; None where it is not positive definite."""
    try:
        inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(H, check_finite=False), np.eye(len(H)))
    except np.linalg.LinAlgError:
        return None
    return 0.5 * (inverse + inverse.T)
