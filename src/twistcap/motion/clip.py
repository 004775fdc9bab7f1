"""A continuous recording of motion in one body's coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Float32, Int
from twistcap.body import Pose
from twistcap.errors import InputError, check

_ODD = ("bending", "rotation", "list", "twist")  # last words of trunk coordinates that change sign in a mirror
_EVEN = ("extension", "flexion", "tilt")
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class MotionClip:
    """A continuous recording of motion at a rate, poses per second, in the J joint coordinates of one body.

    `roots` (N, 4, 4) are T_world_root; q (N, J) are joint coordinates, rad, without jumps by 2π.

    Raises InputError for wrong shapes, values that are not finite, no rigid motions, or a rate that is not positive.
    """

    name: str
    names: tuple[str, ...]
    rate: float
    roots: Float
    q: Float

    def __post_init__(self) -> None:
        where = f"motion {self.name!r}"
        J, N = len(self.names), len(self.q)
        check(where, J > 0 and len(set(self.names)) == J, "its coordinate names must be given, each once")
        check(where, bool(0 < self.rate < np.inf), f"its rate is {self.rate}; it must be positive, in poses per second")
        check(where, N > 0, "it has no poses")
        check(where, self.q.shape == (N, J), f"its q must be (N, {J}), one column for each name")
        check(where, self.roots.shape == (N, 4, 4), f"its roots must be ({N}, 4, 4), one for each pose")
        for what, values in (("coordinate", self.q), ("root", self.roots.reshape(N, 16))):
            bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
            check(where, not len(bad), f"a {what} of pose {bad[0] if len(bad) else 0} is not finite; cut or fill it")
        R = self.roots[:, :3, :3]
        rigid = np.allclose(R @ np.swapaxes(R, 1, 2), np.eye(3), atol=1e-5) and bool(np.all(np.linalg.det(R) > 0))
        check(where, rigid, "a root is no rigid motion; give rotations, in metres")

    def __len__(self) -> int:
        return len(self.q)

    @property
    def duration(self) -> float:
        """Time from the first pose to the last, s."""
        return (len(self) - 1) / self.rate

    def at(self, index: int) -> Pose:
        """One pose."""
        return Pose(self.roots[index], self.q[index])

    def poses(self) -> list[Pose]:
        """All N poses."""
        return [self.at(k) for k in range(len(self))]

    def resampled(self, rate: float) -> MotionClip:
        """The same motion at another rate: joints are interpolated linearly, roots along the screw between neighbours.
        Raises an InputError for a rate that is not positive."""
        check(f"motion {self.name!r}", bool(0 < rate < np.inf), f"it cannot be resampled to {rate} poses per second")
        if rate == self.rate:
            return self
        count = int(np.floor(self.duration * rate + 1e-9)) + 1
        positions = np.minimum(np.arange(count) * (self.rate / rate), len(self) - 1)
        roots, q = interpolated_roots(self.roots, positions), interpolated_angles(self.q, positions)
        return replace(self, rate=rate, roots=roots, q=q)

    def mirrored(self) -> MotionClip:
        """The mirrored motion: left and right exchanged, the world's y axis reversed.

        Coordinates ending in ``_r`` and ``_l`` change places, equal signs meaning equal movements (CONVENTIONS.md);
        those of the trunk change sign where they bend sideways or turn. Errors are those of `mirror_of`.
        """
        (partner, sign), name = mirror_of(self.names), f"{self.name} (mirrored)"
        return replace(self, name=name, roots=_MIRROR @ self.roots @ _MIRROR, q=self.q[:, partner] * sign)


def mirror_of(names: Sequence[str]) -> tuple[Int, Float]:
    """The partner (J,) of each coordinate in a mirrored motion, and its sign (J,). Raises InputError for a name without
    a partner, or whose direction of movement is not known."""
    partner, sign = np.arange(len(names), dtype=np.int32), np.ones(len(names))
    for k, name in enumerate(names):
        if name[-2:] in ("_r", "_l"):
            other = name[:-1] + ("l" if name[-1] == "r" else "r")
            check("motion", other in names, f"{name!r} has no partner {other!r}; leave out mirrored copies")
            partner[k] = names.index(other)
        elif name.endswith(_ODD):
            sign[k] = -1.0
        elif not name.endswith(_EVEN):
            known = "…_r, …_l, …_extension, …_bending, …_rotation can"
            raise InputError(f"motion: {name!r} cannot be mirrored ({known}); leave out mirrored copies.")
    return partner, sign


def interpolated_angles(q: Float | Float32, positions: Float) -> Float:
    """(P, J) joint coordinates between the poses of q (N, J), linear; positions (P,) in poses, within 0 … N − 1."""
    before, fraction = _between(len(q), positions)
    after = np.minimum(before + 1, len(q) - 1)
    return (1.0 - fraction)[:, None] * q[before] + fraction[:, None] * q[after]


def interpolated_roots(roots: Float, positions: Float) -> Float:
    """(P, 4, 4) motions between roots (N, 4, 4): ``M_i exp(f log(M_i⁻¹ M_{i+1}))``; positions (P,) in poses."""
    before, fraction = _between(len(roots), positions)
    first, second = roots[before], roots[np.minimum(before + 1, len(roots) - 1)]
    return first @ se3.exp(fraction[:, None] * se3.log(se3.inverse(first) @ second))


def _between(count: int, positions: Float) -> tuple[Int, Float]:
    before = np.clip(np.floor(positions), 0, max(count - 2, 0)).astype(np.int32)
    return before, positions - before
