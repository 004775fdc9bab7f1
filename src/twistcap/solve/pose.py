"""The problem of one pose: the tracker's terms, each an energy and a quadratic of the posed body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from twistcap.arrays import Float
from twistcap.body import Posed
from twistcap.render import SurfacePoints
from twistcap.solve.dense import Dense
from twistcap.solve.minimise import energies_by_name
from twistcap.terms import PointTerm, Quadratic, Rows, SegmentSums, Term


@dataclass(frozen=True)
class PoseProblem:
    """The sum of terms as a problem of the pose alone.

    Attributes:
        terms: energies of the posed body.
        rows: points and rows of the point terms, by the terms' `id`, where the problem was linearised last.
        quadratics: of all other terms there.
    """

    terms: Sequence[Term]
    rows: dict[int, tuple[SurfacePoints, Rows]] = field(default_factory=dict[int, "tuple[SurfacePoints, Rows]"])
    quadratics: dict[int, Quadratic] = field(default_factory=dict[int, Quadratic])

    def energies(self, x: Posed) -> dict[str, float]:
        """Energies by name of term."""
        return energies_by_name(self.terms, x)

    def linearised(self, x: Posed) -> Dense:
        """Sum of the quadratics; point terms are summed by segment first and brought to the pose's step once."""
        sums, total = SegmentSums(x), Quadratic.zero(x.body.dof)
        for term in self.terms:
            if isinstance(term, PointTerm):
                energy, points, rows = term.rows(x)
                sums.add_rows(energy, points, rows)
                self.rows[id(term)] = points, rows
            else:
                self.quadratics[id(term)] = term.linearize(x)
                total = total + self.quadratics[id(term)]
        return Dense.of(total + sums.quadratic())

    def retract(self, x: Posed, step: Float) -> Posed:
        """The body after a step (6 + J,) of its pose."""
        return Posed(x.body, x.pose.retract(step))
