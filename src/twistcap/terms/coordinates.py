"""Terms of the pose itself: joint limits, and Gaussians around a predicted pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap import se3
from twistcap._typing import Float
from twistcap.body import Pose, Posed
from twistcap.terms.quadratic import Quadratic


@dataclass(frozen=True)
class LimitTerm:
    """Half a parabola beyond each joint limit; `sigma` rad is the standard deviation of going past it."""

    sigma: float = np.deg2rad(0.5)
    name: str = "limits"

    def _excess(self, posed: Posed) -> Float:
        low, high = posed.body.limits.T
        q = posed.pose.q
        return np.minimum(q - low, 0.0) + np.maximum(q - high, 0.0)

    def energy(self, posed: Posed) -> float:
        return 0.5 * float(np.sum(self._excess(posed) ** 2)) / self.sigma**2

    def linearize(self, posed: Posed) -> Quadratic:
        excess = self._excess(posed)
        gradient, diagonal = np.zeros(posed.body.dof), np.zeros(posed.body.dof)
        gradient[6:] = excess / self.sigma**2
        diagonal[6:] = (excess != 0.0) / self.sigma**2
        return Quadratic(self.energy(posed), gradient, np.diag(diagonal))


@dataclass(frozen=True)
class RestTerm:
    """A weak Gaussian (`sigma` rad) around the joints' rest pose, for limbs that nothing shows; the root is free."""

    sigma: float
    name: str = "rest"

    def energy(self, posed: Posed) -> float:
        return 0.5 * float(posed.pose.q @ posed.pose.q) / self.sigma**2

    def linearize(self, posed: Posed) -> Quadratic:
        gradient, diagonal = np.zeros(posed.body.dof), np.zeros(posed.body.dof)
        gradient[6:], diagonal[6:] = posed.pose.q / self.sigma**2, 1.0 / self.sigma**2
        return Quadratic(self.energy(posed), gradient, np.diag(diagonal))


@dataclass(frozen=True)
class GaussianTerm:
    """A Gaussian around a pose: ``½ dᵀ information d`` with d the step from `mean` to the pose.

    With no other evidence the solution is `mean` itself (Rosenhahn, Brox and Seidel, eq. 17-22).

    Attributes:
        mean: the pose expected.
        information: (6 + J, 6 + J) inverse covariance of the step (rad, m).
    """

    mean: Pose
    information: Float
    name: str = "temporal"

    def energy(self, posed: Posed) -> float:
        d = posed.pose.minus(self.mean)
        return 0.5 * float(d @ self.information @ d)

    def linearize(self, posed: Posed) -> Quadratic:
        d = posed.pose.minus(self.mean)
        # d = log(exp(δ) exp(d_root)): its derivative by δ is the inverse left Jacobian at d.
        D = se3.inverse_left_jacobian_one(d[:6])
        along = self.information @ d
        value = 0.5 * float(d @ along)
        H = self.information.copy()
        H[:6] = D.T @ H[:6]
        H[:, :6] = H[:, :6] @ D
        along[:6] = D.T @ along[:6]
        return Quadratic(value, along, H)
