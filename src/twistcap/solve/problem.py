"""The two problems: one pose, the tracker's terms; named blocks, with the systems that sum terms over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from twistcap.arrays import Bool, Float, Int
from twistcap.body import Posed
from twistcap.render import SurfacePoints
from twistcap.solve.arrow import Arrow
from twistcap.solve.blocks import Variables
from twistcap.solve.dense import Dense, covariance
from twistcap.solve.minimise import energies_by_name
from twistcap.terms import PointTerm, Quadratic, Rows, SegmentSums, Term
from twistcap.terms.protocols import BlockTerm, Place, Slope

AnySums = TypeVar("AnySums", "DenseSums", "ArrowSums")


class DenseSums:
    """Normal equations of all free blocks in one dense matrix."""

    def __init__(self, x: Variables) -> None:
        self.x, self.value = x, 0.0
        self.gradient, self.hessian = np.zeros(x.dof), np.zeros((x.dof, x.dof))

    def add_rows(self, energy: float, slopes: Sequence[Slope], weight: Float, residual: Float) -> None:
        self.value += energy
        placed = [(_place(self.x, s), s.by) for s in slopes if s.block in self.x.slices]
        for i, (rows, first) in enumerate(placed):
            weighted = first.T * weight
            self.gradient[rows] += weighted @ residual
            for columns, second in placed[i:]:
                block = weighted @ second
                self.hessian[rows, columns] += block
                if columns != rows:
                    self.hessian[columns, rows] += block.T

    def add_quadratic(self, places: Sequence[Place], value: float, gradient: Float, hessian: Float) -> None:
        self.value += value
        own, there = _free(self.x, places)
        self.gradient[there] += gradient[own]
        self.hessian[np.ix_(there, there)] += hessian[np.ix_(own, own)]

    def system(self) -> Dense:
        """The sums as a system; numbers that are fixed or at their limits are held."""
        dense = Dense(self.value, self.gradient, self.hessian, self.x.longest_step())
        held = self.x.held(self.gradient)
        return dense.holding(held) if held.any() else dense


class ArrowSums:
    """Normal equations of a track of poses in a band, with all other free blocks as the border.

    The track is the first of the free blocks. Limits and fixed numbers are ignored.
    """

    def __init__(self, x: Variables, reach: int) -> None:
        self.x, self.track = x, x.free[0]
        poses = x[self.track]
        self.pose_dof = poses.pose_dof
        self.arrow = Arrow(len(poses.poses), self.pose_dof, x.dof - poses.dof, reach)
        self.arrow.longest = x.longest_step(x.free[:1])[: self.pose_dof]
        self.arrow.shared_longest = x.longest_step(x.free[1:])

    def add_rows(self, energy: float, slopes: Sequence[Slope], weight: Float, residual: Float) -> None:
        """The rows of frames in ascending order."""
        self.arrow.value += energy
        frames = [(s.first // self.pose_dof, s.by) for s in slopes if s.block == self.track]
        shared = [s for s in slopes if s.block != self.track and s.block in self.x.slices]
        border = np.zeros((len(residual), len(self.arrow.corner))) if shared else None
        for slope in shared:
            assert border is not None
            border[:, _place(self.x, slope, self.arrow.pull.size)] += slope.by
        J = tuple(by for _, by in frames)
        self.arrow.add_rows(tuple(t for t, _ in frames), J, border, weight, residual)

    def add_quadratic(self, places: Sequence[Place], value: float, gradient: Float, hessian: Float) -> None:
        """Of one whole pose, of shared blocks, or both."""
        self.arrow.value += value
        (own, there), poses = _free(self.x, places), self.arrow.pull.size
        pose, shared = own[there < poses], own[there >= poses]
        border = there[there >= poses] - poses
        if len(pose):
            frame = int(there[there < poses][0]) // self.pose_dof
            self.arrow.add_pose(frame, gradient[pose], hessian[np.ix_(pose, pose)])
            self.arrow.border[frame][:, border] += hessian[np.ix_(pose, shared)]
        self.arrow.shared_pull[border] += gradient[shared]
        self.arrow.corner[np.ix_(border, border)] += hessian[np.ix_(shared, shared)]


def _place(x: Variables, slope: Slope, before: int = 0) -> slice:
    """Place of a slope in the step of all free blocks less the numbers `before`."""
    start = x.slices[slope.block].start + slope.first - before
    return slice(start, start + slope.by.shape[1])


def _free(x: Variables, places: Sequence[Place]) -> tuple[Int, Int]:
    """Which numbers of a quadratic are free, and their places in the step of all free blocks."""
    own, there, start = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)], 0
    for place in places:
        if place.block in x.slices:
            own.append(np.arange(start, start + place.size, dtype=np.int32))
            there.append(x.slices[place.block].start + place.first + np.arange(place.size, dtype=np.int32))
        start += place.size
    return np.concatenate(own), np.concatenate(there)


@dataclass(frozen=True)
class BlockProblem:
    """A sum of terms over named blocks.

    `reach` None is for a dense system; else it is how many frames apart the rows of a term may be, for an `Arrow` whose
    track is the first free block.
    """

    terms: Sequence[BlockTerm]
    reach: int | None = None

    def energies(self, x: Variables) -> dict[str, float]:
        """Energies by name of term."""
        return energies_by_name(self.terms, x)

    def linearised(self, x: Variables) -> Dense | Arrow:
        """Sum of the quadratics of the step of all free blocks."""
        return self.dense(x) if self.reach is None else self.arrow(x, self.reach)

    def dense(self, x: Variables) -> Dense:
        """The same in one matrix, whatever the reach."""
        return self._summed(DenseSums(x)).system()

    def covariance(self, x: Variables) -> Float:
        """(dof, dof) marginal covariances of all free blocks, without limits."""
        sums = self._summed(DenseSums(x))
        return covariance(Quadratic(sums.value, sums.gradient, sums.hessian))

    def arrow(self, x: Variables, reach: int) -> Arrow:
        """The same with the track's poses in a band."""
        return self._summed(ArrowSums(x, reach)).arrow

    def _summed(self, sums: AnySums) -> AnySums:
        for term in self.terms:
            term.add_to(sums, sums.x)
        return sums

    def retract(self, x: Variables, step: Float) -> Variables:
        """The blocks after a step."""
        return x.retract(step)


@dataclass(frozen=True)
class PoseProblem:
    """The sum of terms as a problem of the pose alone; `rows` of point terms and `quadratics` of the others, by `id` of
    the terms, are those where it was linearised last. `fixed` (6 + J,) says which numbers of the step do not move; the
    system has no information of these.
    """

    terms: Sequence[Term]
    fixed: Bool | None = None
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
        total = total + sums.quadratic()
        dense = Dense(total.value, total.gradient, total.hessian)
        return dense if self.fixed is None else dense.holding(self.fixed)

    def retract(self, x: Posed, step: Float) -> Posed:
        """The body after a step (6 + J,) of its pose."""
        return Posed(x.body, x.pose.retract(step))
