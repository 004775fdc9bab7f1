"""A body without its skin whose proportions can be changed cheaply, with derivatives.

Every segment c carries its points by ``R_c A_c (p − o_c)``, where ``A_c = across (I − a aᵀ) + along a aᵀ`` stretches
the rest pose about the joint o_c (`body.shape`) and moves its children's joints by the same map. Stretching does not
change the rotations R, so that a landmark is linear in the factors of the segments above it, and its derivative by the
logarithm of a factor is the stretched part of the chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import Body
from twistcap.body.kinematics import Posed
from twistcap.body.model import Landmarks
from twistcap.body.shape import segment_axes


@dataclass(frozen=True)
class Proportions:
    """Factors against the generic body, as `body.shape.rescaled` takes them."""

    lengths: Mapping[str, float]
    girths: Mapping[str, float]
    stature: float = 1.0


@dataclass(frozen=True)
class _Links:
    """Landmarks as sums of links: one for each landmark and segment on its way to the root, E in all."""

    landmark: Int
    segment: Int
    along: Float  # (E, 3) part of the link along the segment's axis, rest pose
    across: Float  # (E, 3) the rest of it


@dataclass(frozen=True)
class Skeleton:
    """Joints and landmarks of `body` under log-factors: stature, then lengths by group, then girths.

    Left and right share their lengths. Girths are those of the segments that carry several limbs (pelvis, torso): they
    move the hips and shoulders.
    """

    body: Body

    @cached_property
    def length_groups(self) -> tuple[tuple[int, ...], ...]:
        """Segments that share a length: left and right of the same name."""
        groups: dict[str, list[int]] = {}
        for s, name in enumerate(self.body.segment_names):
            groups.setdefault(name.removesuffix("_r").removesuffix("_l"), []).append(s)
        return tuple(tuple(group) for group in groups.values())

    @cached_property
    def girth_segments(self) -> tuple[int, ...]:
        """Segments with more than one joint below them."""
        parents = self.body.segment_parent
        children = np.bincount(parents[parents >= 0], minlength=len(parents))
        return tuple(int(s) for s in np.flatnonzero(children > 1))

    @property
    def size(self) -> int:
        """Number of log-factors."""
        return 1 + len(self.length_groups) + len(self.girth_segments)

    def proportions(self, log_factors: Float) -> Proportions:
        """The factors by segment name."""
        along, across = self._factors(log_factors)
        stature, names = float(np.exp(log_factors[0])), self.body.segment_names
        lengths = {name: float(f) / stature for name, f in zip(names, along, strict=True)}
        girths = {names[s]: float(across[s]) / stature for s in self.girth_segments}
        return Proportions(lengths, girths, stature)

    def scaled(self, log_factors: Float) -> Body:
        """The body of these proportions, without its skin."""
        maps = self._maps(log_factors)
        marks, centres = self.body.landmarks, np.einsum("sij,sj->si", maps[:, :3, :3], self._axes[0]) + maps[:, :3, 3]
        T = maps[marks.segments]
        points = np.einsum("nij,nj->ni", T[:, :3, :3], marks.points) + T[:, :3, 3]
        twists, owner = self.body.twists.copy(), self._owner
        turning = (owner >= 0) & np.any(twists[:, :3] != 0, axis=1)
        twists[turning, 3:] = -np.cross(twists[turning, :3], centres[owner[turning]])
        return replace(self._bare, twists=twists, landmarks=Landmarks(marks.names, marks.segments, points))

    def jacobian(self, posed: Posed, log_factors: Float) -> Float:
        """(N, 3, size) derivative of the world landmarks of the `scaled` body by its log-factors."""
        along, across = self._factors(log_factors)
        links, groups = self._links, len(self.length_groups)
        R = posed.segment_transforms[links.segment, :3, :3]
        by_length = along[links.segment, None] * np.einsum("eij,ej->ei", R, links.along)
        by_girth = across[links.segment, None] * np.einsum("eij,ej->ei", R, links.across)
        out = np.zeros((len(self.body.landmarks.names), self.size, 3))
        np.add.at(out, (links.landmark, 1 + self._group[links.segment]), by_length)
        wide = self._girth[links.segment] >= 0
        np.add.at(out, (links.landmark[wide], 1 + groups + self._girth[links.segment][wide]), by_girth[wide])
        out[:, 0] = posed.landmarks - posed.pose.root[:3, 3]  # the rest pose grows about its origin
        return np.swapaxes(out, 1, 2)

    def _factors(self, log_factors: Float) -> tuple[Float, Float]:
        """Factors along and across every segment, stature included, both (S,)."""
        f, groups = np.exp(log_factors), len(self.length_groups)
        across = np.ones(len(self.body.segment_names))
        across[list(self.girth_segments)] = f[1 + groups :]
        return f[0] * f[1 : 1 + groups][self._group], f[0] * across

    def _maps(self, log_factors: Float) -> Float:
        """(S, 4, 4) as `body.shape.stretch_maps`, with the axes found once."""
        along, across = self._factors(log_factors)
        origins, axes = self._axes
        outer = axes[:, :, None] * axes[:, None, :]
        A = across[:, None, None] * np.eye(3) + (along - across)[:, None, None] * outer
        places = np.exp(log_factors[0]) * origins
        for s, above in enumerate(self.body.segment_parent):
            if above >= 0:
                places[s] = places[above] + A[above] @ (origins[s] - origins[above])
        return se3.transform(A, places - np.einsum("sij,sj->si", A, origins))

    @cached_property
    def _axes(self) -> tuple[Float, Float]:
        return segment_axes(self.body)

    @cached_property
    def _group(self) -> Int:
        """(S,) length group of each segment."""
        out = np.zeros(len(self.body.segment_names), np.int32)
        for g, group in enumerate(self.length_groups):
            out[list(group)] = g
        return out

    @cached_property
    def _girth(self) -> Int:
        """(S,) girth of each segment, -1 for none."""
        out = np.full(len(self.body.segment_names), -1, np.int32)
        out[list(self.girth_segments)] = np.arange(len(self.girth_segments))
        return out

    @cached_property
    def _owner(self) -> Int:
        """(J,) the segment whose joint each coordinate belongs to, -1 for none."""
        body = self.body
        out = np.full(len(body.coordinate_names), -1, np.int32)
        for s, k in enumerate(body.segment_joint):
            while k >= 0 and out[k] < 0:  # up to the joint of the segment above, which comes before this one
                out[k] = s
                k = body.parent[k]
        return out

    @cached_property
    def _bare(self) -> Body:
        none = np.zeros((0, 3))
        binding = np.zeros((0, 1), np.int32), np.zeros((0, 1))
        faces = np.zeros((0, 3), np.int32)
        return replace(self.body, vertices=none, faces=faces, skin_segments=binding[0], skin_weights=binding[1])

    @cached_property
    def _links(self) -> _Links:
        (origins, axes), marks = self._axes, self.body.landmarks
        rows: list[tuple[int, int, Float]] = []
        for n, s in enumerate(marks.segments):
            end = marks.points[n]
            while s >= 0:
                rows.append((n, int(s), end - origins[s]))
                end, s = origins[s], self.body.segment_parent[s]
        landmark, segment = np.array([r[0] for r in rows], np.int32), np.array([r[1] for r in rows], np.int32)
        link, a = np.array([r[2] for r in rows]).reshape(-1, 3), axes[segment]
        along = a * np.sum(a * link, axis=1, keepdims=True)
        return _Links(landmark, segment, along, link - along)


@dataclass(frozen=True)
class Scaling:
    """The log-factors of a skeleton as a block of variables; the body is without its skin.

    Attributes:
        skeleton: that they scale.
        values: (K,) log-factors.
    """

    skeleton: Skeleton
    values: Float

    @property
    def dof(self) -> int:
        return len(self.values)

    def retract(self, step: Float) -> Scaling:
        return Scaling(self.skeleton, self.values + step)

    def minus(self, other: Scaling) -> Float:
        return self.values - other.values

    @cached_property
    def body(self) -> Body:
        """Scaled."""
        return self.skeleton.scaled(self.values)

    def rates(self, posed: Posed) -> Float:
        """(L, 3, K) derivative of the world's landmarks."""
        return self.skeleton.jacobian(posed, self.values)
