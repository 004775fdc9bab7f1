"""A body, and its motion if there is one, as a GLB."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gl

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body._gltf_buffers import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, EXTRAS, TO_REST, Packer, noted, quaternions
from twistcap.body.kinematics import Pose, Posed, vertex_normals
from twistcap.body.model import Body


def save_glb(
    body: Body, path: Path | str, poses: Sequence[Pose] | None = None, times: Float | None = None,
    notes: Mapping[str, Any] | None = None,
) -> None:  # fmt: skip
    """Write skin, surface (float32) and (with `poses` at `times` (T,) s) an animation, `notes` in its extras.

    There is one joint node per segment, at the segment's proximal joint; the skinned mesh is at the root. Our own
    coordinates are in `asset.extras`. Raises InputError for poses whose times are not as many or do not rise from 0,
    or if the file cannot be written.
    """
    gltf = gl.GLTF2(asset=gl.Asset(version="2.0", generator="twistcap", extras={EXTRAS: _extras(body)}), scene=0)
    pack = Packer(gltf)
    origins = body.joint_origins
    _add_nodes(gltf, body, origins)
    _add_skin(gltf, pack, origins)
    _add_mesh(gltf, pack, body)
    if poses:
        _add_animation(gltf, pack, body, origins, poses, pack.add_times(times, len(poses), path))
        gltf.animations[-1].extras = noted(notes)
    pack.save(path)


def _extras(body: Body) -> dict[str, Any]:
    marks = body.landmarks
    return {
        "version": 1, "name": body.name, "coordinates": list(body.coordinate_names), "parent": body.parent.tolist(),
        "twists": body.twists.tolist(), "limits": body.limits.tolist(), "segments": list(body.segment_names),
        "segment_joint": body.segment_joint.tolist(), "influences": int(body.skin_weights.shape[1]),
        "landmarks": {"names": list(marks.names), "segments": marks.segments.tolist(), "points": marks.points.tolist()},
    }  # fmt: skip


def _add_nodes(gltf: gl.GLTF2, body: Body, origins: Float) -> None:
    """Node s is segment s; then come the armature above them and the mesh."""
    S, above = len(origins), body.segment_parent
    for s, name in enumerate(body.segment_names):
        offset = TO_REST.T @ (origins[s] - (origins[above[s]] if above[s] >= 0 else 0.0))
        children = [int(c) for c in np.flatnonzero(above == s)]
        gltf.nodes.append(gl.Node(name=name, children=children, translation=offset.tolist()))
    gltf.nodes.append(gl.Node(name="armature", children=[int(c) for c in np.flatnonzero(above < 0)]))
    gltf.nodes.append(gl.Node(name=body.name, mesh=0, skin=0))
    gltf.scenes.append(gl.Scene(nodes=[S, S + 1]))


def _add_skin(gltf: gl.GLTF2, pack: Packer, origins: Float) -> None:
    inverse_binds = se3.transform(np.eye(3), -origins @ TO_REST)
    matrices = pack.add(inverse_binds.transpose(0, 2, 1).astype(np.float32), "MAT4")
    S = len(origins)
    gltf.skins.append(gl.Skin(joints=list(range(S)), skeleton=S, inverseBindMatrices=matrices, extras={EXTRAS: True}))


def _add_mesh(gltf: gl.GLTF2, pack: Packer, body: Body) -> None:
    attributes, vertices = gl.Attributes(), body.vertices @ TO_REST
    normals = vertex_normals(vertices, body.faces)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 1.0, 0.0])
    attributes.POSITION = pack.add(vertices.astype(np.float32), "VEC3", ARRAY_BUFFER, bounds=True)
    attributes.NORMAL = pack.add(normals.astype(np.float32), "VEC3", ARRAY_BUFFER)
    V, K = body.skin_weights.shape
    sets = -(-K // 4)
    segments, weights = np.zeros((V, 4 * sets), np.uint16), np.zeros((V, 4 * sets), np.float32)
    weights[:, :K] = body.skin_weights
    segments[:, :K] = np.where(body.skin_weights > 0, body.skin_segments, 0)  # glTF's validator wants 0 where unused
    for n in range(sets):
        part = slice(4 * n, 4 * n + 4)
        setattr(attributes, f"JOINTS_{n}", pack.add(segments[:, part], "VEC4", ARRAY_BUFFER))
        setattr(attributes, f"WEIGHTS_{n}", pack.add(weights[:, part], "VEC4", ARRAY_BUFFER))
    indices = pack.add(body.faces.astype(np.uint32).ravel(), "SCALAR", ELEMENT_ARRAY_BUFFER)
    grey = gl.PbrMetallicRoughness(baseColorFactor=[0.8, 0.8, 0.8, 1.0], metallicFactor=0.0, roughnessFactor=0.9)
    gltf.materials.append(gl.Material(name="body", pbrMetallicRoughness=grey))
    primitive = gl.Primitive(attributes=attributes, indices=indices, material=0)
    gltf.meshes.append(gl.Mesh(name=body.name, primitives=[primitive]))


def _add_animation(gltf: gl.GLTF2, pack: Packer, body: Body, origins: Float, poses: Sequence[Pose], keys: int) -> None:
    rotations, translations = local_motions(body, origins, poses)
    animation = gl.Animation(name="motion")
    for s in range(len(origins)):
        for path, values in (("rotation", rotations), ("translation", translations)):
            pack.add_channel(animation, keys, s, path, values[:, s])
    gltf.animations.append(animation)


def local_motions(body: Body, origins: Float, poses: Sequence[Pose]) -> tuple[Float, Float]:
    """Quaternions (T, S, 4; x y z w, continuous in time) and translations (T, S, 3) of each segment in its parent. In
    glTF's axes; a segment's frame is at its origin (S, 3), without rotation in the rest pose."""
    motions = np.array([Posed(body, pose).segment_transforms for pose in poses])
    C = se3.transform(TO_REST.T, np.zeros(3))
    frames = C @ motions @ se3.transform(np.eye(3), origins) @ C.T
    above = body.segment_parent
    local = np.where((above >= 0)[:, None, None], se3.inverse(frames[:, above]) @ frames, frames)
    return quaternions(local[..., :3, :3]), local[..., :3, 3]
