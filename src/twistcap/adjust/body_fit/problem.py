"""Poses of some frames and the shape of the body in all of them as one problem, around the poses observed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from twistcap.adjust.body_fit import fields as f
from twistcap.adjust.body_fit.fields import Build, Fields
from twistcap.adjust.body_fit.observe import Observed
from twistcap.adjust.body_fit.symmetry import alike
from twistcap.arrays import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.kinematics import unit_vertex_normals
from twistcap.body.shape import carried
from twistcap.render.view import surface_points
from twistcap.solve import Arrow
from twistcap.terms.points import projected_rows
from twistcap.terms.robust import cauchy

# Standard deviations of the prior, chosen on the studio and `balance_4view` (docs/concepts/body-fit.md).
_JOINT, _JOINT_SIDE = 0.002, 0.001  # m, shifts of joint centres: of both sides alike, and of each side alone
_OFFSET, _REACH = 0.006, 0.10  # m, offsets of the surface along its normals, and the distance over which they are alike
_APART = 1.0 / 3.0  # of that, for what the sides do not have in common
_TURN_DEG = 0.1  # turn of a segment's surface against the axes of its joint, which no image shows
_POSE_DEG, _POSE_M = 3.0, 0.02  # change of a pose from the tracked one
_OFFSET_BOUND = 0.03  # m, greatest offset of a vertex along its normal
_ROBUST = 0.012  # m, distance at which a contour point is down-weighted by half
# All frames together count as so many frames of independent contour points: neighbours, and frames of one person
# before one background, err alike.
_WORTH = 1.0


@dataclass(frozen=True)
class Freedom:
    """What may change of the body `given` at the start: its build, joint centres, and with `offsets` every vertex."""

    given: Body
    build: Build
    offsets: bool

    @cached_property
    def turns(self) -> Float:
        """(3 S, V, 3) rotation of each segment's surface per motion of each vertex, of the body given."""
        return f.turns(self.given)

    @cached_property
    def offset_precision(self) -> Float:
        """(V, V) of the offsets, or (0, 0)."""
        if not self.offsets:
            return np.zeros((0, 0))
        return alike(f.offset_precision(self.given, _OFFSET, _REACH), self.given, _APART).toarray()


@dataclass(frozen=True)
class Sculpted:
    """The variables: the poses of all frames, and the body with its parameters.

    These are `amounts` of the M fields by their names, and `offsets` (V,) m of the vertices along their normals, empty
    where they are not free.
    """

    freedom: Freedom
    body: Body
    poses: tuple[Pose, ...]
    amounts: Mapping[str, float]
    offsets: Float

    @cached_property
    def posed(self) -> list[Posed]:
        """The body in every frame."""
        return [Posed(self.body, pose) for pose in self.poses]

    @cached_property
    def own(self) -> Fields:
        """The build's own fields."""
        return self.freedom.build.fields(self.body, self.amounts)

    @cached_property
    def fields(self) -> Fields:
        """The build's fields, and shifts of the joint centres."""
        return self.own + f.joint_fields(self.body, _JOINT, _JOINT_SIDE)

    @cached_property
    def directions(self) -> Float:
        """(V, 3) directions of the vertices' offsets, the outward normals at rest, or (0, 3)."""
        return unit_vertex_normals(self.body.vertices, self.body.faces)[: len(self.offsets)]

    @cached_property
    def values(self) -> Float:
        """(M + V,) amounts and offsets."""
        return np.concatenate([[self.amounts.get(name, 0.0) for name in self.fields.names], self.offsets])

    @cached_property
    def precision(self) -> Float:
        """(M + V, M + V) of the prior of all values; a segment's surface keeps its direction about its joint."""
        free, M, K = self.freedom, len(self.fields.names), len(self.own.names)
        out = np.zeros((len(self.values), len(self.values)))
        out[:M, :M], out[M:, M:] = self.fields.precision, free.offset_precision
        turned = np.tensordot(free.turns, self.fields.vertices, ([1, 2], [1, 2]))
        turned[:, :K] *= free.build.rigid
        if free.offsets:
            turned = np.hstack([turned, np.einsum("tvi,vi->tv", free.turns, self.directions)])
        return out + turned.T @ turned / np.deg2rad(_TURN_DEG) ** 2

    @cached_property
    def motions(self) -> sparse.csr_array:
        """(3 V, M + V) of the vertices by all values."""
        by_field = sparse.csr_array(self.fields.vertices.reshape(len(self.fields.names), -1).T)
        if not (V := len(self.offsets)):
            return by_field
        where = np.arange(3 * V), np.repeat(np.arange(V), 3)
        along = sparse.coo_array((self.directions.ravel(), where), shape=(3 * V, V))
        return sparse.csr_array(sparse.hstack([by_field, along]))

    def joint_motions(self, posed: Posed) -> Float:
        """(6 S, M) twist of each segment in a frame where joint centres move: a joint carries all below it."""
        out = np.zeros((len(self.body.segment_names), 6, len(self.fields.names)))
        out[:, 3:] = carried(posed, self.fields.joints).transpose(1, 2, 0)
        return out.reshape(-1, out.shape[2])

    def reshaped(self, step: Float) -> Sculpted:
        """The body after a step (M + V,) of its shape, inside the bounds."""
        names, K, M = self.fields.names, len(self.own.names), len(self.fields.names)
        change, built = self.freedom.build.moved(self.own, self.values[:K], step[:K])
        offsets = np.clip(self.offsets + step[M:], -_OFFSET_BOUND, _OFFSET_BOUND)
        joints = self.fields @ np.concatenate([np.zeros(K), step[K:M]])
        vertices, *moved = (a + b for a, b in zip(built, joints, strict=True))
        if len(offsets):
            vertices = vertices + (offsets - self.offsets)[:, None] * self.directions
        amounts = self.values[:M] + np.concatenate([change, step[K:M]])
        body = f.deformed(self.body, vertices, *moved)
        return replace(self, body=body, amounts=dict(zip(names, amounts.tolist(), strict=True)), offsets=offsets)


@dataclass(frozen=True)
class FitProblem:
    """Distances to the edges seen in each frame's views, Gaussians about the tracked poses, and the prior of the shape
    of a `precision` (M + V, M + V)."""

    seen: Sequence[Sequence[Observed]]
    tracked: Sequence[Pose]
    precision: Float

    def energies(self, x: Sculpted) -> dict[str, float]:
        """Energies by term."""
        contour = sum(self._energy(at, view) for at, views in zip(x.posed, self.seen, strict=True) for view in views)
        change = [pose.minus(expected) for pose, expected in zip(x.poses, self.tracked, strict=True)]
        pose = 0.5 * sum(float(step @ (_hold(len(step)) * step)) for step in change)
        return {"contour": contour, "pose": pose, "shape": 0.5 * float(x.values @ self.precision @ x.values)}

    def linearised(self, x: Sculpted) -> Arrow:
        """The quadratic of all poses' steps and the shape's."""
        D, V, hold = x.body.dof, len(x.body.vertices), _hold(x.body.dof)
        arrow = Arrow(len(x.poses), D, len(x.values), 0)
        arrow.value, arrow.shared_longest = sum(self.energies(x).values()), np.inf
        squares, pull = sparse.csr_array((3 * V, 3 * V)), np.zeros(3 * V)
        for t, (at, views) in enumerate(zip(x.posed, self.seen, strict=True)):
            arrow.add_pose(t, hold * at.pose.minus(self.tracked[t]), np.diag(hold))
            if views:
                distances, by = [self._distance(at, view) for view in views], rows(at, views)
                weight = np.concatenate([self._weight(*pair) for pair in zip(views, distances, strict=True)])
                distance = np.concatenate(distances)
                self._add_frame(arrow, t, x, by, (weight, distance))
                squares += by[1].T @ (by[1] * weight[:, None])
                pull -= by[1].T @ (weight * distance)
        arrow.corner += (x.motions.T @ (squares @ x.motions)).toarray() + self.precision
        arrow.shared_pull += x.motions.T @ pull + self.precision @ x.values
        return arrow

    def retract(self, x: Sculpted, step: Float) -> Sculpted:
        """Poses and body after a step, inside joint limits and bounds."""
        D, limits = x.body.dof, x.body.limits
        poses = tuple(p.retract(step[t * D : (t + 1) * D]).within(limits) for t, p in enumerate(x.poses))
        return replace(x.reshaped(step[len(poses) * D :]), poses=poses)

    def error_px(self) -> float:
        """Weighted root mean square distance to the edges when they were observed, px."""
        squares = total = 0.0
        for view in (view for views in self.seen for view in views):
            weight = self._weight(view, view.distance)
            squares, total = squares + float(weight @ view.distance**2), total + float(weight.sum())
        return float(np.sqrt(squares / max(total, 1e-12)))

    def _add_frame(self, arrow: Arrow, t: int, x: Sculpted, by: Rows, weighing: tuple[Float, Float]) -> None:
        """Add all products except those of the vertices with themselves, which are the same in all frames."""
        (weight, distance), (by_twist, by_vertex), at = weighing, by, x.posed[t]
        weighted = by_twist * weight[:, None]
        twists, pull = (weighted.T @ by_twist).toarray(), -(weighted.T @ distance)
        P, joints, M = at.projector, x.joint_motions(at), len(x.fields.names)
        by_value = (weighted.T @ by_vertex @ x.motions).toarray()
        arrow.add_pose(t, P.T @ pull, P.T @ twists @ P)
        arrow.border[t] += P.T @ by_value
        arrow.border[t, :, :M] += P.T @ (twists @ joints)
        crossed = joints.T @ by_value
        arrow.corner[:M, :M] += joints.T @ twists @ joints
        arrow.corner[:M] += crossed
        arrow.corner[:, :M] += crossed.T
        arrow.shared_pull[:M] += joints.T @ pull

    def _distance(self, at: Posed, view: Observed) -> Float:
        """(N,) px from the points outward to the edges."""
        points = surface_points(at.body, view.ends, view.shares)
        moved, _ = projected_rows(view.camera.P, points.at(at), view.contour.normals, view.contour.pixels)
        return view.distance - moved

    def _weight(self, view: Observed, distance: Float) -> Float:
        """(N,) information of each point, 1/px²."""
        _, robust = cauchy(distance, _ROBUST * view.px_per_m)
        return _WORTH / len(self.seen) * view.weight * robust

    def _energy(self, at: Posed, view: Observed) -> float:
        energy, _ = cauchy(self._distance(at, view), _ROBUST * view.px_per_m)
        return _WORTH / len(self.seen) * float(view.weight @ energy)


def _hold(dof: int) -> Float:
    """(6 + J,) precision of a pose about the tracked one."""
    sigma = np.full(dof, np.deg2rad(_POSE_DEG))
    sigma[3:6] = _POSE_M
    return sigma**-2.0


Rows = tuple[sparse.csr_array, sparse.csr_array]


def rows(posed: Posed, views: Sequence[Observed]) -> Rows:
    """Derivatives of the N distances along the image normals in all views of one frame.

    They are (N, 6 S) by the twists of the segments that carry a point, and (N, 3 V) by the motions in the rest pose of
    the two vertices of its edge. Skeleton and fields are applied once, to the sums of a frame.
    """
    twist, segments, turned, ends = zip(*(_of_view(posed, view) for view in views), strict=True)
    by_twist = _sparse(np.concatenate(segments), np.concatenate(twist), len(posed.body.segment_names))
    return by_twist, _sparse(np.concatenate(ends), np.concatenate(turned), len(posed.body.vertices))


def _of_view(posed: Posed, seen: Observed) -> tuple[Float, Int, Float, Int]:
    """Derivatives (N, K, 6) by the twists of segments (N, K), and (N, 2, 3) by the motions of vertices (N, 2)."""
    points = surface_points(posed.body, seen.ends, seen.shares)
    _, gradient = projected_rows(seen.camera.P, points.at(posed), seen.contour.normals, seen.contour.pixels)
    T = posed.segment_transforms[points.segments]
    carried = np.einsum("nkij,nj->nki", T[..., :3, :3], points.local) + T[..., :3, 3]
    pull = points.weights[..., None] * gradient[:, None]
    turned = np.einsum("nki,nkij->nj", pull, T[..., :3, :3])
    twist = np.concatenate([np.cross(carried, pull), pull], axis=2)
    return twist, points.segments, seen.shares[..., None] * turned[:, None], seen.ends


def _sparse(which: Int, values: Float, count: int) -> sparse.csr_array:
    """(N, w count) of values (N, K, w) of items (N, K) out of `count`; values of one item are summed."""
    N, K, w = values.shape
    columns = which[..., None] * w + np.arange(w)
    row = np.repeat(np.arange(N), K * w)
    return sparse.coo_array((values.ravel(), (row, columns.ravel())), shape=(N, count * w)).tocsr()
