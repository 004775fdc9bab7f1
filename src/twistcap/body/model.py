"""`Body`: immutable data of the tracked body, checked when it is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from twistcap.arrays import AnyArray, Bool, Float, Int
from twistcap.errors import check


@dataclass(frozen=True)
class Landmarks:
    """L named points of the body, such as ``knee_r``: joint centres and sites.

    Each is rigidly attached to one of the `segments` (L,); `points` (L, 3) are rest-pose positions, m.
    """

    names: tuple[str, ...]
    segments: Int
    points: Float

    def index(self, name: str) -> int:
        return self.names.index(name)

    def and_those(self, other: Landmarks) -> Landmarks:
        """These points, and then others."""
        segments = np.concatenate([self.segments, other.segments]).astype(np.int32)
        return Landmarks((*self.names, *other.names), segments, np.concatenate([self.points, other.points]))


@dataclass(frozen=True)
class Body:
    """A tree of joint twists, a closed surface and its binding. Units m and rad; rest pose as modelled.

    Coordinates (J) are single twists; a ball joint is two or three of them through one point. Segments (S) are rigid
    bones. Parents come before their children in both lists.

    Attributes:
        coordinate_names: J names, OpenSim's where there is one (``hip_flexion_r``).
        parent: (J,) index of the next coordinate towards the root, -1 for the root itself.
        twists: (J, 6) rest-pose twists (ω, v), unit ω for revolute joints (``v = −ω × point``), ω = 0 for sliding ones.
        limits: (J, 2) lower and upper limit, rad (m for sliding).
        segment_joint: (S,) last coordinate that moves each segment, -1 for segments of the root.
        vertices, faces: (V, 3) rest-pose surface, m, and (F, 3) triangles, counter-clockwise seen from outside.
        skin_segments, skin_weights: (V, K) linear-blend binding; weights sum to 1, a rigid binding has one weight of 1.

    Raises InputError for wrong shapes, values that are not finite, names used twice, children before their parents, or
    weights that do not sum to 1.
    """

    name: str
    coordinate_names: tuple[str, ...]
    parent: Int
    twists: Float
    limits: Float
    segment_names: tuple[str, ...]
    segment_joint: Int
    vertices: Float
    faces: Int
    skin_segments: Int
    skin_weights: Float
    landmarks: Landmarks = field(default_factory=lambda: Landmarks((), np.zeros(0, np.int32), np.zeros((0, 3))))

    def __post_init__(self) -> None:
        where = f"body {self.name!r}"
        J, S, V = len(self.coordinate_names), len(self.segment_names), len(self.vertices)
        L, marks = len(self.landmarks.names), self.landmarks
        check(where, self.parent.shape == (J,), "parent must have one entry per coordinate")
        check(where, self.twists.shape == (J, 6), "twists must be (J, 6)")
        check(where, self.limits.shape == (J, 2), "limits must be (J, 2)")
        check(where, _within(self.parent, -1, np.arange(J)), "parents must stand before their children")
        check(where, self.segment_joint.shape == (S,), "segment_joint must have one entry per segment")
        check(where, S > 0 and _within(self.segment_joint, -1, J), "a segment names a joint that does not exist")
        check(where, np.all(self.limits[:, 0] <= self.limits[:, 1]), "a lower limit lies above its upper limit")
        check(where, np.all(np.isfinite(self.twists)), "a twist is not finite")
        listed = {"coordinate": self.coordinate_names, "segment": self.segment_names, "landmark": marks.names}
        for what, names in listed.items():
            twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
            check(where, twice is None, f"{what} name {twice!r} is used twice")
        check(where, self.vertices.shape == (V, 3), "vertices must be (V, 3)")
        check(where, np.all(np.isfinite(self.vertices)), "a vertex is not finite")
        check(where, self.faces.shape == (len(self.faces), 3), "faces must be (F, 3)")
        check(where, _within(self.faces, 0, V), "a face names a vertex that does not exist")
        check(where, self.skin_segments.shape == self.skin_weights.shape, "binding arrays must have equal shape")
        check(where, self.skin_weights.ndim == 2 and len(self.skin_weights) == V, "every vertex needs a binding")
        check(where, _within(self.skin_segments, 0, S), "a vertex is bound to a segment that does not exist")
        check(where, np.allclose(self.skin_weights.sum(axis=1), 1.0, atol=1e-5), "weights must sum to 1")
        fits = marks.segments.shape == (L,) and marks.points.shape == (L, 3) and np.all(np.isfinite(marks.points))
        check(where, fits and _within(marks.segments, 0, S), "its landmarks must be finite points of its segments")

    @property
    def dof(self) -> int:
        """Degrees of freedom: 6 of the root and one per coordinate."""
        return 6 + len(self.coordinate_names)

    def coordinate(self, name: str) -> int:
        """Index of a coordinate by name."""
        return self.coordinate_names.index(name)

    def segment(self, name: str) -> int:
        """Index of a segment by name."""
        return self.segment_names.index(name)

    @cached_property
    def chain(self) -> Bool:
        """(S, J) whether a coordinate moves a segment."""
        J = len(self.coordinate_names)
        moved_by = np.eye(J + 1, J, dtype=bool)  # its last row is that of the root, -1
        for k in range(J):
            moved_by[k] |= moved_by[self.parent[k]]
        return moved_by[self.segment_joint]

    @cached_property
    def vertex_part(self) -> Int:
        """(V,) segment of largest weight of each vertex."""
        best = np.argmax(self.skin_weights, axis=1)
        return np.take_along_axis(self.skin_segments, best[:, None], axis=1)[:, 0].astype(np.int32)

    @cached_property
    def face_part(self) -> Int:
        """(F,) segment of each triangle, by the majority of its corners."""
        a, b, c = self.vertex_part[self.faces].T
        return np.where(b == c, b, a).astype(np.int32)

    @cached_property
    def segment_parent(self) -> Int:
        """(S,) the nearest segment towards the root, -1 for root segments."""
        carried = {int(j): s for s, j in enumerate(self.segment_joint)}
        out = np.full(len(self.segment_names), -1, dtype=np.int32)
        for s, k in enumerate(map(int, self.segment_joint)):
            while k >= 0 and out[s] < 0:
                k = int(self.parent[k])
                out[s] = carried.get(k, -1)
        return out

    @cached_property
    def joint_origins(self) -> Float:
        """(S, 3) rest-pose positions of all segments' proximal joints, m, see `twistcap.body.shape.joint_origin`."""
        from twistcap.body.shape import joint_origin

        return np.array([joint_origin(self, s) for s in range(len(self.segment_names))]).reshape(-1, 3)

    @cached_property
    def segment_middles(self) -> Float:
        """(S, 3) rest-pose mean of the vertices of each segment, m; of the whole body where it has none."""
        middles = np.tile(self.vertices.mean(axis=0), (len(self.segment_names), 1))
        for s in np.unique(self.vertex_part):
            middles[s] = self.vertices[self.vertex_part == s].mean(axis=0)
        return middles

    @cached_property
    def edges(self) -> tuple[Int, Int]:
        """Edges (E, 2) as vertex pairs and (E, 2) their two faces, for a closed surface."""
        return edges_of(self.faces)


def split_side(name: str) -> tuple[str, str]:
    """``knee_angle_r`` -> ("knee_angle", "r"); the side of what has none is empty."""
    return (name[:-2], name[-1]) if name[-2:] in ("_r", "_l") else (name, "")


def unsided(name: str) -> str:
    """The name of a segment, coordinate or landmark without its side, ``_r`` or ``_l``."""
    return split_side(name)[0]


def partners(names: Sequence[str]) -> list[int]:
    """The index of each name's other side, ``_r`` for ``_l``; its own where there is none."""
    other = {"_r": "_l", "_l": "_r"}
    mirrored = [name[:-2] + other.get(name[-2:], name[-2:]) for name in names]
    return [names.index(m) if m in names else n for n, m in enumerate(mirrored)]


def _within(indices: Int, least: int, below: int | AnyArray) -> bool:
    return bool(np.all((indices >= least) & (indices < below)))


def edges_of(faces: Int) -> tuple[Int, Int]:
    """Unique edges (E, 2) of triangles and the two faces (E, 2) at each; -1 for edges of one face."""
    corners = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces), dtype=np.int32), 3)
    edges, which = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    sorted_edge = which.ravel()[order]
    first = np.searchsorted(sorted_edge, np.arange(len(edges)))
    count = np.bincount(sorted_edge, minlength=len(edges))
    adjacent = np.full((len(edges), 2), -1, dtype=np.int32)
    adjacent[:, 0] = owner[order[first]]
    two = count >= 2
    adjacent[two, 1] = owner[order[first[two] + 1]]
    return edges.astype(np.int32), adjacent
