"""Poses and forward kinematics: product of exponentials, world twists, skinning and Jacobians.

``X' = M exp(θ₁ξ̂₁) … exp(θ_jξ̂_j) X`` (Bregler and Malik, DOI 10.1109/CVPR.1998.698581; Rosenhahn, Brox and Seidel,
DOI 10.1109/CVPR.2007.383128, eq. 12). Derivatives at a pose are the world twists applied to the world point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from twistcap import se3
from twistcap._typing import Float, Int
from twistcap.body.model import Body


@dataclass(frozen=True)
class Pose:
    """Root motion (4, 4) and joint coordinates q (J,) in rad."""

    root: Float
    q: Float

    @staticmethod
    def rest(body: Body) -> Pose:
        return Pose(np.eye(4), np.zeros(len(body.coordinate_names)))

    def retract(self, delta: Float) -> Pose:
        """The pose after a step (6 + J,): ``root <- exp(δξ) root`` (world frame), ``q <- q + δq``."""
        return Pose(se3.orthonormalised(se3.exp(delta[:6]) @ self.root), self.q + delta[6:])

    def minus(self, other: Pose) -> Float:
        """The step (6 + J,) that `retract` needs to come from `other` to this pose."""
        return np.concatenate([se3.log_one(self.root @ se3.inverse(other.root)), self.q - other.q])


@dataclass(frozen=True)
class Posed:
    """A body at a pose, forward kinematics done. All in world coordinates, m."""

    body: Body
    pose: Pose

    @cached_property
    def joint_transforms(self) -> Float:
        """(J, 4, 4) motion of everything below each coordinate, rest to world."""
        return _chain(self.pose.root, self.body.twists, self.body.parent, self.pose.q)

    @cached_property
    def segment_transforms(self) -> Float:
        """(S, 4, 4) motion of each segment, rest to world."""
        all_motions = np.concatenate([self.joint_transforms, self.pose.root[None]])
        return np.ascontiguousarray(all_motions[self.body.segment_joint])  # -1 picks the root

    @cached_property
    def world_twists(self) -> Float:
        """(J, 6) ``ξ'_k = Ad_{M g₁…g_{k−1}} ξ_k``; g_k leaves its own twist as it is, so its motion may stand in."""
        return (se3.adjoint(self.joint_transforms) @ self.body.twists[..., None])[..., 0]

    @cached_property
    def vertices(self) -> Float:
        """(V, 3) skinned surface."""
        body = self.body
        return skin_points(self.segment_transforms, body.skin_segments, body.skin_weights, body.vertices)

    @cached_property
    def landmarks(self) -> Float:
        """(L, 3) the body's landmarks."""
        marks = self.body.landmarks
        T = self.segment_transforms[marks.segments]
        return (T[:, :3, :3] @ marks.points[..., None])[..., 0] + T[:, :3, 3]

    @cached_property
    def projector(self) -> Float:
        """(6 S, 6 + J) from a pose step to the world twist of every segment, stacked by segment."""
        blocks = np.zeros((len(self.body.segment_names), 6, self.body.dof))
        blocks[:, :, :6] = np.eye(6)
        blocks[:, :, 6:] = self.body.chain[:, None, :] * self.world_twists.T[None]
        return blocks.reshape(-1, self.body.dof)

    def points(self, segments: Int, weights: Float, local: Float) -> Float:
        """World positions (N, 3) of surface points given as (N, K) segments and weights and (N, 3) rest points."""
        return skin_points(self.segment_transforms, segments, weights, local)

    def point_jacobian(self, segments: Int, weights: Float, local: Float) -> Float:
        """(N, 3, 6 + J) derivative of `points` by the pose step. The readable twin of the accumulation kernels."""
        T = self.segment_transforms[segments]
        carried = (T[..., :3, :3] @ local[:, None, :, None])[..., 0] + T[..., :3, 3]
        by_twist = np.concatenate([-se3.hat(carried), np.broadcast_to(np.eye(3), (*carried.shape, 3))], axis=-1)
        blocks = self.projector.reshape(-1, 6, self.body.dof)[segments]
        return np.einsum("nk,nkij,nkjd->nid", weights, by_twist, blocks)


@njit(cache=True)
def _chain(root: Float, twists: Float, parent: Int, q: Float) -> Float:
    """Motions (J, 4, 4) of all coordinates; see `chain_reference`."""
    J = len(q)
    out = np.zeros((J, 4, 4))
    g = np.zeros((3, 4))
    for k in range(J):
        before = root if parent[k] < 0 else out[parent[k]]
        w0, w1, w2, v0, v1, v2 = twists[k]
        angle = q[k] * np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
        if angle == 0.0:
            a, b, c = 1.0, 0.5, 1.0 / 6.0
        elif abs(angle) < 1e-3:
            a, b, c = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
        else:
            a, b = np.sin(angle) / angle, 2.0 * np.sin(0.5 * angle) ** 2 / angle**2
            c = (1.0 - a) / angle**2
        W = np.array([[0.0, -w2, w1], [w2, 0.0, -w0], [-w1, w0, 0.0]]) * q[k]
        W2 = W @ W
        for i in range(3):
            for j in range(3):
                g[i, j] = a * W[i, j] + b * W2[i, j] + (1.0 if i == j else 0.0)
            g[i, 3] = 0.0
            for j in range(3):
                v = (v0 if j == 0 else (v1 if j == 1 else v2)) * q[k]
                g[i, 3] += (b * W[i, j] + c * W2[i, j] + (1.0 if i == j else 0.0)) * v
        for i in range(3):
            for j in range(4):
                s = before[i, 3] if j == 3 else 0.0
                for m in range(3):
                    s += before[i, m] * g[m, j]
                out[k, i, j] = s
        out[k, 3, 3] = 1.0
    return out


def chain_reference(root: Float, twists: Float, parent: Int, q: Float) -> Float:
    """Readable twin of the kinematics kernel: the product of exponentials, one coordinate after the other."""
    out: list[Float] = []
    for k, angle in enumerate(q):
        before = root if parent[k] < 0 else out[parent[k]]
        out.append(before @ se3.exp(angle * twists[k]))
    return np.array(out).reshape(-1, 4, 4)


@njit(cache=True, nogil=True)
def skin_points(transforms: Float, segments: Int, weights: Float, local: Float) -> Float:
    """Linear-blend skinning: Σ_k w_k T_k x. (S, 4, 4), (N, K), (N, K), (N, 3) -> (N, 3)."""
    N, K = segments.shape
    out = np.zeros((N, 3))
    for n in range(N):
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        for k in range(K):
            w = weights[n, k]
            if w == 0.0:
                continue
            T = transforms[segments[n, k]]
            for i in range(3):
                out[n, i] += w * (T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3])
    return out


def skin_points_reference(transforms: Float, segments: Int, weights: Float, local: Float) -> Float:
    """Readable twin of `skin_points`."""
    T = transforms[segments]
    carried = (T[..., :3, :3] @ local[:, None, :, None])[..., 0] + T[..., :3, 3]
    return np.einsum("nk,nki->ni", weights, carried)
