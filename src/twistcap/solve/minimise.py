"""The one minimiser: Gauss-Newton steps, damped, and accepted only if the energy falls (Levenberg and Marquardt).

Madsen, Nielsen and Tingleff, "Methods for Non-Linear Least Squares Problems", 2004, section 3.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar

import numpy as np

from twistcap.arrays import Float

Status = Literal["converged", "max_iterations", "stalled", "failed"]

X = TypeVar("X")
S = TypeVar("S", bound="System")
S_co = TypeVar("S_co", bound="System", covariant=True)

_TOLERANCE = 1e-6  # largest entry of a step, in the blocks' own units (rad, m), that counts as converged
_TRIES = 5  # dampings of one step, each ten times the one before
_ROUNDING = 1e-12  # of the energy, by which a step may raise it


class System(Protocol):
    """The quadratic of the energy at a point, over the stacked step of all free blocks."""

    @property
    def value(self) -> float:
        """Energy at the point."""
        ...

    def finite(self) -> bool:
        """Whether every number is finite."""
        ...

    def step(self, damping: float) -> Float | None:
        """Minimiser with the diagonal raised by the fraction `damping`, shortened; None if it cannot be solved."""


class Problem(Protocol[X, S_co]):
    """An energy of some X (a pose, named blocks), with its quadratic at every point."""

    def energies(self, x: X) -> Mapping[str, float]:
        """Energies by name of term."""
        ...

    def linearised(self, x: X) -> S_co:
        """Their sum, as a quadratic of the step."""
        ...

    def retract(self, x: X, step: Float) -> X:
        """The point after a step."""
        ...


def energies_by_name(terms: Iterable[Any], x: Any) -> dict[str, float]:
    """Energies of terms by name; those of the same name are summed."""
    out: dict[str, float] = {}
    for term in terms:
        out[term.name] = out.get(term.name, 0.0) + term.energy(x)
    return out


@dataclass(frozen=True)
class Solution(Generic[X, S]):
    """Outcome of `minimise`.

    Attributes:
        x: the best point reached; the first one if none was better.
        status: "converged" (step below tolerance, or gain too small), "max_iterations", "stalled" (no step lowered the
            energy) or "failed" (a number was not finite).
        steps, energies: accepted steps, and energies at that point, by name of term.
        system: of all terms, at the point before the last step.
    """

    x: X
    status: Status
    steps: int
    energies: Mapping[str, float]
    system: S

    @property
    def energy(self) -> float:
        """Sum of the energies there."""
        return sum(self.energies.values())


def minimise(problem: Problem[X, S], x: X, steps: int = 1, damping: float = 1e-3, gain: float = 0.0) -> Solution[X, S]:
    """Minimise the energy of a problem from a point on, by at most so many accepted steps.

    A step that does not lower the energy is damped ten times more and tried again. The next step begins with a tenth
    of the damping that was needed, but not below `damping`, the least factor on the diagonal. The energy must fall by
    the fraction `gain` for another step to be taken.
    """
    system, energies = problem.linearised(x), None
    status: Status = "max_iterations"
    taken, least = 0, damping
    if not system.finite():
        return Solution(x, "failed", 0, problem.energies(x), system)
    while taken < steps:
        if taken:
            fresh = problem.linearised(x)
            if not fresh.finite():
                status = "failed"
                break
            system = fresh
        accepted = _downhill(problem, x, system, damping)
        if accepted is None:
            status = "stalled"
            break
        (x, energies, size, used, gained), taken = accepted, taken + 1
        damping = max(0.1 * used, least)
        if size < _TOLERANCE or gained < gain:
            status = "converged"
            break
    return Solution(x, status, taken, energies or problem.energies(x), system)


def _downhill(
    problem: Problem[X, S], x: X, system: S, damping: float
) -> tuple[X, Mapping[str, float], float, float, float] | None:
    """The first damped step that lowers the energy: the new point, its energies, the step's size and damping, and the
    fraction by which the energy fell.
    """
    before = system.value
    for _ in range(_TRIES):
        step = system.step(damping)
        if step is not None and np.all(np.isfinite(step)):
            candidate = problem.retract(x, step)
            energies = problem.energies(candidate)
            energy = sum(energies.values())
            if math.isfinite(energy) and energy <= before + _ROUNDING * abs(before):
                gain = (before - energy) / max(abs(before), 1e-300)
                return candidate, energies, float(np.abs(step).max(initial=0.0)), damping, gain
        damping = max(10.0 * damping, 1e-3)
    return None
