"""Parameters of a body's shape: each is a field of motions of its vertices, joints and landmarks.

They hold in the rest pose and are linear, so that one least-squares solve weighs them against one another. `deformed`
makes the step; the fields are then computed again on the new body.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

from twistcap import se3
from twistcap.adjust.first_pose import girth_groups
from twistcap.arrays import Float, Int
from twistcap.body import Body
from twistcap.body.model import Landmarks
from twistcap.body.shape import joints_shifted, marks_of, rescaled, segment_axes
from twistcap.ranges import Checked, Count, Positive

_ALIKE = 1.5  # knots, length of the correlation of two factors of cross-sections
_STEP = 1e-4  # of the difference quotients by log-factors
_SIDES = (0.0, 0.5, 1.0, 1.5)  # directions about a segment's axis, in half turns, in which a cross-section is scaled

Motions = tuple[Float, Float, Float]
"""Of vertices (V, 3), joint centres (S, 3) and landmarks (L, 3) in the rest pose, m."""


@dataclass(frozen=True)
class Fields:
    """M shape parameters, by name such as ``length femur``, and their motions per unit, m in the rest pose.

    They are those of vertices (M, V, 3), joint centres (M, S, 3; those of root segments do not count) and landmarks
    (M, L, 3). `precision` (M, M) is that of the prior, about the body at the start of the fit.
    """

    names: tuple[str, ...]
    vertices: Float
    joints: Float
    landmarks: Float
    precision: Float

    def __add__(self, other: Fields) -> Fields:
        pairs = zip(self.motions, other.motions, strict=True)
        precision = np.asarray(block_diag(self.precision, other.precision), np.float64)
        vertices, joints, landmarks = (np.concatenate(pair) for pair in pairs)
        return Fields((*self.names, *other.names), vertices, joints, landmarks, precision)

    def __matmul__(self, amounts: Float) -> Motions:
        """For amounts (M,)."""
        a, b, c = (np.tensordot(amounts, field, 1) for field in self.motions)
        return a, b, c

    @property
    def motions(self) -> Motions:
        """Of vertices, joints and landmarks."""
        return self.vertices, self.joints, self.landmarks


def places_of(body: Body) -> Motions:
    """Vertices, joint centres and landmarks in the rest pose."""
    return body.vertices, body.joint_origins, body.landmarks.points


def deformed(body: Body, vertices: Float, joints: Float, landmarks: Float) -> Body:
    """The body with its vertices (V, 3), joint centres (S, 3) and landmarks (L, 3) moved, m; axes stay parallel."""
    twists, marks = joints_shifted(body, dict(enumerate(joints))), body.landmarks
    marks = Landmarks(marks.names, marks.segments, marks.points + landmarks)
    return replace(body, vertices=body.vertices + vertices, twists=twists, landmarks=marks)


def stretch_fields(body: Body, stature: float, length: float, girth: float) -> Fields:
    """Log-stature, and log-length and log-girth of each kind of segment, left and right alike.

    The girths move the joints of a segment too (hips of the pelvis, shoulders of the torso). `stature`, `length` and
    `girth` are standard deviations.
    """
    step = float(np.exp(_STEP))
    out = [("stature", rescaled(body, stature=step), stature)]
    for kind, segments in girth_groups(body).items():
        factors = dict.fromkeys(segments, step)
        out.append((f"length {kind}", rescaled(body, lengths=factors), length))
        out.append((f"girth {kind}", rescaled(body, girths=factors), girth))
    names, bodies, sigmas = zip(*out, strict=True)
    pairs = zip(places_of(body), zip(*map(places_of, bodies), strict=True), strict=True)
    vertices, joints, marks = (np.array([there - here for there in moved]) / _STEP for here, moved in pairs)
    return Fields(names, vertices, joints, marks, np.diag(np.power(sigmas, -2.0)))


def profile_fields(body: Body, sigma: float, knots: int) -> Fields:
    """Factors of the cross-sections along each kind of segment, in four directions about its axis.

    Hat functions interpolate between the knots along each segment and directions; left is the mirror of right. `sigma`
    is the standard deviation of a factor less 1.
    """
    names, moved, precision = list[str](), list[Float](), list[Float]()
    inverse = np.asarray(np.linalg.inv(sigma**2 * _alike(knots)), np.float64)
    for kind, segments in girth_groups(body).items():
        sections = [_sections(body, body.segment(s), knots) for s in segments]
        for k, side in np.ndindex(knots, len(_SIDES)):
            names.append(f"section {kind} {k} {side}")
            moved.append(np.sum([section[k, side] for section in sections], axis=0))
        precision.append(inverse)
    still = np.zeros((len(names), len(body.segment_names), 3)), np.zeros((len(names), *body.landmarks.points.shape))
    return Fields(tuple(names), np.array(moved), *still, np.asarray(block_diag(*precision), np.float64))


def _alike(knots: int) -> Float:
    """(K 4, K 4) correlation of the factors of one segment's knots and directions."""
    along = np.exp(-0.5 * ((np.arange(knots)[:, None] - np.arange(knots)) / _ALIKE) ** 2)
    turn = np.abs(np.subtract.outer(_SIDES, _SIDES))
    around = np.exp(-np.minimum(turn, 2.0 - turn))
    return np.kron(along, around) + 1e-3 * np.eye(knots * len(_SIDES))


def _sections(body: Body, segment: int, knots: int) -> Float:
    """(K, 4, V, 3) outward motion of the vertices for each knot and direction of one segment, by its skin weights."""
    origins, axes = segment_axes(body)
    axis = axes[segment]
    weight = np.where(body.skin_segments == segment, body.skin_weights, 0.0).sum(axis=1)
    own = body.vertex_part == segment
    if not own.any():
        return np.zeros((knots, len(_SIDES), *body.vertices.shape))
    centre = body.vertices[own].mean(axis=0)
    across = body.vertices - centre - np.outer((body.vertices - centre) @ axis, axis)
    height = (body.vertices - origins[segment]) @ axis
    low, high = np.percentile(height[own], [2, 98])
    at = np.clip((height - low) / max(high - low, 1e-6), 0.0, 1.0) * (knots - 1)
    along = np.maximum(0.0, 1.0 - np.abs(at - np.arange(knots)[:, None]))
    turn = np.arctan2(*(across @ _cross_axes(body, segment, axis).T).T[::-1]) / np.pi % 2.0
    if not body.segment_names[segment].endswith(("_r", "_l")):
        turn = np.minimum(turn, 2.0 - turn)  # trunk and head: both sides alike, the fourth direction stays empty
    apart = np.abs(turn - np.array(_SIDES)[:, None])
    around = np.maximum(0.0, 1.0 - 2.0 * np.minimum(apart, 2.0 - apart))
    return np.einsum("kv,dv,v,vi->kdvi", along, around, weight, across)


def _cross_axes(body: Body, segment: int, axis: Float) -> Float:
    """(2, 3) directions across a segment: forward (upward for one that points forward), and sideways, right as left."""
    ahead = np.array([0.0, 0.0, 1.0] if abs(axis[0]) > 0.7 else [1.0, 0.0, 0.0])
    ahead = ahead - (ahead @ axis) * axis
    mirror = -1.0 if body.segment_names[segment].endswith("_r") else 1.0
    return np.array([ahead / np.linalg.norm(ahead), mirror * np.cross(axis, ahead) / np.linalg.norm(ahead)])


def joint_fields(body: Body, sigma: float, side: float) -> Fields:
    """Shifts of the joint centres with the surface at rest: of left and right together, mirrored, and of each alone.
    Their standard deviations are `sigma` for both sides and `side` for each alone, m."""
    names, joints, sigmas = list[str](), list[Float](), list[float]()
    for kind, segments in girth_groups(body).items():
        jointed = [body.segment(s) for s in segments if body.segment_joint[body.segment(s)] >= 0]
        groups = [(jointed, sigma), *([([s], side) for s in jointed] if len(jointed) > 1 else [])]
        for group, width in groups:
            for axis in range(3 if group else 0):
                shift = np.zeros((len(body.segment_names), 3))
                for s in group:
                    flipped = axis == 1 and body.segment_names[s].endswith("_r")
                    shift[s, axis] = -1.0 if flipped else 1.0
                names.append(f"joint {kind if len(group) > 1 else body.segment_names[group[0]]} {'xyz'[axis]}")
                joints.append(shift)
                sigmas.append(width)
    moved = np.array(joints)
    still = np.zeros((len(names), *body.vertices.shape))
    return Fields(tuple(names), still, moved, _marks_with(body, moved), np.diag(np.power(sigmas, -2.0)))


def _marks_with(body: Body, joints: Float) -> Float:
    """(M, L, 3) motion of the landmarks that mark joints moved by (M, S, 3)."""
    out = np.zeros((len(joints), *body.landmarks.points.shape))
    for s in np.flatnonzero(body.segment_joint >= 0):
        out[:, marks_of(body, int(s))] += joints[:, s, None]
    return out


def offset_precision(body: Body, sigma: float, reach: float) -> sparse.csr_array:
    """(V, V) precision of smooth per-vertex offsets of a standard deviation (m), alike over `reach` (m).

    The field of Whittle and Matérn with smoothness 1 on the mesh, ``c (κ² M + K) M⁻¹ (κ² M + K)``, of cotangent
    stiffness K and lumped areas M (Lindgren, Rue and Lindström, DOI 10.1111/j.1467-9868.2011.00777.x).
    """
    area, stiffness = _finite_elements(body.vertices, body.faces)
    kappa = np.sqrt(8.0) / reach
    L = sparse.csr_array(sparse.diags_array(kappa**2 * area) + stiffness)
    scale = 1.0 / (4.0 * np.pi * kappa**2 * sigma**2)
    return sparse.csr_array(L @ sparse.diags_array(scale / area) @ L)


def turns(body: Body) -> Float:
    """(3 S, V, 3) rotation (rad) of each segment's surface as a whole, per motion of each vertex (least squares).
    Images do not separate a surface that turns against the axes of its joint from a joint that turns; a prior must."""
    out = np.zeros((len(body.segment_names), 3, *body.vertices.shape))
    for s in range(len(body.segment_names)):
        own = body.vertex_part == s
        if own.any():
            arm = body.vertices[own] - body.vertices[own].mean(axis=0)
            inertia = np.sum(arm**2) * np.eye(3) - arm.T @ arm
            out[s][:, own] = (np.linalg.inv(inertia + 1e-9 * np.eye(3)) @ se3.hat(arm)).transpose(1, 0, 2)
    return out.reshape(-1, *body.vertices.shape)


def _finite_elements(vertices: Float, faces: Int) -> tuple[Float, sparse.csr_array]:
    """Lumped areas (V,) and cotangent stiffness (V, V) of a triangle mesh."""
    V = len(vertices)
    area, stiffness = np.zeros(V), sparse.csr_array((V, V))
    corners = vertices[faces]
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    twice = np.maximum(twice, 1e-9)
    for k in range(3):
        i, j = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        np.add.at(area, faces[:, k], twice / 6.0)
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        half = np.clip(0.5 * np.sum(a * b, axis=1) / twice, 0.0, 5.0)  # obtuse corners would make it indefinite
        where = np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j])
        stiffness += sparse.coo_array((np.concatenate([-half, -half, half, half]), where), shape=(V, V))
    return area, stiffness


class Build(Protocol):
    """Parameters of a body's build, all 0 at the start of the fit."""

    @property
    def rigid(self) -> bool:
        """Whether its fields must not turn a segment's surface against the axes of its joint."""
        ...

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        """Motions by each parameter, of the body at these amounts; an amount that is not named is 0."""
        ...

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        """The change (M,) inside the bounds of amounts (M,), and its exact motions."""
        ...

    def summary(self, amounts: Mapping[str, float]) -> dict[str, float]:
        """The amounts as a report shows them."""
        ...


@dataclass(frozen=True)
class Stretches(Checked):
    """The build of any body: stature, length and girth of each kind of segment, factors of its cross-sections. All are
    standard deviations of log-factors, but for the `knots` of the sections along a segment, and `rigid`."""

    stature: Positive = 0.02
    length: Positive = 0.01
    girth: Positive = 0.12
    section: Positive = 0.06
    knots: Count = 5
    rigid: bool = True

    def fields(self, body: Body, amounts: Mapping[str, float]) -> Fields:
        stretches = stretch_fields(body, self.stature, self.length, self.girth)
        return stretches + profile_fields(body, self.section, self.knots)

    def moved(self, fields: Fields, amounts: Float, change: Float) -> tuple[Float, Motions]:
        return change, fields @ change

    def summary(self, amounts: Mapping[str, float]) -> dict[str, float]:
        return {n: float(np.exp(a)) for n, a in amounts.items() if not n.startswith("section")}
