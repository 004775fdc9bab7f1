"""`MotionClip`: a stretch of motion in one body's coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap._typing import Float
from twistcap.body import Pose
from twistcap.errors import InputError


@dataclass(frozen=True)
class MotionClip:
    """A stretch of motion without a seam, in one body's coordinates.

    Attributes:
        name: of the clip, e.g. its file's stem.
        names: J joint coordinates, the body's `Body.coordinate_names`.
        rate: poses per second.
        roots: (N, 4, 4) T_world_root, m.
        q: (N, J) rad.
    """

    name: str
    names: tuple[str, ...]
    rate: float
    roots: Float
    q: Float

    def __post_init__(self) -> None:
        N = len(self.q)
        if self.q.shape != (N, len(self.names)) or self.roots.shape != (N, 4, 4):
            raise InputError(f"motion {self.name!r}: roots are {self.roots.shape} and q {self.q.shape}; N must agree.")
        if not N or not (np.all(np.isfinite(self.q)) and np.all(np.isfinite(self.roots))):
            raise InputError(f"motion {self.name!r}: it is empty or a coordinate is not finite.")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise InputError(f"motion {self.name!r}: its rate is {self.rate}; it must be positive.")

    def __len__(self) -> int:
        return len(self.q)

    def poses(self) -> list[Pose]:
        """N poses."""
        return [Pose(root, q) for root, q in zip(self.roots, self.q, strict=True)]

    def resampled(self, rate: float) -> MotionClip:
        """The same motion at another rate: joint angles linear, roots along the geodesics of SE(3)."""
        if not (np.isfinite(rate) and rate > 0):
            raise InputError(f"motion {self.name!r}: the new rate is {rate}; it must be positive.")
        at = np.arange(int(np.floor((len(self) - 1) * rate / self.rate + 1e-9)) + 1) * self.rate / rate
        low = np.minimum(at.astype(int), max(len(self) - 2, 0))
        high, share = np.minimum(low + 1, len(self) - 1), (at - low)[:, None]
        step = se3.log(se3.inverse(self.roots[low]) @ self.roots[high])
        roots = self.roots[low] @ se3.exp(share * step)
        return replace(self, rate=rate, roots=roots, q=(1 - share) * self.q[low] + share * self.q[high])
