"""Poses and forward kinematics: product of exponentials, world twists, skinning and Jacobians.

``X' = M exp(θ₁ξ̂₁) … exp(θ_jξ̂_j) X`` (Bregler and Malik, DOI 10.1109/CVPR.1998.698581; Rosenhahn, Brox and Seidel,
DOI 10.1109/CVPR.2007.383128, eq. 12). Derivatives at a pose are the world twists applied to the world point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap import se3
from twistcap._cached import cached
from twistcap.arrays import Bool, Float, Int
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
        return Pose(se3.compose_one(se3.exp_one(delta[:6]), self.root), self.q + delta[6:])

    def minus(self, other: Pose) -> Float:
        """The step (6 + J,) that `retract` needs to come from `other` to this pose."""
        return np.concatenate([se3.difference_one(self.root, other.root), self.q - other.q])

    def within(self, limits: Float) -> Pose:
        """The pose with its joints inside their limits (J, 2), rad."""
        return Pose(self.root, np.clip(self.q, limits[:, 0], limits[:, 1]))


@dataclass(frozen=True)
class Posed:
    """A body at a pose, forward kinematics done. All in world coordinates, m."""

    body: Body
    pose: Pose

    @cached
    def joint_transforms(self) -> Float:
        """(J, 4, 4) motion of everything below each coordinate, rest to world."""
        return _chain(self.pose.root, self.body.twists, self.body.parent, self.pose.q)

    @cached
    def segment_transforms(self) -> Float:
        """(S, 4, 4) motion of each segment, rest to world."""
        return np.concatenate([self.joint_transforms, self.pose.root[None]])[self.body.segment_joint]  # -1: the root's

    @cached
    def world_twists(self) -> Float:
        """(J, 6) ``ξ'_k = Ad_{M g₁…g_{k−1}} ξ_k = Ad_{M g₁…g_k} ξ_k``."""
        return _carried_twists(self.joint_transforms, self.body.twists)

    @cached
    def vertices(self) -> Float:
        """(V, 3) skinned surface."""
        body = self.body
        return skin_points(self.segment_transforms, body.skin_segments, body.skin_weights, body.vertices)

    @cached
    def vertex_normals(self) -> Float:
        """(V, 3) outward normals of the surface, of length 6 times the area about each vertex."""
        return vertex_normals(self.vertices, self.body.faces)

    @cached
    def landmarks(self) -> Float:
        """(L, 3) landmarks."""
        marks = self.body.landmarks
        return _carried(self.segment_transforms[marks.segments], marks.points)

    @cached
    def segment_middles(self) -> Float:
        """(S, 3) middle of each segment's own surface; of the whole body's where it has none."""
        return _carried(self.segment_transforms, self.body.segment_middles)

    @cached
    def projector(self) -> Float:
        """(6 S, 6 + J) from a pose step to the world twist of every segment, stacked by segment."""
        return _projector(self.body.chain, self.world_twists)

    def points(self, segments: Int, weights: Float, local: Float) -> Float:
        """World positions (N, 3) of surface points with segments and weights (N, K) and rest points (N, 3)."""
        return skin_points(self.segment_transforms, segments, weights, local)

    def point_jacobian(self, segments: Int, weights: Float, local: Float) -> Float:
        """(N, 3, 6 + J) derivative of `points` by the pose step. The readable twin of the accumulation kernels."""
        T = self.segment_transforms[segments]
        carried = _carried(T, local[:, None, :])
        by_twist = np.concatenate([-se3.hat(carried), np.broadcast_to(np.eye(3), (*carried.shape, 3))], axis=-1)
        blocks = self.projector.reshape(-1, 6, self.body.dof)[segments]
        return np.einsum("nk,nkij,nkjd->nid", weights, by_twist, blocks)


def _carried(T: Float, points: Float) -> Float:
    """Points (..., 3) after the motions (..., 4, 4)."""
    return (T[..., :3, :3] @ points[..., None])[..., 0] + T[..., :3, 3]


@njit(cache=True, nogil=True)
def _chain(root: Float, twists: Float, parent: Int, q: Float) -> Float:
    """Motions (J, 4, 4) of all coordinates; see `chain_reference`."""
    out = np.zeros((len(q), 4, 4))
    for k in range(len(q)):
        before = root if parent[k] < 0 else out[parent[k]]
        g = se3.exp_one(q[k] * twists[k])
        for i in range(3):
            for j in range(4):
                out[k, i, j] = before[i, 0] * g[0, j] + before[i, 1] * g[1, j] + before[i, 2] * g[2, j]
            out[k, i, 3] += before[i, 3]
        out[k, 3, 3] = 1.0
    return out


@njit(cache=True, nogil=True)
def _carried_twists(motions: Float, twists: Float) -> Float:
    """(J, 6) ``Ad_T ξ`` of each: `se3.adjoint` without its matrices."""
    out = np.empty_like(twists)
    for k in range(len(twists)):
        T, xi = motions[k], twists[k]
        for i in range(3):
            out[k, i] = T[i, 0] * xi[0] + T[i, 1] * xi[1] + T[i, 2] * xi[2]
            out[k, 3 + i] = T[i, 0] * xi[3] + T[i, 1] * xi[4] + T[i, 2] * xi[5]
        out[k, 3] += T[1, 3] * out[k, 2] - T[2, 3] * out[k, 1]
        out[k, 4] += T[2, 3] * out[k, 0] - T[0, 3] * out[k, 2]
        out[k, 5] += T[0, 3] * out[k, 1] - T[1, 3] * out[k, 0]
    return out


@njit(cache=True, nogil=True)
def _projector(chain: Bool, world_twists: Float) -> Float:
    """(6 S, 6 + J) identity for the root, and the twists of the coordinates that move each segment."""
    S, J = chain.shape
    out = np.zeros((6 * S, 6 + J))
    for s in range(S):
        for i in range(6):
            out[6 * s + i, i] = 1.0
            for k in range(J):
                if chain[s, k]:
                    out[6 * s + i, 6 + k] = world_twists[k, i]
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
    return np.einsum("nk,nki->ni", weights, _carried(T, local[:, None, :]))


@njit(cache=True, nogil=True)
def points_at(base: Float, twists: Float, parent: Int, q: Float, joints: Int, weights: Float, local: Float) -> Float:
    """(M, N, 3) surface points at M sets (M, J) of a branch's coordinates, which hangs on a base (4, 4).

    Points have the coordinates (N, K) that move them, −1 for the base, their weights (N, K) and rest places (N, 3).
    """
    out, J = np.empty((len(q), len(joints), 3)), len(twists)
    moved = joints % (J + 1)  # the base is the last
    transforms = np.empty((J + 1, 4, 4))
    transforms[J] = base
    for m in range(len(q)):
        transforms[:J] = _chain(base, twists, parent, q[m])
        out[m] = skin_points(transforms, moved, weights, local)
    return out


def points_at_reference(
    base: Float, twists: Float, parent: Int, q: Float, joints: Int, weights: Float, local: Float
) -> Float:
    """Readable twin of `points_at`."""
    out: list[Float] = []
    for each in q:
        transforms = np.concatenate([chain_reference(base, twists, parent, each), base[None]])
        out.append(skin_points_reference(transforms, joints, weights, local))
    return np.array(out)


def unit_vertex_normals(vertices: Float, faces: Int) -> Float:
    """(V, 3) outward unit normals, the mean of the adjoining triangles weighted by their area."""
    normals = vertex_normals(vertices, faces)
    return normals / np.maximum(np.sqrt((normals * normals).sum(axis=1, keepdims=True)), 1e-12)


@njit(cache=True, nogil=True)
def vertex_normals(vertices: Float, faces: Int) -> Float:
    """(V, 3) area-weighted outward normals, not normalised."""
    out = np.zeros_like(vertices)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        wx, wy, wz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        for v in (a, b, c):
            out[v, 0] += nx
            out[v, 1] += ny
            out[v, 2] += nz
    return out


def vertex_normals_reference(vertices: Float, faces: Int) -> Float:
    """Readable twin of `vertex_normals`."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    out = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(out, faces[:, i], normals)
    return out
