"""Contour samples drawn to the outline of a mask, with rows on a pose and on the body's girths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twistcap._typing import Float
from twistcap.adjust.first_pose.outline import Matches
from twistcap.body import Body, Posed, rescaled
from twistcap.body.kinematics import skin_points
from twistcap.body.shape import RestMotion, rest_motion, stretch_maps
from twistcap.render import ContourPoints, SurfacePoints
from twistcap.solve import Variables
from twistcap.terms import Slope, Sums
from twistcap.terms.points import projected_rows
from twistcap.terms.robust import huber

_KNEE = 2.0  # standard deviations beyond which the loss is linear


@dataclass(frozen=True)
class Girths:
    """Log-girths of groups of segments as a block of variables.

    Attributes:
        generic: the body at girths of 1.
        groups: segments that share a girth, by name.
        values: (G,) log-girths.
    """

    generic: Body
    groups: Mapping[str, Sequence[str]]
    values: Float

    @property
    def size(self) -> int:
        return len(self.values)

    def retract(self, step: Float) -> Girths:
        return replace(self, values=self.values + step)

    def minus(self, other: Girths) -> Float:
        return self.values - other.values

    @property
    def factors(self) -> dict[str, float]:
        """Factor of every segment of the groups."""
        return self._factors(self.values)

    @cached_property
    def body(self) -> Body:
        """Of these girths."""
        return rescaled(self.generic, girths=self.factors) if self.groups else self.generic

    @cached_property
    def motion(self) -> RestMotion:
        """How the rest pose moves with the log-girths."""
        return rest_motion(self.body, [], [dict.fromkeys(group, 1.0) for group in self.groups.values()], [])

    def carried(self, points: SurfacePoints, origin: Girths) -> SurfacePoints:
        """Points of the body of `origin` on the body of these girths."""
        if self is origin or not self.groups:
            return points
        maps = np.ascontiguousarray(stretch_maps(origin.body, {}, self._factors(self.values - origin.values)))
        return replace(points, local=skin_points(maps, points.segments, points.weights, points.local))

    def _factors(self, logs: Float) -> dict[str, float]:
        return {name: float(np.exp(g)) for g, group in zip(logs, self.groups.values(), strict=True) for name in group}


@dataclass(frozen=True)
class OutlineTerm:
    """Matches of one view at one instant: Huber's loss of the distances along their normals.

    Attributes:
        P: (3, 4) projection.
        points: N samples on the body of `origin`.
        origin: the girths at which they were taken.
        normal: (N, 2) directions along which the distances count.
        target: (N, 2) px, on the outline or level with it.
        sigma: px, standard deviation.
        weight: (N,) how much each match counts.
        frame: of the track.
    """

    P: Float
    points: SurfacePoints
    origin: Girths
    normal: Float
    target: Float
    sigma: float
    weight: Float
    frame: int
    name: str = "outline"
    blocks: tuple[str, ...] = ("poses", "girths")

    @staticmethod
    def of(
        P: Float, contour: ContourPoints, found: Matches, origin: Girths, sigma: float, share: float, frame: int
    ) -> OutlineTerm:
        """Of contour samples and their matches, each of which counts as a fraction `share` of a point."""
        target = contour.pixels[found.index] + found.distance[:, None] * found.normals
        return OutlineTerm(
            P, contour.points[found.index], origin, found.normals, target, sigma, share * found.weight, frame
        )

    def energy(self, x: Variables) -> float:
        posed, points = self._placed(x)
        residual, _ = projected_rows(self.P, points.at(posed), self.normal, self.target)
        return float(self.weight @ huber(residual / self.sigma, _KNEE)[0])

    def add_to(self, sums: Sums, x: Variables) -> None:
        posed, points = self._placed(x)
        residual, gradient = projected_rows(self.P, points.at(posed), self.normal, self.target)
        residual, gradient = residual / self.sigma, gradient / self.sigma
        energy, weight = huber(residual, _KNEE)
        jacobian = posed.point_jacobian(points.segments, points.weights, points.local)
        slopes = [Slope("poses", np.einsum("ni,nid->nd", gradient, jacobian), self.frame * posed.body.dof)]
        if x["girths"].groups:
            rates = x["girths"].motion.rates(posed, points.segments, points.weights, points.local, gradient)
            slopes.append(Slope("girths", rates))
        sums.add_rows(float(self.weight @ energy), slopes, self.weight * weight, residual)

    def _placed(self, x: Variables) -> tuple[Posed, SurfacePoints]:
        """The body, and the samples on it."""
        key = ("posed", self.frame)
        if key not in x.memo:
            x.memo[key] = Posed(x["girths"].body, x["poses"].poses[self.frame])
        return x.memo[key], x["girths"].carried(self.points, self.origin)
