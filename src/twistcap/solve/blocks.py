"""Blocks of variables that know how to take a step, and named sets of them of which some are free.

A block is any value with `dof`, the numbers of its step, and `retract(step)`, the value after that step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body import Pose
from twistcap.camera import Camera


@dataclass(frozen=True)
class Vector:
    """Numbers (n,) whose step is added, inside `limits` (n, 2): an exposure, log-factors of lengths, a clock."""

    values: Float
    limits: Float | None = None

    @property
    def dof(self) -> int:
        return len(self.values)

    def retract(self, step: Float) -> Vector:
        values = self.values + step
        return replace(self, values=values if self.limits is None else np.clip(values, *self.limits.T))

    def pressed(self, gradient: Float) -> Bool:
        """(n,) which numbers are at a limit that a step against the gradient would cross."""
        if self.limits is None:
            return np.zeros(self.dof, dtype=np.bool_)
        lower, upper = self.limits.T
        return ((self.values <= lower) & (gradient > 0)) | ((self.values >= upper) & (gradient < 0))


@dataclass(frozen=True)
class Moment:
    """A pose between two frames of a track, at a `fraction` of the `step` (D,) from one to the other, and `velocity`
    (D,) (rad/s, m/s), the derivative of its step by time.
    """

    pose: Pose
    frames: tuple[int, int]
    fraction: float
    step: Float
    velocity: Float

    @cached_property
    def by_frame(self) -> tuple[Float, Float]:
        """(D, D) derivatives of its step by those of the two frames, see `PoseTrack.at`."""
        a, along, D = self.fraction, self.step[:6], len(self.step)
        bent = a * se3.left_jacobian(a * along)
        by_first, by_second = (1.0 - a) * np.eye(D), a * np.eye(D)
        by_first[:6, :6] = se3.adjoint(se3.exp(a * along)) - bent @ se3.inverse_left_jacobian(-along)
        by_second[:6, :6] = bent @ se3.inverse_left_jacobian(along)
        return by_first, by_second


@dataclass(frozen=True)
class PoseTrack:
    """Poses at F ascending `times` (F,) s as one block: the step is that of the first pose, then of the second …"""

    poses: tuple[Pose, ...]
    times: Float

    @property
    def pose_dof(self) -> int:
        """Numbers of one pose's step."""
        return 6 + len(self.poses[0].q)

    @property
    def dof(self) -> int:
        return len(self.poses) * self.pose_dof

    def retract(self, step: Float) -> PoseTrack:
        steps = step.reshape(len(self.poses), -1)
        return replace(self, poses=tuple(p.retract(s) for p, s in zip(self.poses, steps, strict=True)))

    def at(self, time: float) -> Moment:
        """The pose at a time (s), by the constant velocity of the two frames next to it; it extrapolates outside.

        With ``ξ = log(M₂ M₁⁻¹)`` and the fraction a of the interval it is ``exp(a ξ) M₁``. A step δ₁ of M₁ moves it by
        ``Ad δ₁ − a J(aξ) J⁻¹(−ξ) δ₁``, and δ₂ of M₂ by ``a J(aξ) J⁻¹(ξ) δ₂``, J the left Jacobian, Ad that of exp(a ξ).
        """
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.poses) - 2))
        first, second, gap = self.poses[k], self.poses[k + 1], float(self.times[k + 1] - self.times[k])
        a, step = (time - float(self.times[k])) / gap, second.minus(first)
        return Moment(first.retract(a * step), (k, k + 1), a, step, step / gap)


@dataclass(frozen=True)
class CameraBlock:
    """A pinhole camera. The step is the left twist of `T_cam_world` (ω rad, v m; in its axes)."""

    camera: Camera

    @property
    def dof(self) -> int:
        return 6

    def retract(self, step: Float) -> CameraBlock:
        T = se3.compose_one(se3.exp_one(step), self.camera.T_cam_world)
        return CameraBlock(replace(self.camera, T_cam_world=T))


@dataclass(frozen=True)
class Variables:
    """Named blocks, of which those in `free` move; the whole step is that of these blocks, in this order.

    Attributes:
        longest: by name, the largest entry of a block's step, a number or one for each entry; by default 1 (rad, m).
        fixed: by name, which numbers of a free block do not move.
    """

    blocks: Mapping[str, Any]
    free: tuple[str, ...]
    longest: Mapping[str, Float | float] = field(default_factory=dict)
    fixed: Mapping[str, Bool] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        return self.blocks[name]

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Place of each free block in the step."""
        ends = np.cumsum([0, *(self.blocks[name].dof for name in self.free)])
        return {name: slice(int(a), int(b)) for name, a, b in zip(self.free, ends[:-1], ends[1:], strict=True)}

    @property
    def dof(self) -> int:
        """Numbers of the step of all free blocks."""
        return sum(self.blocks[name].dof for name in self.free)

    def longest_step(self, names: Sequence[str] | None = None) -> Float:
        """(n,) `longest` of every number of the step of these blocks, by default all free ones."""
        names = self.free if names is None else names
        steps = [np.broadcast_to(self.longest.get(name, 1.0), self.blocks[name].dof) for name in names]
        return np.concatenate([np.zeros(0), *steps])

    def retract(self, step: Float) -> Variables:
        """All blocks after a step (dof,) of the free ones."""
        moved = {name: self.blocks[name].retract(step[own]) for name, own in self.slices.items()}
        return replace(self, blocks={**self.blocks, **moved})

    def held(self, gradient: Float) -> Bool:
        """(dof,) which numbers are fixed, or at a limit that a step against the gradient would cross."""
        out = np.zeros(self.dof, dtype=np.bool_)
        for name, own in self.slices.items():
            block = self.blocks[name]
            if isinstance(block, Vector):
                out[own] = block.pressed(gradient[own])
            if name in self.fixed:
                out[own] |= self.fixed[name]
        return out

    @cached_property
    def memo(self) -> dict[Any, Any]:
        """Results of terms at these values that other terms may use."""
        return {}
