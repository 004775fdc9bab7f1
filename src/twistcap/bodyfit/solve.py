"""One Gauss-Newton step of the poses of all frames and the shape that they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from twistcap._typing import Float, Int
from twistcap.body import Posed
from twistcap.body.shape import carried
from twistcap.bodyfit.fields import Fields
from twistcap.bodyfit.observe import Observed
from twistcap.camera import pinhole


@dataclass(frozen=True)
class Shape:
    """What may change in a step: fields, and offsets of each vertex along its direction where there are any.

    Attributes:
        fields: M parameters.
        directions: (V, 3), or (0, 3) without offsets.
        precision: (M + V, M + V) of the prior of all amounts.
    """

    fields: Fields
    directions: Float
    precision: Float

    @property
    def size(self) -> int:
        return len(self.precision)


@dataclass(frozen=True)
class Step:
    """What the solve asks for.

    Attributes:
        poses: (F, 6 + J) steps.
        shape: (M + V,) steps of the amounts.
        error_px: weighted root mean square of the distances before it.
    """

    poses: Float
    shape: Float
    error_px: float


@dataclass(frozen=True)
class Rows:
    """Derivatives of the N distances along the normals.

    Attributes:
        pose: (N, 6 + J) by the pose step.
        field: (N, M) by the amounts of the fields.
        vertex: (N, V) by the offsets of the vertices, two to a row; None without offsets.
    """

    pose: Float
    field: Float
    vertex: sparse.csr_array | None

    def times_shape(self, weighted: Float) -> Float:
        """(K, M + V) product of (K, N) weighted rows with those of the shape."""
        by_field = weighted @ self.field
        if self.vertex is None:
            return by_field
        return np.hstack([by_field, np.asarray((self.vertex.T @ weighted.T).T)])

    def add_to(self, H: Float, weight: Float) -> None:
        """Add the weighted square of the shape's rows to H (M + V, M + V)."""
        M = self.field.shape[1]
        weighted = self.field.T * weight
        H[:M, :M] += weighted @ self.field
        if self.vertex is None:
            return
        mixed = np.asarray(self.vertex.T @ weighted.T)
        H[M:, :M] += mixed
        H[:M, M:] += mixed.T
        squares = (self.vertex.T @ (self.vertex * weight[:, None])).tocoo()
        np.add.at(H, (M + squares.row, M + squares.col), squares.data)


def rows(posed: Posed, shape: Shape, seen: Observed) -> Rows:
    """Derivatives of the distances of one view."""
    points = seen.contour.points
    projected = pinhole(seen.camera.P, points.at(posed))[2]
    by_point = np.einsum("ni,nij->nj", seen.contour.normals, projected)
    by_pose = np.einsum("ni,nid->nd", by_point, posed.point_jacobian(points.segments, points.weights, points.local))
    turned = _rest_rows(posed, by_point, points.segments, points.weights)
    fields = shape.fields
    moved = np.einsum("ne,nemi->nmi", seen.shares, fields.by_vertex[seen.ends])
    by_field = np.einsum("ni,nmi->nm", turned, moved) + _joint_rows(posed, by_point, seen, fields.joints)
    if not len(shape.directions):
        return Rows(by_pose, by_field, None)
    along = np.einsum("ni,nei->ne", turned, shape.directions[seen.ends]) * seen.shares
    where = np.repeat(np.arange(len(along)), 2), seen.ends.ravel()
    size = len(along), len(shape.directions)
    return Rows(by_pose, by_field, sparse.csr_array((along.ravel(), where), shape=size))


def _rest_rows(posed: Posed, by_point: Float, segments: Int, weights: Float) -> Float:
    """The rows by motions in the rest pose, which skinning turns into the world."""
    R = np.einsum("nk,nkij->nij", weights, posed.segment_transforms[segments][..., :3, :3])
    return np.einsum("ni,nij->nj", by_point, R)


def _joint_rows(posed: Posed, by_point: Float, seen: Observed, joints: Float) -> Float:
    """(N, M) rows by shifts of the joint centres."""
    points, moved = seen.contour.points, carried(posed, joints).transpose(1, 0, 2)
    return np.einsum("nk,ni,nkmi->nm", points.weights, by_point, moved[points.segments])


def step(
    posed: Sequence[Posed], shape: Shape, amounts: Float, seen: Sequence[Sequence[Observed]],
    pulls: Sequence[tuple[Float, Float]], robust: float, share: float,
) -> Step:  # fmt: skip
    """Solve for all frames, the poses eliminated frame by frame.

    Args:
        posed: the body at the pose of each of F frames.
        amounts: (M + V,) of the shape so far, which its prior pulls back.
        seen: of each frame, its views.
        pulls: of each frame a gradient (6 + J,) and a precision of its pose apart from the images.
        robust: m at which a point begins to lose its say (Cauchy).
        share: of the points' information that counts; they are not independent.
    """
    H, g = shape.precision.copy(), shape.precision @ amounts
    solved: list[tuple[Float, Float]] = []
    squares = total = 0.0
    for at, views, (pull, hold) in zip(posed, seen, pulls, strict=True):
        A, b, cross = hold.copy(), pull.copy(), np.zeros((len(hold), shape.size))
        for view in views:
            by = rows(at, shape, view)
            scale = robust * view.px_per_m
            weight = share * view.weight / (1.0 + (view.distance / scale) ** 2)
            pose_weighted = by.pose.T * weight
            A += pose_weighted @ by.pose
            cross += by.times_shape(pose_weighted)
            by.add_to(H, weight)
            b -= pose_weighted @ view.distance
            g -= by.times_shape((weight * view.distance)[None])[0]
            squares += float(weight @ view.distance**2)
            total += float(weight.sum())
        known = np.asarray(np.linalg.solve(A, np.column_stack([cross, b])), np.float64)
        H -= cross.T @ known[:, :-1]
        g -= cross.T @ known[:, -1]
        solved.append((known[:, :-1], known[:, -1]))
    shape_step = -np.asarray(np.linalg.solve(H, g), np.float64)
    poses = np.array([-b - K @ shape_step for K, b in solved])
    return Step(poses, shape_step, float(np.sqrt(squares / max(total, 1e-12))))


def reshaped(shape: Shape, amounts: Float) -> tuple[Float, Float, Float]:
    """Motions of vertices, joints and landmarks for a step of the amounts (M + V,)."""
    M = len(shape.fields.names)
    vertices, joints, marks = shape.fields @ amounts[:M]
    if len(shape.directions):
        vertices = vertices + amounts[M:, None] * shape.directions
    return vertices, joints, marks
