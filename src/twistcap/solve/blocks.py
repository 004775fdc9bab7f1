"""Blocks of variables that know how to take a step, and named sets of them of which some are free.

A block is anything with `dof`, `retract` and `minus`, such as a pose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera


class Block(Protocol):
    """A value that is moved by a step of `dof` numbers."""

    @property
    def dof(self) -> int:
        """Numbers of a step."""
        ...

    def retract(self, step: Float) -> Self:
        """The value after a step."""
        ...

    def minus(self, other: Self) -> Float:
        """The step that `retract` needs to come from `other` to this value."""
        ...


@dataclass(frozen=True)
class Vector:
    """Numbers whose step is added, inside their limits: an exposure, log-factors of lengths, a clock.

    Attributes:
        values: (n,) in their own unit.
        limits: (n, 2) or None for none.
    """

    values: Float
    limits: Float | None = None

    @property
    def dof(self) -> int:
        return len(self.values)

    def retract(self, step: Float) -> Vector:
        values = self.values + step
        return replace(self, values=values if self.limits is None else np.clip(values, *self.limits.T))

    def minus(self, other: Vector) -> Float:
        return self.values - other.values

    def pressed(self, gradient: Float) -> Bool:
        """(n,) which numbers are at a limit that a step against the gradient would cross."""
        if self.limits is None:
            return np.zeros(self.dof, dtype=np.bool_)
        lower, upper = self.limits.T
        return ((self.values <= lower) & (gradient > 0)) | ((self.values >= upper) & (gradient < 0))


@dataclass(frozen=True)
class Moment:
    """A pose between two of a track, and its derivatives.

    Attributes:
        pose: the interpolated pose.
        frames: numbers of the two poses.
        by_frame: (D, D) derivative of the step of `pose` by the step of each of the two.
        velocity: (D,) of `pose` (rad/s, m/s), which is its derivative by time.
    """

    pose: Pose
    frames: tuple[int, int]
    by_frame: tuple[Float, Float]
    velocity: Float


@dataclass(frozen=True)
class PoseTrack:
    """Poses of F frames as one block: the step is that of the first pose, then of the second, and so on.

    Attributes:
        poses: F of them.
        times: (F,) s, ascending.
    """

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

    def minus(self, other: PoseTrack) -> Float:
        return np.concatenate([p.minus(o) for p, o in zip(self.poses, other.poses, strict=True)])

    def at(self, time: float) -> Moment:
        """The pose at a time (s), by the constant velocity of the two frames next to it; it extrapolates outside.

        With ``ξ = log(M₂ M₁⁻¹)`` and the fraction a of the interval it is ``exp(a ξ) M₁``. A step δ₁ of M₁ moves it by
        ``Ad δ₁ − a J(aξ) J⁻¹(−ξ) δ₁``, and δ₂ of M₂ by ``a J(aξ) J⁻¹(ξ) δ₂``, J the left Jacobian, Ad that of exp(a ξ).
        """
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.poses) - 2))
        first, second, gap = self.poses[k], self.poses[k + 1], float(self.times[k + 1] - self.times[k])
        a, step = (time - float(self.times[k])) / gap, second.minus(first)
        along, D = step[:6], self.pose_dof
        bent = a * se3.left_jacobian(a * along)
        by_first, by_second = (1.0 - a) * np.eye(D), a * np.eye(D)
        by_first[:6, :6] = se3.adjoint(se3.exp(a * along)) - bent @ se3.inverse_left_jacobian(-along)
        by_second[:6, :6] = bent @ se3.inverse_left_jacobian(along)
        return Moment(first.retract(a * step), (k, k + 1), (by_first, by_second), step / gap)


@dataclass(frozen=True)
class CameraBlock:
    """A camera's pose, and optionally its focal length.

    The step is the left twist of `T_cam_world` (ω rad, v m; in the camera's axes), then log f.

    Attributes:
        camera: a pinhole.
        focal: whether the focal length is part of the step.
    """

    camera: Camera
    focal: bool = False

    @property
    def dof(self) -> int:
        return 7 if self.focal else 6

    def retract(self, step: Float) -> CameraBlock:
        K = self.camera.K.copy()
        if self.focal:
            K[:2, :2] *= np.exp(step[6])
        T = se3.compose_one(se3.exp_one(step[:6]), self.camera.T_cam_world)
        return replace(self, camera=replace(self.camera, K=K, T_cam_world=T))

    def minus(self, other: CameraBlock) -> Float:
        turn = se3.difference_one(self.camera.T_cam_world, other.camera.T_cam_world)
        growth = np.log(self.camera.K[0, 0] / other.camera.K[0, 0])
        return np.concatenate([turn, [growth]])[: self.dof]


@dataclass(frozen=True)
class FixedShape:
    """A body of known shape; see `terms.reprojection.Shaped`."""

    body: Body

    def rates(self, posed: Posed) -> Float:
        """(L, 3, 0)."""
        return np.zeros((*posed.landmarks.shape, 0))


@dataclass(frozen=True)
class Variables:
    """Named blocks, of which some are free; the whole step is that of the free blocks in the order of `free`.

    Attributes:
        blocks: by name.
        free: names of those that move.
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
        return stacked([np.broadcast_to(self.longest.get(name, 1.0), self.blocks[name].dof) for name in names])

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

    def minus(self, other: Variables) -> Float:
        """(dof,) the step that `retract` needs to come from `other` to these."""
        return stacked([self.blocks[name].minus(other.blocks[name]) for name in self.free])


def stacked(steps: Sequence[Float]) -> Float:
    """Steps of free blocks one after the other."""
    return np.concatenate(steps) if steps else np.zeros(0)
