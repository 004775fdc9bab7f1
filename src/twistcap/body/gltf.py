"""Any skinned GLB or glTF as a `Body`, and bodies with their motion as GLB.

glTF 2.0 (ISO/IEC 12113:2022): y up, facing +z, m. The rest pose is the bind pose: stored vertices and joints by the
inverse bind matrices, both moved into the scene by the root joint's motion. Without inverse bind matrices it is the
pose of the nodes. Our coordinates are in `asset.extras.twistcap`, so that a body saved here loads as the same body,
while a viewer shows skin and animation.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pygltflib import GLTF2

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body._gltf_buffers import EXTRAS, LARGEST_BUFFER, TO_REST, Buffers
from twistcap.body.binding import strongest
from twistcap.body.gltf_write import save_glb
from twistcap.body.model import Body, Landmarks
from twistcap.body.rig import SkinnedMesh, build_body, in_tree_order, weights_matrix, welded
from twistcap.body.rig_presets import best_fit, preset_spec
from twistcap.body.rig_spec import RigSpec, read_rig
from twistcap.doors.text import number_array, parsed_json, read_bytes
from twistcap.errors import InputError, check, naming

__all__ = ["load_glb", "save_glb"]

_TRIANGLES = 4
_INFLUENCES = 8  # segments of one vertex, at most


def load_glb(path: Path | str, rig: Path | str | RigSpec | None = None) -> Body:
    """The skinned mesh of a GLB or glTF as a body; a file of `save_glb` gives the same body.

    `rig` is the meaning of the joints (`rig_spec`), by default <name>.rig.toml beside the file if there is one. Where
    that says no joints, they are those of a rig whose bone names are known (`rig_presets`); of any other, every joint
    is a ball joint without limits. Raises InputError if the file cannot be read or has no skin, for primitives that are
    not triangles, buffers that are missing, compressed or too short, and for what `build_body` refuses.
    """
    return _loaded(Path(path), rig).body


@dataclass(frozen=True)
class Rigged:
    """A parsed file, its mesh in glTF's axes, the meaning of its joints and where that is from, and the body of it."""

    scene: Scene
    mesh: SkinnedMesh
    spec: RigSpec
    body: Body
    about: str  # in words; "" for a body of ours


def load_rigged(path: Path | str, rig: Path | str | RigSpec | None = None) -> Rigged:
    """As `load_glb`, with what is needed to write motion into the file. Raises InputError as it does, and for a file
    of `save_glb`, whose joints are our own."""
    found = _loaded(Path(path), rig)
    own = EXTRAS in (found.scene.gltf.asset.extras or {})
    check(str(path), not own, "it is a body of twistcap, which exports hold as it is; leave --into away")
    return found


def load_described(path: Path | str, rig: Path | str | None = None) -> tuple[Body, str]:
    """As `load_glb`, and where the meaning of the joints is from, in words: a rig file, a known rig, or nowhere; "" for
    a file of `save_glb`."""
    found = _loaded(Path(path), rig)
    return found.body, f"body {path}: {found.about}" if found.about else ""


def _loaded(path: Path, rig: Path | str | RigSpec | None) -> Rigged:
    gltf = _open(path)
    own: Any = (gltf.asset.extras or {}).get(EXTRAS)
    beside = path.with_name(path.stem + ".rig.toml")
    if rig is None and own is None and beside.is_file():
        rig = beside
    given = rig if isinstance(rig, RigSpec) else read_rig(rig) if rig is not None else None
    try:
        with naming(path), np.errstate(all="ignore"):
            scene = Scene(gltf, path)
            mesh = _read_mesh(scene, own is not None)
            if own is not None and rig is None:
                return Rigged(scene, mesh, RigSpec(), _own_body(mesh, own, path), "")
            if given is not None and given.says_joints:
                spec, about = given, f"its joints are those of the rig file {rig}"
            else:
                spec, about = preset_spec(mesh, given) or given or RigSpec(), best_fit(mesh).in_words
            with naming(path if rig is given else f"rig file {rig}"):
                return Rigged(scene, mesh, spec, build_body(mesh, spec, _INFLUENCES), about)
    except InputError:
        raise
    except (LookupError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: broken glTF, a value is missing or has no meaning ({error}).") from error


def _open(path: Path) -> GLTF2:
    """pygltflib takes whatever JSON it is given, so that is checked first."""
    data = read_bytes(path, LARGEST_BUFFER)
    binary = data[:4] == b"glTF"
    check(str(path), binary or data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{", "it is no GLB or glTF; check its path")
    length = int.from_bytes(data[12:16], "little")
    if binary and (len(data) < 20 or data[16:20] != b"JSON" or 20 + length > len(data)):
        raise InputError(f"{path}: not a glTF file (its first chunk is no JSON, or cut off).")
    parsed_json(data[20 : 20 + length] if binary else data, str(path))
    try:
        with warnings.catch_warnings(action="ignore"):  # of values that have another type; we look ourselves
            gltf: Any = GLTF2.load_from_bytes(data) if binary else GLTF2.gltf_from_json(data.decode())
    except Exception as error:  # pygltflib passes on any exception of its parsers
        raise InputError(f"{path}: not a glTF file ({type(error).__name__}: {error}).") from error
    wanted = [name for name in gltf.extensionsRequired or [] if "compression" in name or "quantization" in name]
    check(str(path), not wanted, f"needs {', '.join(wanted)}; export it without compression")
    check(str(path), gltf.skins, "it has no skin (skins is empty); export the mesh together with its armature")
    return gltf


@dataclass(frozen=True)
class Scene:
    """A parsed file with its joints in tree order."""

    gltf: GLTF2
    path: Path

    @cached_property
    def buffers(self) -> Buffers:
        return Buffers(self.gltf, self.path)

    @cached_property
    def parents(self) -> list[int]:
        """Parent of each node, -1 at the top."""
        parents = [-1] * len(self.gltf.nodes)
        for number, node in enumerate(self.gltf.nodes):
            for child in node.children or []:
                there = 0 <= child < len(parents)
                check(str(self.path), there, f"node {number} has the child {child}, which is not there")
                parents[child] = number
        check(str(self.path), len(in_tree_order(parents)) == len(parents), "its nodes form a ring instead of a tree")
        return parents

    @cached_property
    def world(self) -> Float:
        """(nodes, 4, 4) motions of the nodes in the file's pose."""
        world = np.zeros((len(self.parents), 4, 4))
        for n in in_tree_order(self.parents):
            above = world[self.parents[n]] if self.parents[n] >= 0 else np.eye(4)
            world[n] = above @ _node_matrix(self.gltf.nodes[n])
        return world

    def local(self, node: int) -> Float:
        """(4, 4) motion of a node in its parent."""
        return _node_matrix(self.gltf.nodes[node])

    def skin_joints(self, skin: int) -> list[int]:
        return list(self.gltf.skins[skin].joints or [])

    @cached_property
    def joints(self) -> list[int]:
        """The nodes that are joints, parents first; in our own files in the order of segments."""
        if EXTRAS in (self.gltf.skins[0].extras or {}):
            return self.skin_joints(0)
        used = {joint for skin in range(len(self.gltf.skins)) for joint in self.skin_joints(skin)}
        return [n for n in in_tree_order(self.parents) if n in used]

    @cached_property
    def column(self) -> dict[int, int]:
        """Number among the joints, by node."""
        return {node: b for b, node in enumerate(self.joints)}

    def names(self) -> tuple[str, ...]:
        names: list[str] = []
        for node in self.joints:
            name = self.gltf.nodes[node].name or f"joint_{node}"
            names.append(name if name not in names else f"{name}_{node}")
        return tuple(names)

    def joint_above(self, node: int) -> int:
        node = self.parents[node]
        while node >= 0 and node not in self.column:
            node = self.parents[node]
        return self.column.get(node, -1)

    def bind_motions(self, number: int) -> tuple[Float, Float]:
        """Motions (B, 4, 4) of the stored vertices to the rest pose, by joint; the joints' frames (B, 4, 4) there."""
        joints, skin = self.skin_joints(number), self.gltf.skins[number]
        nodes = self.world[joints]
        if skin.inverseBindMatrices is None:
            return nodes, nodes
        binds = self.buffers.accessor(skin.inverseBindMatrices, f"skin {number}: inverseBindMatrices")
        binds = binds.reshape(-1, 4, 4).transpose(0, 2, 1)
        invertible = len(binds) == len(nodes) and bool(np.all(np.abs(np.linalg.det(binds)) > 1e-18))
        check(str(self.path), invertible, f"skin {number}: inverseBindMatrices must be one invertible matrix per joint")
        root = int(np.argmin([self.column[joint] for joint in joints]))
        motion = nodes[root] @ binds[root]
        return np.tile(motion, (len(nodes), 1, 1)), motion @ np.linalg.inv(binds)


def _read_mesh(scene: Scene, as_is: bool) -> SkinnedMesh:
    """All skinned meshes of the file as one, in glTF's axes; `as_is`: without welding."""
    binds = [scene.bind_motions(skin) for skin in range(len(scene.gltf.skins))]
    vertices, faces, weights = _joined(_parts(scene, binds))
    if not as_is:
        vertices, faces, weights = welded(vertices, faces, weights)
    found: dict[int, Float] = {}
    for skin, (_, frames) in enumerate(binds):
        for joint, frame in zip(scene.skin_joints(skin), frames, strict=True):
            found.setdefault(joint, frame)
    frames = np.array([found[joint] for joint in scene.joints])
    parents = np.array([scene.joint_above(node) for node in scene.joints], dtype=np.int32)
    return SkinnedMesh(scene.path.stem, str(scene.path), scene.names(), parents, frames, vertices, faces, weights)


def _parts(scene: Scene, binds: list[tuple[Float, Float]]) -> list[tuple[Float, Int, Float]]:
    """Vertices (V, 3) in the rest pose, triangles (F, 3) and weights (V, joints) of every skinned primitive."""
    parts: list[tuple[Float, Int, Float]] = []
    for node in scene.gltf.nodes:
        if node.skin is None or node.mesh is None:
            continue
        columns = np.array([scene.column[joint] for joint in scene.skin_joints(node.skin)])
        mesh = scene.gltf.meshes[node.mesh]
        for number, primitive in enumerate(mesh.primitives):
            where = f"mesh {mesh.name or node.mesh!r}, primitive {number}"
            vertices, faces, by_joint = _primitive(scene, primitive, where, len(columns))
            weights = weights_matrix(len(vertices), len(scene.joints), str(scene.path))
            weights[:, columns] = by_joint
            parts.append((*_in_scene(vertices, faces, by_joint, binds[node.skin][0]), weights))
    check(str(scene.path), bool(parts), "no mesh uses its skin")
    return parts


def _node_matrix(node: Any) -> Float:
    if node.matrix is not None:
        return np.array(node.matrix, dtype=float).reshape(4, 4).T
    x, y, z, w = node.rotation or (0.0, 0.0, 0.0, 1.0)
    sine = float(np.linalg.norm([x, y, z]))
    omega = np.array([x, y, z]) * (2.0 * np.arctan2(sine, w) / sine if sine > 0 else 0.0)
    R = se3.exp_rotation(omega) * np.array(node.scale or (1.0, 1.0, 1.0))
    return se3.transform(R, np.array(node.translation or (0.0, 0.0, 0.0)))


def _primitive(scene: Scene, primitive: Any, where: str, joint_count: int) -> tuple[Float, Int, Float]:
    """Vertices (V, 3), triangles (F, 3) and weights (V, B) by the skin's joints."""
    path, mode = scene.path, _TRIANGLES if primitive.mode is None else primitive.mode
    check(str(path), mode == _TRIANGLES, f"{where}: its mode is {mode}, only triangles (4) can be read; triangulate it")
    attributes: dict[str, Any] = vars(primitive.attributes)
    for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"):
        check(str(path), attributes.get(name) is not None, f"{where}: it has a skin but no {name}")
    vertices = scene.buffers.accessor(attributes["POSITION"], f"{where}: POSITION")
    if primitive.indices is None:
        corners = np.arange(len(vertices))
    else:
        corners = scene.buffers.accessor(primitive.indices, f"{where}: indices").astype(int).ravel()
    check(str(path), len(corners) % 3 == 0, f"{where}: its indices are no whole number of triangles")
    check(str(path), int(corners.max(initial=0)) < len(vertices), f"{where}: indices name a vertex that is not there")
    weights = _weights(scene, attributes, where, (len(vertices), joint_count))
    return vertices, corners.reshape(-1, 3).astype(np.int32), weights


def _weights(scene: Scene, attributes: dict[str, Any], where: str, shape: tuple[int, int]) -> Float:
    """(V, B) weights of the skin's joints, from all sets JOINTS_n and WEIGHTS_n."""
    out, rows = weights_matrix(*shape, str(scene.path)), np.arange(shape[0])
    for name in sorted(n for n, at in attributes.items() if n.startswith("JOINTS_") and at is not None):
        held = scene.buffers.accessor(attributes[name], f"{where}: {name}").astype(int)
        number = attributes.get(name.replace("JOINTS", "WEIGHTS"), -1)
        weight = scene.buffers.accessor(number, f"{where}: {name} weights")
        check(str(scene.path), len(held) == len(weight) == len(rows), f"{where}: {name} and POSITION differ in length")
        known = int(held.max(initial=0)) < shape[1]
        check(str(scene.path), known, f"{where}: {name} names a joint that the skin does not have")
        for k in range(held.shape[1]):
            np.add.at(out, (rows, held[:, k]), weight[:, k])
    return out


def _in_scene(vertices: Float, faces: Int, weights: Float, motions: Float) -> tuple[Float, Int]:
    """The vertices (V, 3) of one primitive in the rest pose, and its faces, reversed where the motion mirrors."""
    if np.array_equal(motions, np.broadcast_to(motions[0], motions.shape)):  # the bind pose
        still = np.array_equal(motions[0], np.eye(4))
        placed, blended = vertices if still else se3.apply(motions[0], vertices), motions[:1]
    else:
        blended = np.einsum("vb,bij->vij", weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12), motions)
        placed = se3.apply(blended, vertices[:, None, :])[:, 0]
    mirrored = float(np.median(np.linalg.det(blended[:, :3, :3]))) < 0
    return placed, np.ascontiguousarray(faces[:, ::-1]) if mirrored else faces


def _joined(parts: list[tuple[Float, Int, Float]]) -> tuple[Float, Int, Float]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _, _ in parts])
    faces = [f + np.int32(start) for (_, f, _), start in zip(parts, starts, strict=False)]
    return np.concatenate([p[0] for p in parts]), np.concatenate(faces), np.concatenate([p[2] for p in parts])


def _own_body(mesh: SkinnedMesh, own: dict[str, Any], path: Path) -> Body:
    """The body of a file of `save_glb`."""

    def numbers(value: Any, width: int) -> Float:
        return number_array(value, (None, width), f"{path}: a number") if value else np.zeros((0, width))

    def indices(value: Any) -> Int:
        return number_array(value, (None,), f"{path}: an index").astype(np.int32)

    try:
        (order, weights), marks = strongest(mesh.weights, own["influences"]), own["landmarks"]
        parent, joint, owner = map(indices, (own["parent"], own["segment_joint"], marks["segments"]))
        twists, limits, points = numbers(own["twists"], 6), numbers(own["limits"], 2), numbers(marks["points"], 3)
        return Body(
            own["name"], tuple(own["coordinates"]), parent, twists, limits, tuple(own["segments"]), joint,
            mesh.vertices @ TO_REST.T, mesh.faces, order, weights,
            Landmarks(tuple(marks["names"]), owner, points),
        )  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        message = f"asset.extras.{EXTRAS} is broken ({error}); pass a rig TOML to read it without."
        raise InputError(f"{path}: {message}") from error
