"""The protocol of a term, and the quadratic it becomes at a pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Posed


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
