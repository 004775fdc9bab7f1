"""Distances of contour samples to the outline of a mask, with rows on a pose and on the body's girths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body, Posed, rescaled
from twistcap.body.kinematics import skin_points
from twistcap.body.shape import RestMotion, rest_motion, stretch_maps
from twistcap.render import SurfacePoints
from twistcap.solve import Variables, Vector
from twistcap.terms import Slope, Sums
from twistcap.terms.points import projected_rows
from twistcap.terms.robust import huber

_KNEE = 2.0  # standard deviations beyond which the loss is linear


@dataclass(frozen=True, kw_only=True)
class Girths(Vector):
    """Log-girths (G,) of groups of segments of the `generic` body, by name, as a block of variables."""

    generic: Body
    groups: Mapping[str, Sequence[str]]

    @property
    def factors(self) -> dict[str, float]:
        """Factor of every segment of the groups."""
        return self._factors(self.values)

    @cached_property
    def body(self) -> Body:
        """Of these girths."""
        return rescaled(self.generic, girths=self.factors) if self.groups else self.generic

    def rest_motion(self) -> RestMotion:
        """How the rest pose moves with the log-girths."""
        return rest_motion(self.body, [], [dict.fromkeys(group, 1.0) for group in self.groups.values()], [])

    def maps_from(self, origin: Girths) -> Float | None:
        """(S, 4, 4) from the rest pose of `origin`'s body to that of these girths'; None where nothing moves."""
        if self is origin or not self.groups:
            return None
        return np.ascontiguousarray(stretch_maps(origin.body, {}, self._factors(self.values - origin.values)))

    def _factors(self, logs: Float) -> dict[str, float]:
        return {name: float(np.exp(g)) for g, group in zip(logs, self.groups.values(), strict=True) for name in group}


@dataclass(frozen=True)
class OutlineTerm:
    """Matches of one view at one instant, in a `frame` of the track: Huber's loss of the distances along their normals.

    Attributes:
        points: N samples on the body of `origin`, whose girths are the same in all terms of a problem.
        motion: of the rest pose with the log-girths; None where these are not free.
        normal, target: (N, 2) directions along which the distances count, and px on the outline or on its tangent.
        sigma, weight: px, standard deviation; (N,) of each match.
    """

    P: Float
    points: SurfacePoints
    origin: Girths
    motion: RestMotion | None
    normal: Float
    target: Float
    sigma: float
    weight: Float
    frame: int
    name: str = "outline"
    blocks: tuple[str, ...] = ("poses", "girths")

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
        if self.motion is not None:
            rates = self.motion.rates(posed, points.segments, points.weights, points.local, gradient)
            slopes.append(Slope("girths", rates))
        sums.add_rows(float(self.weight @ energy), slopes, self.weight * weight, residual)

    def _placed(self, x: Variables) -> tuple[Posed, SurfacePoints]:
        """The body, and the samples on it."""
        girths, key = x["girths"], ("posed", self.frame)
        if key not in x.memo:
            x.memo[key] = Posed(girths.body, x["poses"].poses[self.frame])
        if "maps" not in x.memo:
            x.memo["maps"] = girths.maps_from(self.origin)
        posed, maps, points = x.memo[key], x.memo["maps"], self.points
        if maps is None:
            return posed, points
        return posed, replace(points, local=skin_points(maps, points.segments, points.weights, points.local))
