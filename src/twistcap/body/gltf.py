"""Any skinned GLB or glTF as a `Body`, and bodies with their motion as GLB.

glTF 2.0 (ISO/IEC 12113:2022): y up, facing +z, m. The rest pose is the bind pose, in which skinning is exact: vertices
as stored and joints where the inverse bind matrices put them, both carried into the scene by the root joint's own
motion. Without inverse bind matrices it is the pose of the nodes. Coordinates that are no part of glTF travel in
`asset.extras.twistcap`, so that a body saved here loads as the same body, while a viewer sees skin and animation.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pygltflib import GLTF2

from twistcap import se3
from twistcap._typing import Float, Int
from twistcap.body._gltf_buffers import EXTRAS, TO_REST, Buffers
from twistcap.body.gltf_write import save_glb
from twistcap.body.model import Body, Landmarks
from twistcap.body.rig import SkinnedMesh, build_body, in_tree_order, welded
from twistcap.body.rig_spec import RigSpec, read_rig
from twistcap.errors import InputError

__all__ = ["load_glb", "save_glb"]

_TRIANGLES = 4


def load_glb(path: Path | str, rig: Path | str | RigSpec | None = None, influences: int = 8) -> Body:
    """The skinned mesh of a GLB or glTF as a body.

    Args:
        path: the file. One that `save_glb` wrote comes back as it was (no `rig` is read then, unless given).
        rig: what the joints mean (`rig_spec`). Default: <name>.rig.toml beside the file if it is there, else every
            joint is a ball joint without limits.
        influences: most segments that hold one vertex.

    Raises:
        InputError: if the file cannot be read or has no skin, for primitives that are not triangles, buffers that are
            missing, compressed or too short, and for what `build_body` refuses.
    """
    path = Path(path)
    gltf = _open(path)
    own = (gltf.asset.extras or {}).get(EXTRAS)
    mesh = _read_mesh(gltf, path, own is not None)
    if own is not None and rig is None:
        return _own_body(mesh, own, path)
    beside = path.with_name(path.stem + ".rig.toml")
    if rig is None and beside.is_file():
        rig = beside
    spec = rig if isinstance(rig, RigSpec) else read_rig(rig) if rig is not None else RigSpec()
    return build_body(mesh, spec, influences)


def _open(path: Path) -> GLTF2:
    if not path.is_file():
        raise InputError(f"{path}: there is no such file.")
    try:
        gltf = GLTF2().load(str(path))
    except Exception as error:  # pygltflib lets out whatever its parsers raise
        raise InputError(f"{path}: not a glTF file ({type(error).__name__}: {error}).") from error
    if gltf is None:
        raise InputError(f"{path}: not a glTF file.")
    wanted = [name for name in gltf.extensionsRequired or [] if "compression" in name or "quantization" in name]
    if wanted:
        raise InputError(f"{path}: needs {', '.join(wanted)}; export it without compression.")
    if not gltf.skins:
        raise InputError(f"{path}: it has no skin (skins is empty); export the mesh together with its armature.")
    return gltf


def _read_mesh(gltf: GLTF2, path: Path, as_is: bool) -> SkinnedMesh:
    """All skinned meshes of the file as one, in glTF's axes."""
    buffers = Buffers(gltf, path)
    node_parents = _node_parents(gltf, path)
    world = _node_worlds(gltf, node_parents)
    joints = _joints_in_order(gltf, node_parents)
    column = {node: b for b, node in enumerate(joints)}
    binds = [_bind_motions(gltf, buffers, skin, world) for skin in range(len(gltf.skins))]
    parts: list[tuple[Float, Int, Float]] = []
    for node in gltf.nodes:
        if node.skin is None or node.mesh is None:
            continue
        _expect(node.skin < len(gltf.skins), path, f"node {node.name!r} names skin {node.skin}, which does not exist")
        columns = np.array([column[j] for j in gltf.skins[node.skin].joints])
        for number, primitive in enumerate(gltf.meshes[node.mesh].primitives):
            where = f"mesh {gltf.meshes[node.mesh].name or node.mesh!r}, primitive {number}"
            vertices, faces, influences = _primitive(buffers, primitive, path, where, len(columns))
            weights = np.zeros((len(vertices), len(joints)))
            weights[:, columns] = influences
            parts.append((*_in_scene(vertices, faces, weights, binds[node.skin][0], columns),))
    _expect(bool(parts), path, "no mesh uses its skin")
    vertices, faces, weights = _joined(parts)
    if not as_is:
        vertices, faces, weights = welded(vertices, faces, weights)
    return SkinnedMesh(
        name=path.stem,
        source=path.name,
        joints=_joint_names(gltf, joints),
        parents=np.array([_joint_above(node_parents, node, column) for node in joints], dtype=np.int32),
        frames=_joint_frames(gltf, binds, joints),
        vertices=vertices,
        faces=faces,
        weights=weights,
    )


def _node_parents(gltf: GLTF2, path: Path) -> list[int]:
    parents = [-1] * len(gltf.nodes)
    for number, node in enumerate(gltf.nodes):
        for child in node.children or []:
            _expect(0 <= child < len(parents), path, f"node {number} has the child {child}, which does not exist")
            parents[child] = number
    _expect(len(in_tree_order(parents)) == len(parents), path, "its nodes form a ring instead of a tree")
    return parents


def _node_worlds(gltf: GLTF2, parents: list[int]) -> Float:
    world = np.zeros((len(parents), 4, 4))
    for n in in_tree_order(parents):
        world[n] = (world[parents[n]] if parents[n] >= 0 else np.eye(4)) @ _node_matrix(gltf.nodes[n])
    return world


def _node_matrix(node: Any) -> Float:
    if node.matrix is not None:
        return np.array(node.matrix, dtype=float).reshape(4, 4).T
    x, y, z, w = node.rotation or (0.0, 0.0, 0.0, 1.0)
    sine = float(np.linalg.norm([x, y, z]))
    omega = np.array([x, y, z]) * (2.0 * np.arctan2(sine, w) / sine if sine > 0 else 0.0)
    R = se3.exp_rotation(omega) * np.array(node.scale or (1.0, 1.0, 1.0))
    return se3.transform(R, np.array(node.translation or (0.0, 0.0, 0.0)))


def _joints_in_order(gltf: GLTF2, parents: list[int]) -> list[int]:
    used = {joint for skin in gltf.skins for joint in skin.joints}
    if any(EXTRAS in (skin.extras or {}) for skin in gltf.skins):
        return list(gltf.skins[0].joints)  # our own file: segments in their order
    return [n for n in in_tree_order(parents) if n in used]


def _joint_names(gltf: GLTF2, joints: list[int]) -> tuple[str, ...]:
    names: list[str] = []
    for node in joints:
        name = gltf.nodes[node].name or f"joint_{node}"
        names.append(name if name not in names else f"{name}_{node}")
    return tuple(names)


def _joint_above(parents: list[int], node: int, column: dict[int, int]) -> int:
    node = parents[node]
    while node >= 0 and node not in column:
        node = parents[node]
    return column.get(node, -1)


def _bind_motions(gltf: GLTF2, buffers: Buffers, number: int, world: Float) -> tuple[Float, Float]:
    """Motions (B, 4, 4) of the stored vertices to the rest pose, by joint, and the joints' frames (B, 4, 4) there."""
    skin = gltf.skins[number]
    nodes = world[skin.joints]
    if skin.inverseBindMatrices is None:
        return nodes, nodes
    inverse_binds = buffers.accessor(skin.inverseBindMatrices, f"skin {number}: inverseBindMatrices")
    inverse_binds = inverse_binds.reshape(-1, 4, 4).transpose(0, 2, 1)
    if len(inverse_binds) != len(nodes) or not np.all(np.abs(np.linalg.det(inverse_binds)) > 1e-18):
        raise InputError(f"{buffers.path}: skin {number}: inverseBindMatrices must be one invertible matrix per joint.")
    root = int(np.argmin([_depth(gltf, joint) for joint in skin.joints]))
    motion = nodes[root] @ inverse_binds[root]
    return np.broadcast_to(motion, nodes.shape), motion @ np.linalg.inv(inverse_binds)


def _depth(gltf: GLTF2, node: int) -> int:
    above = [n for n, other in enumerate(gltf.nodes) if node in (other.children or [])]
    return 1 + _depth(gltf, above[0]) if above else 0


def _joint_frames(gltf: GLTF2, binds: list[tuple[Float, Float]], joints: list[int]) -> Float:
    found: dict[int, Float] = {}
    for skin, (_, frames) in zip(gltf.skins, binds, strict=True):
        for joint, frame in zip(skin.joints, frames, strict=True):
            found.setdefault(joint, frame)
    return np.array([found[joint] for joint in joints])


def _primitive(buffers: Buffers, primitive: Any, path: Path, where: str, joint_count: int) -> tuple[Float, Int, Float]:
    """Vertices (V, 3), triangles (F, 3) and weights (V, B) by the skin's joints."""
    mode = _TRIANGLES if primitive.mode is None else primitive.mode
    _expect(mode == _TRIANGLES, path, f"{where}: its mode is {mode}, only triangles (4) can be read; triangulate it")
    attributes = vars(primitive.attributes)
    _expect(attributes.get("JOINTS_0") is not None, path, f"{where}: it has a skin but no JOINTS_0")
    _expect(attributes.get("WEIGHTS_0") is not None, path, f"{where}: it has a skin but no WEIGHTS_0")
    _expect(attributes.get("POSITION") is not None, path, f"{where}: it has no POSITION")
    vertices = buffers.accessor(attributes["POSITION"], f"{where}: POSITION")
    weights = np.zeros((len(vertices), joint_count))
    rows = np.arange(len(vertices))
    for name in sorted(n for n, at in attributes.items() if n.startswith("JOINTS_") and at is not None):
        held = buffers.accessor(attributes[name], f"{where}: {name}").astype(int)
        share = buffers.accessor(attributes[name.replace("JOINTS", "WEIGHTS")], f"{where}: {name} weights")
        _expect(len(held) == len(share) == len(rows), path, f"{where}: {name} and POSITION differ in length")
        _expect(int(held.max(initial=0)) < joint_count, path, f"{where}: {name} names a joint the skin has not")
        for k in range(held.shape[1]):
            np.add.at(weights, (rows, held[:, k]), share[:, k])
    if primitive.indices is None:
        corners = rows
    else:
        corners = buffers.accessor(primitive.indices, f"{where}: indices").astype(int).ravel()
    _expect(len(corners) % 3 == 0, path, f"{where}: its indices are no whole number of triangles")
    _expect(int(corners.max(initial=0)) < len(rows), path, f"{where}: indices name a vertex that does not exist")
    return vertices, corners.reshape(-1, 3).astype(np.int32), weights


def _in_scene(vertices: Float, faces: Int, weights: Float, motions: Float, columns: Int) -> tuple[Float, Int, Float]:
    """The vertices of one primitive in the rest pose; faces turned over where the motion mirrors."""
    share = weights[:, columns] / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    if np.allclose(motions, motions[0], atol=1e-12):
        blended = motions[:1]
        placed = vertices if np.array_equal(motions[0], np.eye(4)) else se3.apply(motions[0], vertices)
    else:
        blended = np.einsum("vb,bij->vij", share, motions)
        placed = se3.apply(blended, vertices[:, None, :])[:, 0]
    mirrored = float(np.median(np.linalg.det(blended[:, :3, :3]))) < 0
    return placed, np.ascontiguousarray(faces[:, ::-1]) if mirrored else faces, weights


def _joined(parts: list[tuple[Float, Int, Float]]) -> tuple[Float, Int, Float]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _, _ in parts])
    faces = [f + np.int32(start) for (_, f, _), start in zip(parts, starts, strict=False)]
    return np.concatenate([p[0] for p in parts]), np.concatenate(faces), np.concatenate([p[2] for p in parts])


def _own_body(mesh: SkinnedMesh, own: dict[str, Any], path: Path) -> Body:
    """The body that `save_glb` wrote."""
    try:
        order = np.argsort(-mesh.weights, axis=1, kind="stable")[:, : own["influences"]].astype(np.int32)
        weights = np.take_along_axis(mesh.weights, order, axis=1)
        marks = own["landmarks"]
        return Body(
            name=own["name"],
            coordinate_names=tuple(own["coordinates"]),
            parent=np.array(own["parent"], dtype=np.int32),
            twists=np.array(own["twists"], dtype=float).reshape(-1, 6),
            limits=np.array(own["limits"], dtype=float).reshape(-1, 2),
            segment_names=tuple(own["segments"]),
            segment_joint=np.array(own["segment_joint"], dtype=np.int32),
            vertices=mesh.vertices @ TO_REST.T,
            faces=mesh.faces,
            skin_segments=order,
            skin_weights=weights / weights.sum(axis=1, keepdims=True),
            landmarks=Landmarks(
                tuple(marks["names"]),
                np.array(marks["segments"], dtype=np.int32),
                np.array(marks["points"], dtype=float).reshape(-1, 3),
            ),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: asset.extras.{EXTRAS} is broken ({error}); pass a rig TOML to read it without."
        ) from error


def _expect(holds: bool, path: Path, message: str) -> None:
    if not holds:
        raise InputError(f"{path}: {message}.")
