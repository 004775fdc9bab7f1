"""Terms of the pose itself: joint limits, and Gaussians around a predicted pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.terms.protocols import Place, Quadratic, Sums, Term

if TYPE_CHECKING:
    from twistcap.solve.blocks import Variables


@dataclass(frozen=True)
class LimitTerm:
    """Half a parabola beyond each joint limit; `sigma` rad is the standard deviation of going past it."""

    sigma: float = float(np.deg2rad(0.5))
    name: str = "limits"

    def _excess(self, posed: Posed) -> Float:
        limits, q = posed.body.limits, posed.pose.q
        return q - np.minimum(np.maximum(q, limits[:, 0]), limits[:, 1])

    def energy(self, posed: Posed) -> float:
        excess = self._excess(posed)
        return 0.5 * float(excess @ excess) / self.sigma**2

    def linearize(self, posed: Posed) -> Quadratic:
        excess, information = self._excess(posed), 1.0 / self.sigma**2
        value = 0.5 * float(excess @ excess) * information
        return _of_joints(value, excess * information, (excess != 0.0) * information)


def _of_joints(value: float, gradient: Float, diagonal: Float | float) -> Quadratic:
    """A quadratic of the joint coordinates alone, each by itself: gradient and diagonal of the Hessian (J,)."""
    out = Quadratic.zero(6 + len(gradient))
    out.gradient[6:] = gradient
    out.hessian.reshape(-1)[:: len(out.hessian) + 1][6:] = diagonal
    return Quadratic(value, out.gradient, out.hessian)


@dataclass(frozen=True)
class RestTerm:
    """A weak Gaussian (`sigma` rad) around the joints' rest pose, for limbs without evidence; the root is free."""

    sigma: float
    name: str = "rest"

    def energy(self, posed: Posed) -> float:
        return 0.5 * float(posed.pose.q @ posed.pose.q) / self.sigma**2

    def linearize(self, posed: Posed) -> Quadratic:
        information = 1.0 / self.sigma**2
        return _of_joints(self.energy(posed), posed.pose.q * information, information)


@dataclass(frozen=True)
class GaussianTerm:
    """A Gaussian around the pose expected: ``½ dᵀ information d`` with d (6 + J,) the step (rad, m) from `mean` to it.

    Source: Rosenhahn, Brox and Seidel, eq. 17-22 (DOI 10.1109/CVPR.2007.383128).
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


@dataclass(frozen=True)
class OnPose:
    """A term of one pose (limits, a Gaussian, a prior) at one frame of the track in the block `poses`, among others.

    The shape of the `body` does not matter.
    """

    term: Term
    body: Body
    frame: int = 0

    @property
    def name(self) -> str:
        return self.term.name

    def energy(self, x: Variables) -> float:
        return self.term.energy(self._posed(x))

    def add_to(self, sums: Sums, x: Variables) -> None:
        q, dof = self.term.linearize(self._posed(x)), self.body.dof
        sums.add_quadratic([Place("poses", dof, self.frame * dof)], q.value, q.gradient, q.hessian)

    def _posed(self, x: Variables) -> Posed:
        return Posed(self.body, x["poses"].poses[self.frame])


@dataclass(frozen=True)
class BlockGaussian:
    """Independent Gaussians about the numbers (n,) of a `Vector`, in its own units."""

    block: str
    mean: Float
    sigma: Float
    name: str = "shape"

    def energy(self, x: Variables) -> float:
        return 0.5 * float(np.sum(((x[self.block].values - self.mean) / self.sigma) ** 2))

    def add_to(self, sums: Sums, x: Variables) -> None:
        gradient = (x[self.block].values - self.mean) / self.sigma**2
        sums.add_quadratic([Place(self.block, len(gradient))], self.energy(x), gradient, np.diag(self.sigma**-2.0))
