"""Rows of a term on named blocks of variables, and the protocol of what sums them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from twistcap.arrays import Float

if TYPE_CHECKING:
    from twistcap.solve.blocks import Variables


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
        ...

    def add_quadratic(self, places: list[Place], value: float, gradient: Float, hessian: Float) -> None:
        """Add a quadratic of the numbers at these places, one place after the other."""
        ...


class BlockTerm(Protocol):
    """An energy of named blocks.

    Attributes:
        name: of its energy in reports; several terms may have the same.
        blocks: names of the blocks on which it has rows.
    """

    @property
    def name(self) -> str: ...

    @property
    def blocks(self) -> tuple[str, ...]: ...

    def energy(self, x: Variables) -> float:
        """Energy at these values."""
        ...

    def add_to(self, sums: Sums, x: Variables) -> None:
        """Add rows or quadratics at these values."""
        ...
