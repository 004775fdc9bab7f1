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

from twistcap.arrays import Float, Int
from twistcap.body import Body
from twistcap.body.kinematics import Posed
from twistcap.body.model import Landmarks, unsided
from twistcap.body.shape import joint_coordinates, segment_axes
from twistcap.solve import Vector


@dataclass(frozen=True)
class Proportions:
    """Factors against the generic body, as `body.shape.rescaled` takes them."""

    lengths: Mapping[str, float]
    girths: Mapping[str, float]
    stature: float = 1.0


@dataclass(frozen=True)
class _Links:
    """Landmarks, then joint centres, as sums of links: one for each of them and each segment on its way to the root."""

    roots: Float  # (L + S, 3) where each way ends
    point: Int  # (E,) landmark or L + segment of the joint, ascending
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
    def _group(self) -> Int:
        """(S,) length group of each segment: left and right of the same name share one."""
        kinds = list(map(unsided, self.body.segment_names))
        return np.array([list(dict.fromkeys(kinds)).index(kind) for kind in kinds], np.int32)

    @cached_property
    def _girth(self) -> Int:
        """(S,) girth of each segment, -1 for none: those with more than one joint below them have one."""
        parents = self.body.segment_parent
        wide = np.bincount(parents[parents >= 0], minlength=len(parents)) > 1
        return np.where(wide, np.cumsum(wide) - 1, -1).astype(np.int32)

    @cached_property
    def _groups(self) -> int:
        return int(self._group.max()) + 1

    @property
    def size(self) -> int:
        """Number of log-factors."""
        return 2 + self._groups + int(self._girth.max())

    def sigmas(self, stature: float, length: float, girth: float) -> Float:
        """(size,) standard deviations of the log-factors from those of each kind."""
        return np.repeat([stature, length, girth], [1, self._groups, self.size - 1 - self._groups])

    def proportions(self, log_factors: Float) -> Proportions:
        """The factors by segment name."""
        along, across = self._factors(log_factors)
        stature, names = float(np.exp(log_factors[0])), self.body.segment_names
        lengths = {name: float(f) / stature for name, f in zip(names, along, strict=True)}
        girths = {names[s]: float(across[s]) / stature for s in np.flatnonzero(self._girth >= 0)}
        return Proportions(lengths, girths, stature)

    def scaled(self, log_factors: Float) -> Body:
        """The body of these proportions, without its skin."""
        (along, across), links, marks = self._factors(log_factors), self._links, self.body.landmarks
        points = np.exp(log_factors[0]) * links.roots
        moved = along[links.segment, None] * links.along + across[links.segment, None] * links.across
        np.add.at(points, links.point, moved)
        places, centres = points[: len(marks.names)], points[len(marks.names) :]
        twists, owner = self.body.twists.copy(), self._owner
        turning = (owner >= 0) & np.any(twists[:, :3] != 0, axis=1)
        twists[turning, 3:] = -np.cross(twists[turning, :3], centres[owner[turning]])
        return replace(self._bare, twists=twists, landmarks=Landmarks(marks.names, marks.segments, places))

    def jacobian(self, posed: Posed, log_factors: Float) -> Float:
        """(L, 3, size) derivative of the world landmarks of the `scaled` body by its log-factors."""
        (along, across), links, L = self._factors(log_factors), self._links, len(self.body.landmarks.names)
        own = slice(np.searchsorted(links.point, L))
        mark, segment = links.point[own], links.segment[own]
        R = posed.segment_transforms[segment, :3, :3]
        by_length = along[segment, None] * np.einsum("eij,ej->ei", R, links.along[own])
        by_girth = across[segment, None] * np.einsum("eij,ej->ei", R, links.across[own])
        out = np.zeros((L, self.size, 3))
        np.add.at(out, (mark, 1 + self._group[segment]), by_length)
        wide = self._girth[segment] >= 0
        np.add.at(out, (mark[wide], 1 + self._groups + self._girth[segment][wide]), by_girth[wide])
        out[:, 0] = posed.landmarks - posed.pose.root[:3, 3]  # the rest pose grows about its origin
        return np.swapaxes(out, 1, 2)

    def _factors(self, log_factors: Float) -> tuple[Float, Float]:
        """Factors along and across every segment, stature included, both (S,)."""
        f = np.exp(log_factors)
        lengths, girths = f[1 : 1 + self._groups], np.r_[f[1 + self._groups :], 1.0]  # -1 is that of no girth
        return f[0] * lengths[self._group], f[0] * girths[self._girth]

    @cached_property
    def _owner(self) -> Int:
        """(J,) the segment whose joint each coordinate belongs to, -1 for none."""
        out = np.full(len(self.body.coordinate_names), -1, np.int32)
        for s in np.flatnonzero(self.body.segment_joint >= 0):
            out[joint_coordinates(self.body, int(s))] = s
        return out

    @cached_property
    def _bare(self) -> Body:
        none, faces, bound = np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 1), np.int32)
        return replace(self.body, vertices=none, faces=faces, skin_segments=bound, skin_weights=np.zeros((0, 1)))

    @cached_property
    def _links(self) -> _Links:
        (origins, axes), marks, above = segment_axes(self.body), self.body.landmarks, self.body.segment_parent
        ends, rows = np.concatenate([marks.points, origins]), list[tuple[int, int, Float]]()
        for n, s in enumerate(np.concatenate([marks.segments, above])):
            while s >= 0:
                rows.append((n, int(s), ends[n] - origins[s]))
                ends[n], s = origins[s], above[s]
        point, segment = (np.array([row[k] for row in rows], np.int32) for k in (0, 1))
        link, a = np.array([row[2] for row in rows]).reshape(-1, 3), axes[segment]
        along = a * np.sum(a * link, axis=1, keepdims=True)
        return _Links(ends, point, segment, along, link - along)


@dataclass(frozen=True, kw_only=True)
class Scaling(Vector):
    """The log-factors of a skeleton as a block of variables; the body is without its skin."""

    skeleton: Skeleton

    @cached_property
    def body(self) -> Body:
        """Scaled."""
        return self.skeleton.scaled(self.values)

    def rates(self, posed: Posed) -> Float:
        """(L, 3, K) derivative of the world's landmarks."""
        return self.skeleton.jacobian(posed, self.values)
