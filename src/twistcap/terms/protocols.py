"""What a term is: of a pose, by its quadratic, or of named blocks of variables, by rows that are summed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Posed

if TYPE_CHECKING:
    from twistcap.solve.blocks import Variables


@dataclass(frozen=True)
class Quadratic:
    """``E(δ) ≈ value + gradientᵀ δ + ½ δᵀ hessian δ`` in the pose step δ (6 + J,): (ω rad, v m) of the root, then q."""

    value: float
    gradient: Float
    hessian: Float

    @staticmethod
    def zero(dof: int) -> Quadratic:
        return Quadratic(0.0, np.zeros(dof), np.zeros((dof, dof)))

    def __add__(self, other: Quadratic) -> Quadratic:
        return Quadratic(self.value + other.value, self.gradient + other.gradient, self.hessian + other.hessian)


class Term(Protocol):
    """Evidence or a prior, as an energy (negative log-likelihood) of the pose."""

    @property
    def name(self) -> str:
        """Name of its energy in reports; several terms (one per view) may have the same."""
        ...

    def energy(self, posed: Posed) -> float:
        """Energy at a pose."""
        ...

    def linearize(self, posed: Posed) -> Quadratic:
        """Gauss-Newton quadratic at a pose; its value is `energy`'s."""
        ...


class MaskableTerm(Term, Protocol):
    """A term of image evidence that can be masked where a part is occluded."""

    def masked(self, by_part: Float) -> MaskableTerm:
        """The same term with the information of each of S parts times a factor (S,) in [0, 1]."""
        ...


@dataclass(frozen=True)
class Slope:
    """Derivatives (N, n) of residuals by n numbers of a block's step, from the number `first` on."""

    block: str
    by: Float
    first: int = 0


@dataclass(frozen=True)
class Place:
    """`size` numbers of a block's step, from the number `first` on."""

    block: str
    size: int
    first: int = 0


class Sums(Protocol):
    """A system while it is being summed; rows of blocks that are not free are left out."""

    def add_rows(self, energy: float, slopes: list[Slope], weight: Float, residual: Float) -> None:
        """Add ½ Σ weight (residual + Σ by δ)² of N rows; their true, robust energy is `energy`."""

    def add_quadratic(self, places: list[Place], value: float, gradient: Float, hessian: Float) -> None:
        """Add a quadratic of the numbers at these places, one place after the other."""


class BlockTerm(Protocol):
    """An energy of the blocks on which it has rows; several terms may have the same name."""

    @property
    def name(self) -> str: ...

    def energy(self, x: Variables) -> float:
        """Energy at these values."""
        ...

    def add_to(self, sums: Sums, x: Variables) -> None:
        """Add rows or quadratics at these values."""
