"""Landmarks of a body against 2D keypoints, with rows on the poses and the shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twistcap.arrays import Float, Int
from twistcap.body import Posed
from twistcap.camera import pinhole
from twistcap.terms.protocols import Slope, Sums
from twistcap.terms.robust import geman_mcclure

if TYPE_CHECKING:
    from twistcap.solve.blocks import Variables

_NEAREST = 0.05  # m before the camera; nearer points get the residual _WRONG
_WRONG = 1e6  # standard deviations


@dataclass(frozen=True)
class ReprojectionTerm:
    """N landmarks at one frame of the track against keypoints in one view: Geman and McClure's loss of each distance.

    The blocks are ``poses``, a `PoseTrack`, and ``shape``, which has `body`, and `rates(posed)` (L, 3, K), the
    derivative of the landmarks by its step.

    Attributes:
        P: (3, 4) projection.
        marks: (N,) landmarks of the body.
        target: (N, 2) px of the pinhole camera.
        weight, sigma: (N,) confidence, 0 for missing keypoints; standard deviation, px.
        reach: standard deviations from which a keypoint is down-weighted.
        frame: of the track.
    """

    P: Float
    marks: Int
    target: Float
    weight: Float
    sigma: Float
    reach: float
    frame: int
    name: str = "keypoints"

    def energy(self, x: Variables) -> float:
        pixels, depth, _ = pinhole(self.P, self._posed(x).landmarks[self.marks])
        return float(np.sum(self.weight * geman_mcclure(self._squares(pixels, depth), self.reach)[0]))

    def add_to(self, sums: Sums, x: Variables) -> None:
        posed = self._posed(x)
        pixels, depth, by_point = pinhole(self.P, posed.landmarks[self.marks])
        squares, before = self._squares(pixels, depth), depth > _NEAREST
        energy, weight = geman_mcclure(squares, self.reach)
        scale = np.where(before, 1.0 / self.sigma, 0.0)[:, None]
        residual, by_point = scale * (pixels - self.target), scale[..., None] * by_point
        rows = np.repeat(np.where(before, self.weight * weight, 0.0), 2)
        by_pose = self._once(x, "pose", lambda: _landmark_jacobian(posed))[self.marks]
        slopes = [Slope("poses", (by_point @ by_pose).reshape(len(rows), -1), self.frame * posed.body.dof)]
        if "shape" in x.free:
            by_shape = self._once(x, "shape", lambda: x["shape"].rates(posed))[self.marks]
            slopes.append(Slope("shape", (by_point @ by_shape).reshape(len(rows), -1)))
        sums.add_rows(float(np.sum(self.weight * energy)), slopes, rows, residual.ravel())

    def _squares(self, pixels: Float, depth: Float) -> Float:
        offset = (pixels - self.target) / self.sigma[:, None]
        return np.where(depth > _NEAREST, np.sum(offset * offset, axis=1), _WRONG**2)

    def _posed(self, x: Variables) -> Posed:
        return self._once(x, "posed", lambda: Posed(x["shape"].body, x["poses"].poses[self.frame]))

    def _once(self, x: Variables, what: str, make: Callable[[], Any]) -> Any:
        """A result that other views of the same instant need too, computed once."""
        key = (what, self.frame)
        if key not in x.memo:
            x.memo[key] = make()
        return x.memo[key]


def _landmark_jacobian(posed: Posed) -> Float:
    """(L, 3, 6 + J) derivative of the landmarks by the pose step."""
    marks = posed.body.landmarks
    return posed.point_jacobian(marks.segments[:, None], np.ones((len(marks.segments), 1)), marks.points)
