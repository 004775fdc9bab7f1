"""The shape that is refined: lengths and girths of groups of segments, and joint centres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from twistcap.adjust.refine.settings import RefineConfig
from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.body.shape import RestMotion, hinge_middles, joints_moved, rescaled, rest_motion, stretch_maps

Groups = Mapping[str, tuple[str, ...]]
"""Segments that share a parameter, left and right alike, by the group's name."""


@dataclass(frozen=True)
class Shape:
    """The free parameters of a shape (`body` has them): groups that are stretched and widened, moved proximal joints.

    `sigma` (K,) are their prior standard deviations, `total` (K,) their change since the body given: log-lengths,
    log-girths, then x, y, z (m) of joints.
    """

    body: Body
    stretched: Groups
    widened: Groups
    moved: tuple[str, ...]
    sigma: Float
    total: Float

    @staticmethod
    def of(body: Body, groups: Groups, config: RefineConfig) -> Shape:
        """The parameters that a configuration leaves free."""
        stretched = groups if config.length > 0 else {}
        widened = groups if config.girth > 0 else {}
        jointed = zip(body.segment_names, body.segment_joint, strict=True)
        moved = tuple(name for name, joint in jointed if joint >= 0) if config.joint > 0 else ()
        sizes = (len(stretched), len(widened), 3 * len(moved))
        sigma = np.repeat([config.length, config.girth, config.joint], sizes)
        return Shape(body, stretched, widened, moved, sigma, np.zeros(len(sigma)))

    @property
    def places_joints(self) -> bool:
        """Whether lengths or joint centres are free."""
        return bool(self.stretched or self.moved)

    def girths_alone(self) -> Shape:
        """The same with all lengths and joint centres held where they are."""
        own = slice(*self._bounds)
        return replace(self, stretched={}, moved=(), sigma=self.sigma[own], total=self.total[own])

    @property
    def _bounds(self) -> tuple[int, int]:
        """Where among the parameters the girths begin, and the joint centres."""
        return len(self.stretched), len(self.stretched) + len(self.widened)

    def motion(self) -> RestMotion:
        """How the rest pose moves with the parameters."""
        kinds = (self.stretched, self.widened)
        stretched, widened = ([dict.fromkeys(group, 1.0) for group in kind.values()] for kind in kinds)
        return rest_motion(self.body, stretched, widened, [self.body.segment(name) for name in self.moved])

    def prior(self, hinge: float) -> tuple[float, Float, Float]:
        """Energy, gradient (K,) and information (K, K) of the prior, at this shape; for `hinge` see `RefineConfig`."""
        information, gradient = np.diag(self.sigma**-2.0), self.total / self.sigma**2
        energy = 0.5 * float(gradient @ self.total)
        middles = hinge_middles(self.body) if hinge > 0 else {}
        for k, name in enumerate(self.moved):
            if name in middles:
                axis, off = middles[name]
                own = slice(self._bounds[1] + 3 * k, self._bounds[1] + 3 * k + 3)
                gradient[own] -= axis * (off / hinge**2)
                information[own, own] += np.outer(axis, axis) / hinge**2
                energy += 0.5 * (off / hinge) ** 2
        return energy, gradient, information

    def stepped(self, step: Float) -> Shape:
        """The shape after a step (K,)."""
        lengths, girths, joints = self.parts(step)
        body = rescaled(self.body, _factors(self.stretched, lengths), _factors(self.widened, girths))
        return replace(self, body=joints_moved(body, joints), total=self.total + step)

    def maps_since(self, earlier: Shape) -> Float | None:
        """(S, 4, 4) maps of rest points from an earlier shape to this one; None where nothing has moved."""
        if np.array_equal(self.total, earlier.total):
            return None
        lengths, girths, _ = self.parts(self.total - earlier.total)
        return stretch_maps(earlier.body, _factors(self.stretched, lengths), _factors(self.widened, girths))

    def parts(self, values: Float) -> tuple[dict[str, float], dict[str, float], dict[str, Float]]:
        """Values (K,) by group of lengths, group of girths, and segment of joints (3,)."""
        a, b = self._bounds
        lengths = {name: float(v) for name, v in zip(self.stretched, values[:a], strict=True)}
        girths = {name: float(v) for name, v in zip(self.widened, values[a:b], strict=True)}
        return lengths, girths, dict(zip(self.moved, values[b:].reshape(-1, 3), strict=True))


def _factors(groups: Groups, logs: Mapping[str, float]) -> dict[str, float]:
    """Factor of every segment of the groups."""
    return {name: float(np.exp(logs[key])) for key, group in groups.items() for name in group}
