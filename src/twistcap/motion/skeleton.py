"""`SkeletonMotion`: the content of a motion file of any format, before retargeting to a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.errors import check

Up = Literal["y", "z"]


@dataclass(frozen=True)
class SkeletonMotion:
    """N frames of a tree of S joints. A joint's segment is the bone that turns with it and has the joint's name.

    All is in the file's axes, in metres. In the rest pose every rotation is the identity.

    Attributes:
        joints, parents: S names and (S,) index of the joint above, -1 for the root; parents stand before children.
        offsets: (S, 3) from the parent joint in the rest pose, m; of the root, its place there.
        rotations: (N, S, 3, 3) world rotation of each segment from the rest pose.
        positions: (N, S, 3) world position of each joint, m.
        rate, up: frames per second, and the file's vertical axis.

    Raises InputError for wrong shapes, no frames, a bad rate, or values that are not finite.
    """

    name: str
    joints: tuple[str, ...]
    parents: Int
    offsets: Float
    rotations: Float
    positions: Float
    rate: float
    up: Up

    def __post_init__(self) -> None:
        where = f"motion {self.name!r}"
        N, S = len(self.rotations), len(self.joints)
        shapes = self.rotations.shape, self.positions.shape, self.offsets.shape
        check(where, shapes == ((N, S, 3, 3), (N, S, 3), (S, 3)), f"its arrays do not fit its {S} joints")
        check(where, N > 0, "it has no frames")
        check(where, 0 < self.rate < np.inf, f"its rate is {self.rate}; it must be positive")
        for values in (self.rotations, self.positions):
            if len(bad := np.argwhere(~np.isfinite(values))):
                check(where, False, f"{self.joints[bad[0, 1]]!r} is not finite in frame {bad[0, 0]}; fill or cut it")

    def __len__(self) -> int:
        return len(self.rotations)

    def __getitem__(self, frames: slice) -> SkeletonMotion:
        return replace(self, rotations=self.rotations[frames], positions=self.positions[frames])

    def resampled(self, rate: float) -> SkeletonMotion:
        """The same motion at another rate: rotations along geodesics, positions linear. Raises an InputError for a rate
        that is not positive."""
        check(f"motion {self.name!r}", 0 < rate < np.inf, f"the new rate is {rate}; it must be positive")
        last = len(self) - 1
        at = np.arange(int(np.floor(last * rate / self.rate + 1e-6)) + 1) * self.rate / rate
        low = np.minimum(at.astype(int), max(last - 1, 0))
        high, fraction = np.minimum(low + 1, last), np.clip(at - low, 0.0, 1.0)[:, None, None]
        R = self.rotations[low]
        step = se3.log_rotation(np.swapaxes(R, 2, 3) @ self.rotations[high])
        positions = (1 - fraction) * self.positions[low] + fraction * self.positions[high]
        return replace(self, rotations=R @ se3.exp_rotation(fraction * step), positions=positions, rate=rate)

    def rest_positions(self) -> Float:
        """(S, 3) joints in the rest pose, m."""
        return rest_positions(self.offsets, self.parents)

    @staticmethod
    def from_local(
        name: str, joints: Sequence[str], parents: Sequence[int], offsets: Float, local: Float, places: Float,
        rate: float, up: Up,
    ) -> SkeletonMotion:  # fmt: skip
        """Forward kinematics of each segment's rotation in its parent (`local`, N, S, 3, 3), the identity in the rest
        pose, and the root joint's places (N, 3), m."""
        rotations, positions = local.copy(), np.zeros(local.shape[:3])
        positions[:, 0] = places
        for s, parent in list(enumerate(parents))[1:]:
            rotations[:, s] = rotations[:, parent] @ local[:, s]
            positions[:, s] = positions[:, parent] + rotations[:, parent] @ offsets[s]
        where = np.asarray(parents, dtype=np.int32)
        return SkeletonMotion(name, tuple(joints), where, offsets, rotations, positions, rate, up)


def rest_positions(offsets: Float, parents: ArrayLike) -> Float:
    """(S, 3) joints in the rest pose; a root is at its own offset."""
    out = offsets.copy()
    for s, parent in enumerate(np.asarray(parents)):
        if parent >= 0:
            out[s] += out[parent]
    return out


def skeleton_of(body: Body, poses: Sequence[Pose], rate: float, name: str = "motion") -> SkeletonMotion:
    """The motion of a body, `rate` poses per second, as that of a skeleton: one joint per segment, z up."""
    origins, above = body.joint_origins, body.segment_parent
    offsets = origins - np.where(above[:, None] >= 0, origins[above], 0.0)
    T = np.array([Posed(body, pose).segment_transforms for pose in poses])
    positions = (T[..., :3, :3] @ origins[..., None])[..., 0] + T[..., :3, 3]
    return SkeletonMotion(name, body.segment_names, above, offsets, T[..., :3, :3], positions, rate, "z")
