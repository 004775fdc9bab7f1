"""`SkeletonMotion`: the content of a motion file of any format, before retargeting to a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.shape import joint_origin
from twistcap.errors import InputError

Up = Literal["y", "z"]


@dataclass(frozen=True)
class SkeletonMotion:
    """N frames of a tree of S joints. A joint's segment is the bone that turns with it and has the joint's name.

    All is in the file's axes, in metres. In the rest pose every rotation is the identity.

    Attributes:
        name: of the motion, e.g. its file's stem.
        joints: S names; parents stand before their children.
        parents: (S,) index of the joint above, -1 for the root.
        offsets: (S, 3) from the parent joint in the rest pose, m; of the root, its place there.
        rotations: (N, S, 3, 3) world rotation of each segment from the rest pose.
        positions: (N, S, 3) world position of each joint, m.
        rate: frames per second.
        up: the file's vertical axis.

    Raises:
        InputError: for wrong shapes, no frames, a bad rate, or values that are not finite.
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
        N, S = len(self.rotations), len(self.joints)
        if self.rotations.shape != (N, S, 3, 3) or self.positions.shape != (N, S, 3) or self.offsets.shape != (S, 3):
            raise InputError(f"motion {self.name!r}: its arrays do not fit its {S} joints.")
        if not N:
            raise InputError(f"motion {self.name!r}: it has no frames.")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise InputError(f"motion {self.name!r}: its rate is {self.rate}; it must be positive.")
        for values in (self.rotations, self.positions):
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                frame, joint = int(bad[0][0]), self.joints[bad[0][1]]
                raise InputError(f"motion {self.name!r}: {joint!r} is not finite in frame {frame}; fill or cut it.")

    def __len__(self) -> int:
        return len(self.rotations)

    def __getitem__(self, frames: slice) -> SkeletonMotion:
        return replace(self, rotations=self.rotations[frames], positions=self.positions[frames])

    def resampled(self, rate: float) -> SkeletonMotion:
        """The same motion at another rate: rotations along geodesics, positions linear.

        Raises:
            InputError: for a rate that is not positive.
        """
        if not (np.isfinite(rate) and rate > 0):
            raise InputError(f"motion {self.name!r}: the new rate is {rate}; it must be positive.")
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
        out = self.offsets.copy()
        for s, parent in enumerate(self.parents):
            if parent >= 0:
                out[s] += out[parent]
        return out

    @classmethod
    def from_local(
        cls,
        name: str,
        joints: Sequence[str],
        parents: Sequence[int],
        offsets: Float,
        local: Float,
        places: Float,
        rate: float,
        up: Up,
    ) -> SkeletonMotion:
        """Forward kinematics.

        Args:
            name, joints, parents, offsets, rate, up: as in the class.
            local: (N, S, 3, 3) rotation of each segment in its parent; the identity in the rest pose.
            places: (N, 3) of the root joint, m.
        """
        rotations, positions = local.copy(), np.zeros(local.shape[:3])
        positions[:, 0] = places
        for s in range(1, len(joints)):
            parent = parents[s]
            rotations[:, s] = rotations[:, parent] @ local[:, s]
            positions[:, s] = positions[:, parent] + rotations[:, parent] @ offsets[s]
        where = np.asarray(parents, dtype=np.int32)
        return cls(name, tuple(joints), where, offsets, rotations, positions, rate, up)


def skeleton_of(body: Body, poses: Sequence[Pose], rate: float, name: str = "motion") -> SkeletonMotion:
    """The motion of a body as that of a skeleton: one joint per segment, z up, the body's rest pose.

    Args:
        body: of the poses.
        poses: N poses.
        rate: per second.
        name: of the motion.
    """
    origins = np.array([joint_origin(body, s) for s in range(len(body.segment_names))])
    above = body.segment_parent
    offsets = origins - np.where(above[:, None] >= 0, origins[above], 0.0)
    T = np.array([Posed(body, pose).segment_transforms for pose in poses])
    positions = (T[..., :3, :3] @ origins[..., None])[..., 0] + T[..., :3, 3]
    return SkeletonMotion(name, body.segment_names, above, offsets, T[..., :3, :3], positions, rate, "z")
