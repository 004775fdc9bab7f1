"""Dense normal equations of one frame, or of few unknowns: damped steps, covariances."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import get_lapack_funcs

from twistcap.arrays import Bool, Float
from twistcap.terms import Quadratic

# Cholesky; scipy's own functions cost more for one small matrix
_posv, _potrf, _potri = get_lapack_funcs(("posv", "potrf", "potri"), dtype=np.float64)


@dataclass(frozen=True)
class Dense(Quadratic):
    """A quadratic over the stacked step of all free blocks, as a system that `minimise` solves.

    `longest` is the largest entry of a step, a number (1 rad or m for a pose) or (n,).
    """

    longest: Float | float = 1.0

    def finite(self) -> bool:
        # A sum is finite only if every number is.
        return math.isfinite(self.value + float(self.gradient.sum()) + float(self.hessian.sum()))

    def step(self, damping: float) -> Float | None:
        """(n,) minimiser with the diagonal raised, shortened to `longest`; None where there is none."""
        H = self.hessian.copy()
        diagonal = np.diagonal(self.hessian)
        np.fill_diagonal(H, (1.0 + damping) * diagonal + 1e-9 * (1.0 + diagonal.max(initial=0.0)))
        _, step, failed = _posv(H, -self.gradient)
        if failed:
            return None
        return step / max(1.0, float(np.abs(step / self.longest).max(initial=0.0)))

    def holding(self, held: Bool) -> Dense:
        """The system in which the unknowns `held` (n,) do not move, as at a limit."""
        gradient, hessian = np.where(held, 0.0, self.gradient), np.where(held[:, None] | held, 0.0, self.hessian)
        hessian[held, held] = 1.0
        return replace(self, gradient=gradient, hessian=hessian)

    def covariance(self) -> Float:
        """(n, n) marginal covariances of all unknowns; see `covariance`."""
        return covariance(self)


def covariance(quadratic: Quadratic) -> Float:
    """(n, n) inverse of the Hessian; directions without any information get a variance of at least 10² (rad², m²)."""
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
