"""From a skinned mesh of any format to a `Body`, with the meaning of its joints from a `RigSpec`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body.binding import strongest
from twistcap.body.kinematics import skin_points
from twistcap.body.model import Body, Landmarks
from twistcap.body.rig_spec import RIG_PAGE, JointSpec, LandmarkSpec, RigSpec
from twistcap.errors import InputError, check

_MOST_WEIGHTS = 25_000_000  # numbers of a dense binding
_HEIGHTS = (0.15, 3.5)  # m, of whoever has a head and feet; what is beyond is in another unit
TALLER = ("head_top", "nose", "neck"), ("ankle_r", "ankle_l", "heel_r", "heel_l")
"""Landmarks of head and feet."""
KINDS: tuple[Literal["revolute", "universal", "ball"], ...] = ("revolute", "universal", "ball")
"""Of joints with one, two and three axes."""


@dataclass(frozen=True)
class SkinnedMesh:
    """A skinned mesh in its file's units and axes.

    Attributes:
        name, source: of the body, and the file's for messages.
        joints, parents: B names and (B,) index of the parent joint, -1 for the top; parents come before their children.
        frames: (B, 4, 4) joint to mesh, rest pose.
        vertices, faces: (V, 3) and (F, 3), counter-clockwise seen from outside.
        weights: (V, B), not yet normalised.
        points, numbered: for landmarks, named points (3,), and (N, 3) vertices in the file's numbering.
    """

    name: str
    source: str
    joints: tuple[str, ...]
    parents: Int
    frames: Float
    vertices: Float
    faces: Int
    weights: Float
    points: Mapping[str, Float] = field(default_factory=dict[str, Float])
    numbered: Float | None = None


def build_body(mesh: SkinnedMesh, spec: RigSpec, influences: int = 4) -> Body:
    """The body of a skinned mesh and its rig description; of more than `influences` segments of a vertex the weakest
    are dropped.

    Raises InputError for joints that do not exist, wrong numbers of axes, names or limits, vertices without weights,
    and for a person who is not upright or of no person's height.
    """
    mesh, marks = _at_rest(mesh, spec)
    tree = _Tree(mesh, spec)
    segments, weights = compact_binding(tree.merged_weights(), influences, mesh.source)
    owner, parent, last = (np.array(x, dtype=np.int32) for x in (tree.owner, tree.parent, tree.segment_joint))
    return Body(
        mesh.name, tuple(tree.names), parent, np.array(tree.twists).reshape(-1, 6),
        np.radians(np.array(tree.limits_deg).reshape(-1, 2)), tuple(tree.segment_names), last,
        mesh.vertices, mesh.faces, segments, weights, replace(marks, segments=owner[marks.segments]),
    )  # fmt: skip


@dataclass(frozen=True)
class RestJoints:
    """Where the file's B joints are in the body's rest pose.

    Attributes:
        frames: (B, 4, 4) motions, joint to rest pose.
        owner: (B,) the segment that each moves with; -1 for those above the root, which stay.
        root: the joint with the six degrees of freedom.
    """

    frames: Float
    owner: Int
    root: int


def rest_joints(mesh: SkinnedMesh, spec: RigSpec) -> RestJoints:
    """The joints of the body that `build_body` makes of the same mesh. Raises InputError as it does."""
    mesh, _ = _at_rest(mesh, spec)
    tree, root = _Tree(mesh, spec), _root(mesh, spec)
    owner, above = np.array(tree.owner, dtype=np.int32), mesh.parents[root]
    while above >= 0:
        owner[above], above = -1, mesh.parents[above]
    return RestJoints(mesh.frames, owner, root)


def _at_rest(mesh: SkinnedMesh, spec: RigSpec) -> tuple[SkinnedMesh, Landmarks]:
    """The mesh and its landmarks in the rest pose and our axes."""
    _check_names(mesh, spec)
    mesh, marks = _in_rest_frame(mesh, _landmarks(mesh, spec), spec)
    # The joints, since a landmark at a place of its own stays there in any mesh; and before `aim` sets the legs right.
    check_standing(marks.names, mesh.frames[marks.segments, :3, 3], mesh.vertices, mesh.source)
    mesh, marks = _aimed(mesh, marks, spec)
    return _shifted(mesh, marks, spec.origin)


def check_standing(names: Sequence[str], points: Float, vertices: Float, source: str) -> None:
    """That a rest pose has its head above its feet and a person's height, where its landmarks tell of both.

    `points` (L, 3) are of the landmarks, `vertices` (V, 3) of the surface: z up, m. Messages begin with `source`.
    Raises InputError where it has not, mostly for a file with another axis up or another unit.
    """
    marks = dict(zip(names, points, strict=True))
    high, low = ([marks[name] for name in each if name in marks] for each in TALLER)
    if not high or not low:
        return
    line, height = np.mean(high, axis=0) - np.mean(low, axis=0), float(np.ptp(vertices[:, 2]))
    mend = f'export it with +Y up, or say up = "z" in a rig file ({RIG_PAGE})'
    said = f"in its rest pose the head is not above the feet, so its axes are wrong; {mend}"
    check(source, line[2] > 0.5 * np.linalg.norm(line), said)
    mend = f"export it in metres, or say scale in a rig file, as scale = 0.01 for cm ({RIG_PAGE})"
    check(source, _HEIGHTS[0] < height < _HEIGHTS[1], f"the body is {height:.3g} m high; {mend}")


def compact_binding(weights: Float, influences: int, source: str = "mesh") -> tuple[Int, Float]:
    """The strongest weights of each vertex, summing to 1. (V, S) -> (V, K) segments and (V, K) weights."""
    weights = np.maximum(weights, 0.0)
    bare = np.flatnonzero(~(weights.sum(axis=1) > 0))  # catches NaN too
    if len(bare):
        raise InputError(f"{source}: {len(bare)} vertices (first: {bare[0]}) have no weight; bind them to a joint.")
    K = min(influences, int((weights > 0).sum(axis=1).max(initial=1)))
    segments, kept = strongest(weights, K)
    return np.where(kept > 0, segments, 0).astype(np.int32), kept


def weights_matrix(vertices: int, joints: int, source: str) -> Float:
    """(V, B) zeros for weights; an InputError for a mesh too large to be tracked."""
    if vertices * joints > _MOST_WEIGHTS:
        raise InputError(f"{source}: {vertices} vertices with {joints} joints are too many; simplify the mesh.")
    return np.zeros((vertices, joints))


def in_tree_order(parents: Sequence[int]) -> list[int]:
    """Indices in an order with parents before their children and branches together."""
    children: dict[int, list[int]] = {}
    for child, parent in enumerate(parents):
        children.setdefault(parent, []).append(child)
    order: list[int] = []
    stack = list(reversed(children.get(-1, [])))
    while stack:
        order.append(stack.pop())
        stack.extend(reversed(children.get(order[-1], [])))
    return order


def welded(vertices: Float, faces: Int, weights: Float) -> tuple[Float, Int, Float]:
    """Vertices of equal place and binding (as at texture seams) as one, without triangles that vanish."""
    size = max(float(np.ptp(vertices, axis=0).max(initial=0.0)), 1e-12)
    segments, bound = compact_binding(weights, 8)
    key = np.concatenate([np.round(vertices / size * 1e6), segments, np.round(bound * 1e4)], axis=1).astype(np.int64)
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))  # keep the file's order
    kept = np.sort(first)
    faces = rank[which.ravel()][faces].astype(np.int32)
    a, b, c = faces.T
    return vertices[kept], np.ascontiguousarray(faces[(a != b) & (b != c) & (c != a)]), weights[kept]


class _Tree:
    """Segments and coordinates, joint by joint from the root."""

    def __init__(self, mesh: SkinnedMesh, spec: RigSpec) -> None:
        self.mesh, self.spec = mesh, spec
        self.names, self.parent, self.twists = list[str](), list[int](), list[Float]()
        self.limits_deg: list[tuple[float, float]] = []
        root = _root(mesh, spec)
        self.segment_names = [spec.joints.get(mesh.joints[root], JointSpec()).segment or mesh.joints[root]]
        self.segment_joint = [-1]
        above_root = {root}
        while (root := int(mesh.parents[root])) >= 0:
            above_root.add(root)
        self.owner = [0] * len(mesh.joints)  # segment of each joint of the file
        for b, name in enumerate(mesh.joints):
            self.owner[b] = self.owner[mesh.parents[b]] if mesh.parents[b] >= 0 else 0
            if b not in above_root and _stays(name, spec):
                self._add(b, spec.joints.get(name, JointSpec()))

    def _add(self, b: int, joint: JointSpec) -> None:
        name = self.mesh.joints[b]
        axes, names, limits = _coordinates(name, joint, f"{self.mesh.source}: joint {name!r}")
        frame = self.mesh.frames[b]
        if joint.frame == "joint":
            axes = axes @ frame[:3, :3].T
        last = self.segment_joint[self.owner[b]]
        for axis, coordinate, limit in zip(axes, names, limits, strict=True):
            self.parent.append(last)
            self.twists.append(np.concatenate([axis, -np.cross(axis, frame[:3, 3])]))
            self.names.append(coordinate)
            self.limits_deg.append(limit)
            last = len(self.names) - 1
        self.owner[b] = len(self.segment_names)
        self.segment_names.append(joint.segment or name)
        self.segment_joint.append(last)

    def merged_weights(self) -> Float:
        """(V, S) weights of the segments, summed over their joints."""
        merge = np.zeros((len(self.owner), len(self.segment_names)))
        merge[np.arange(len(self.owner)), self.owner] = 1.0
        return self.mesh.weights @ merge


def _coordinates(name: str, joint: JointSpec, where: str) -> tuple[Float, list[str], list[tuple[float, float]]]:
    count = ["fixed", *KINDS].index(joint.kind)
    if joint.axes is None and joint.kind != "ball":
        raise InputError(f"{where}: a {joint.kind} joint needs axes ({count} of them).")
    axes = np.eye(3) if joint.axes is None else np.array(joint.axes, dtype=float).reshape(-1, 3)
    suffixes = ("_x", "_y", "_z") if count > 1 else ("",)
    names = joint.names or [name + suffix for suffix in suffixes[:count]]
    limits = joint.limits_deg or [(-180.0, 180.0)] * count
    for what, given in (("axes", axes), ("names", names), ("limits_deg", limits)):
        check(where, len(given) == count, f"{what} has {len(given)} entries, a {joint.kind} joint needs {count}")
    length = np.linalg.norm(axes, axis=1, keepdims=True)
    check(where, np.all(length > 1e-9), "an axis has no length")
    return axes / length, names, limits


def _stays(name: str, spec: RigSpec) -> bool:
    if name in spec.joints:
        return spec.joints[name].kind != "fixed"
    return spec.keep is None or name in spec.keep


def _root(mesh: SkinnedMesh, spec: RigSpec) -> int:
    tops = [name for name, parent in zip(mesh.joints, mesh.parents, strict=True) if parent < 0]
    if spec.root is None and len(tops) > 1:
        raise InputError(f"{mesh.source}: several top joints ({', '.join(tops)}); name one as root in the rig TOML.")
    return mesh.joints.index(spec.root or tops[0])


def _check_names(mesh: SkinnedMesh, spec: RigSpec) -> None:
    named = [("keep", name) for name in spec.keep or []] + [("joints", name) for name in spec.joints]
    named += [(f"joints.{name}.aim.at", j.aim.at) for name, j in spec.joints.items() if j.aim]
    named += [(f"landmarks.{m}", s if isinstance(s, str) else s.joint) for m, s in (spec.landmarks or {}).items()]
    named += [("root", spec.root)] if spec.root is not None else []
    some = ", ".join(mesh.joints[:4])
    for key, name in named:
        check(mesh.source, name in mesh.joints, f"{key} names the joint {name!r}, which is not in it; it has {some}")


def _landmarks(mesh: SkinnedMesh, spec: RigSpec) -> Landmarks:
    """Landmarks in the file's axes; `segments` still number the file's joints."""
    specs = spec.landmarks
    if specs is None:
        specs = {name: name for name in mesh.joints if _stays(name, spec)}
    points = [_landmark_point(mesh, spec, name, s) for name, s in specs.items()]
    joints = [mesh.joints.index(s if isinstance(s, str) else s.joint) for s in specs.values()]
    return Landmarks(tuple(specs), np.array(joints, dtype=np.int32), np.array(points).reshape(-1, 3))


def _landmark_point(mesh: SkinnedMesh, spec: RigSpec, name: str, mark: str | LandmarkSpec) -> Float:
    where = f"{mesh.source}: landmarks.{name}"
    if isinstance(mark, str) or (mark.at is None and mark.point is None and mark.vertices is None):
        return mesh.frames[mesh.joints.index(mark if isinstance(mark, str) else mark.joint), :3, 3]
    if mark.at is not None:
        return np.array(mark.at) @ spec.to_rest() / spec.scale**2  # the rows are orthogonal, of length `scale`
    if mark.point is not None:
        check(where, mark.point in mesh.points, f"the file has no point {mark.point!r}")
        return mesh.points[mark.point]
    chosen = mark.vertices or []
    if mesh.numbered is None or not chosen or not 0 <= min(chosen) <= max(chosen) < len(mesh.numbered):
        raise InputError(f"{where}: vertices must be numbers of the OBJ file's vertices.")
    return mesh.numbered[chosen].mean(axis=0)


def _in_rest_frame(mesh: SkinnedMesh, marks: Landmarks, spec: RigSpec) -> tuple[SkinnedMesh, Landmarks]:
    C = spec.to_rest()
    axes = C @ mesh.frames[:, :3, :3]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    frames = se3.transform(axes, mesh.frames[:, :3, 3] @ C.T)
    return replace(mesh, vertices=mesh.vertices @ C.T, frames=frames), replace(marks, points=marks.points @ C.T)


def _aimed(mesh: SkinnedMesh, marks: Landmarks, spec: RigSpec) -> tuple[SkinnedMesh, Landmarks]:
    """The rest pose after all `aim`s, from the root down, with its surface."""
    if not any(joint.aim for joint in spec.joints.values()):
        return mesh, marks
    motions = np.tile(np.eye(4), (len(mesh.joints), 1, 1))
    for b, name in enumerate(mesh.joints):
        if mesh.parents[b] >= 0:
            motions[b] = motions[mesh.parents[b]]
        aim = spec.joints[name].aim if name in spec.joints else None
        if aim is not None:
            head, tip = se3.apply(motions[b], mesh.frames[[b, mesh.joints.index(aim.at)], :3, 3])
            R = motions[b, :3, :3].T  # back to the file's orientation
            if aim.along != "file":
                R = turn_between(tip - head, np.array(aim.along), f"{mesh.source}: joints.{name}.aim")
            motions[b] = se3.transform(R, head - R @ head) @ motions[b]
    segments, weights = compact_binding(mesh.weights, 8, mesh.source)
    points = se3.apply(motions[marks.segments], marks.points[:, None, :])[:, 0]
    vertices = skin_points(motions, segments, weights, mesh.vertices)
    return replace(mesh, vertices=vertices, frames=motions @ mesh.frames), replace(marks, points=points)


def turn_between(start: Float, end: Float, where: str = "") -> Float:
    """(3, 3) the smallest rotation that takes one direction (3,) into another. Raises InputError for a direction
    without a length; `where` begins the message."""
    lengths = float(np.linalg.norm(start)), float(np.linalg.norm(end))
    check(where, min(lengths) >= 1e-9, "the two joints coincide, or `along` has no length")
    a, b = start / lengths[0], end / lengths[1]
    axis, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12 and cosine < 0:
        axis, sine = np.cross(a, np.eye(3)[np.argmin(np.abs(a))]), 0.0
    norm = float(np.linalg.norm(axis))
    return se3.exp_rotation(axis / norm * np.arctan2(sine, cosine)) if norm > 0 else np.eye(3)


def _shifted(mesh: SkinnedMesh, marks: Landmarks, origin: str) -> tuple[SkinnedMesh, Landmarks]:
    if origin == "file":
        return mesh, marks
    if origin == "ground":
        shift = np.array([0.0, 0.0, -float(mesh.vertices[:, 2].min())])
    elif origin in marks.names:
        shift = -marks.points[marks.index(origin)]
    else:
        raise InputError(f"{mesh.source}: origin is {origin!r}; it must be 'file', 'ground' or the name of a landmark.")
    frames = mesh.frames.copy()
    frames[:, :3, 3] += shift
    return replace(mesh, vertices=mesh.vertices + shift, frames=frames), replace(marks, points=marks.points + shift)
