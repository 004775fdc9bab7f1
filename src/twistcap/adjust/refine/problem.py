"""Poses of all frames and the shape they share as one problem: image rows of one round, motion and priors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from twistcap.adjust.refine.evidence import reshaped
from twistcap.adjust.refine.measure import CameraRound
from twistcap.adjust.refine.shape import Shape
from twistcap.adjust.refine.sums import WIDTH, FrameSums, add_products, derivatives, flat, projection
from twistcap.adjust.sequence import accelerations, pose_priors
from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.body.shape import RestMotion
from twistcap.predict import MotionNoise
from twistcap.solve import Arrow


@dataclass(frozen=True)
class Track:
    """The variables: a pose for each frame, and the shape of all."""

    poses: tuple[Pose, ...]
    shape: Shape

    @cached_property
    def posed(self) -> list[Posed]:
        """The body in every frame."""
        return [Posed(self.shape.body, pose) for pose in self.poses]


@dataclass(frozen=True)
class Standing:
    """What is known without the images: times (F,) s, and settings as in `RefineConfig`. `shape_weight` is a factor on
    the prior of the shape, which matches the way in which images are counted."""

    times: Sequence[float]
    hinge: float
    shape_weight: float
    contour: float
    noise: MotionNoise = field(default_factory=MotionNoise)


class RefineProblem:
    """The sum of one round's image rows and of standing knowledge, around the track at which was measured."""

    def __init__(self, measured: Track, rounds: Sequence[CameraRound], standing: Standing) -> None:
        self.measured, self.rounds, self.standing = measured, rounds, standing
        frames = range(len(measured.poses))
        self.contours = [[term for r in rounds if (term := r.contours[t]) is not None] for t in frames]
        self.pairs = [pair for r in rounds for pair in r.pairs]
        self.reach = max([2, *(pair.second - pair.first for pair in self.pairs)])

    def energies(self, x: Track) -> dict[str, float]:
        """Energies by term, of the whole sequence."""
        out: dict[str, float] = {}
        for name, _, value in self.parts(x):
            out[name] = out.get(name, 0.0) + value
        return out

    def parts(self, x: Track) -> Iterator[tuple[str, int, float]]:
        """Name of the term, frame (that of the shape and of motion: the last) and energy of everything summed."""
        maps, posed = x.shape.maps_since(self.measured.shape), x.posed
        for t, terms in enumerate(self.contours):
            for term in terms:
                yield "contour", t, self.standing.contour * reshaped(term, maps).energy(posed[t])
            for prior in pose_priors():
                yield prior.name, t, prior.energy(posed[t])
        for pair in self.pairs:
            yield "photometric", pair.second, reshaped(pair, maps).energy(posed[pair.first], posed[pair.second])
        yield "motion", len(posed) - 1, accelerations(x.poses, self.standing.times, self.standing.noise)
        yield "shape", len(posed) - 1, self.standing.shape_weight * x.shape.prior(self.standing.hinge)[0]

    def linearised(self, x: Track) -> Arrow:
        """The quadratic of all poses' steps and the shape's."""
        maps, motion, posed = x.shape.maps_since(self.measured.shape), x.shape.motion(), x.posed
        arrow = Arrow(len(posed), x.shape.body.dof, len(x.shape.sigma), self.reach)
        arrow.longest, arrow.shared_longest = 0.5, 0.1  # rad, and log-length or m: no linearisation holds beyond
        own = [FrameSums(at, motion) for at in posed]
        self._add_pairs(arrow, own, maps, motion)
        for t, sums in enumerate(own):
            for term in self.contours[t]:
                energy, points, rows = reshaped(term, maps).rows(sums.posed)
                arrow.value += self.standing.contour * energy
                by = derivatives(sums.posed, motion, points, rows.gradient)
                sums.add(by, self.standing.contour * rows.weight, rows.residual)
            gradient, matrix = sums.projected()  # of the pose's step and the shape's together
            D = arrow.pull.shape[1]
            arrow.add_pose(t, gradient[:D], matrix[:D, :D])
            arrow.border[t] += matrix[:D, D:]
            arrow.corner += matrix[D:, D:]
            arrow.shared_pull += gradient[D:]
            for prior in pose_priors():
                quadratic = prior.linearize(posed[t])
                arrow.value += quadratic.value
                arrow.add_pose(t, quadratic.gradient, quadratic.hessian)
        arrow.value += accelerations(x.poses, self.standing.times, self.standing.noise, arrow)
        value, gradient, information = x.shape.prior(self.standing.hinge)
        arrow.value += self.standing.shape_weight * value
        arrow.shared_pull += self.standing.shape_weight * gradient
        arrow.corner += self.standing.shape_weight * information
        return arrow

    def retract(self, x: Track, step: Float) -> Track:
        """The track after a step (F D + K,)."""
        D = x.shape.body.dof
        poses = tuple(p.retract(step[t * D : (t + 1) * D]) for t, p in enumerate(x.poses))
        return Track(poses, x.shape.stepped(step[len(poses) * D :]))

    def _add_pairs(self, arrow: Arrow, own: Sequence[FrameSums], maps: Float | None, motion: RestMotion) -> None:
        """Add brightness: the rows of each end to its frame's sums, their products to the coupling of both frames."""
        between: dict[tuple[int, int], Float] = {}
        for pair in (reshaped(p, maps) for p in self.pairs):
            a, b = pair.first, pair.second
            energy, one, other, weight, residual = pair.rows(own[a].posed, own[b].posed, motion)
            arrow.value += energy
            own[a].add(one, weight, residual)
            own[b].add(other, weight, residual)
            S = len(own[a].vector)
            blocks = between.setdefault((a, b), np.zeros((S, S, WIDTH, WIDTH)))
            add_products(*one, *other, weight, blocks)
        ways = [projection(sums.posed, motion) for sums in own] if between else []
        for (a, b), blocks in between.items():
            # xᵀ matrix y, x the steps of frame a's pose and the shape, y those of frame b's and the shape
            matrix, D = ways[a].T @ flat(blocks) @ ways[b], arrow.pull.shape[1]
            arrow.band[a, b - a] += matrix[:D, :D].T
            arrow.border[a] += matrix[:D, D:]
            arrow.border[b] += matrix[D:, :D].T
            arrow.corner += matrix[D:, D:] + matrix[D:, D:].T
