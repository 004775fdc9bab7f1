"""Motion into a rigged GLB of the user's own: its bones, rest pose, surface, UVs and materials stay as they are.

Bones keep their lengths: the motion is the rotations of all bones that move, and the place of the root. A body whose
lengths were fitted moves the file's bones by the same angles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gl
from scipy.spatial.transform import Rotation

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body._gltf_buffers import TO_REST, Packer, noted, quaternions
from twistcap.body.gltf import Rigged, load_rigged
from twistcap.body.kinematics import Pose, Posed
from twistcap.body.model import Body
from twistcap.body.rig import RestJoints, in_tree_order, rest_joints
from twistcap.body.rig_spec import RigSpec
from twistcap.errors import check

_STILL = 1e-5  # rad or m by which a bone that has no channel may differ from its rest
_STATURES = (0.5, 2.0)  # of a tracked body, as factors on its file's
_APART = 0.15  # of the height; legs that are longer by a fifth put no joint so far from its place
_MEND = "give the file that the session names, and its rig file with --rig where it has one"


@dataclass(frozen=True)
class BoneMotion:
    """The motion of a file's B joints over T frames, in glTF's axes (y up).

    Attributes:
        rigged: the file.
        rest: its joints in the body's rest pose.
        turns: (T, B, 3, 3) rotations of the joints' frames to the world; NaN for joints above the root, which stay.
        places: (T, 3) of the root's head, in the file's unit.
    """

    rigged: Rigged
    rest: RestJoints
    turns: Float
    places: Float

    @property
    def bind(self) -> Float:
        """(B, 4, 4) frames of the joints in the file's rest pose; rotations, without the file's scale."""
        frames = self.rigged.mesh.frames
        return se3.transform(_rotation(frames[:, :3, :3]), frames[:, :3, 3])


def bone_motion(
    body: Body, poses: Sequence[Pose], source: Path | str, rig: Path | str | RigSpec | None = None
) -> BoneMotion:
    """The poses of a body as motion of the joints of the GLB that it was made of.

    Raises InputError for a file that `load_rigged` refuses, or whose joints are not the body's, by name or by place.
    """
    rigged = load_rigged(source, rig)
    check(str(source), _same_joints(rigged.body, body), f"its joints are not those of the tracked body; {_MEND}")
    rest = rest_joints(rigged.mesh, rigged.spec)
    motions = np.array([Posed(body, pose).segment_transforms for pose in poses])
    turns = TO_REST.T @ motions[:, rest.owner, :3, :3] @ rest.frames[:, :3, :3]
    turns[:, rest.owner < 0] = np.nan
    # The root's head in the tracked body: its own rest pose may have other lengths, but the root is its origin's frame.
    head = se3.apply(motions[:, rest.owner[rest.root]], rest.frames[rest.root, :3, 3][None])[:, 0]
    return BoneMotion(rigged, rest, turns, head @ TO_REST / rigged.spec.scale)


def _same_joints(file: Body, body: Body) -> bool:
    """Whether two bodies have joints of the same names, and but for their statures in about the same places."""
    if file.segment_names != body.segment_names or file.coordinate_names != body.coordinate_names:
        return False
    size, own = (float(np.ptp(each.vertices, axis=0).max()) for each in (body, file))
    apart = np.clip(size / own, *_STATURES) * file.joint_origins - body.joint_origins
    return bool(np.abs(apart).max() < _APART * size)


def animate_glb(motion: BoneMotion, path: Path | str, times: Float, notes: Mapping[str, Any] | None = None) -> None:
    """Write the file with the motion as its first animation, keys at `times` (T,) s, `notes` in its extras; everything
    else stays.

    Raises InputError for a file that is not binary, times that do not rise from 0, or if it cannot be written.
    """
    scene, gltf = motion.rigged.scene, motion.rigged.scene.gltf
    whole = gltf.binary_blob() and gltf.buffers[0].uri is None
    check(str(scene.path), whole, "motion goes into a GLB, not into a .gltf")
    pack = Packer(gltf)
    keys = pack.add_times(times, len(motion.places), path)
    animation = gl.Animation(name="twistcap", extras=noted(notes))
    for node, kind, values in _channels(motion):
        pack.add_channel(animation, keys, node, kind, values)
        _without_matrix(gltf.nodes[node])
    gltf.animations.insert(0, animation)
    pack.save(path)


def _channels(motion: BoneMotion) -> list[tuple[int, str, Float]]:
    """(node, "rotation" or "translation", values (T, 4) or (T, 3)) of every node that moves within its parent."""
    scene, T = motion.rigged.scene, len(motion.places)
    joint = {node: b for b, node in enumerate(scene.joints) if motion.rest.owner[b] >= 0}
    world = np.tile(_rotation(scene.world[:, :3, :3]), (T, 1, 1, 1))
    local = _rotation(np.array([scene.local(n)[:3, :3] for n in range(len(scene.parents))]))
    out = list[tuple[int, str, Float]]()
    for n in in_tree_order(scene.parents):
        above = world[:, scene.parents[n]] if scene.parents[n] >= 0 else np.tile(np.eye(3), (T, 1, 1))
        if n not in joint:
            world[:, n] = above @ local[n]
            continue
        world[:, n] = motion.turns[:, joint[n]]
        turns = above.swapaxes(1, 2) @ world[:, n]
        if np.abs(turns - local[n]).max() > _STILL:
            out.append((n, "rotation", quaternions(turns)))
    root = scene.joints[motion.rest.root]
    above = scene.world[scene.parents[root]] if scene.parents[root] >= 0 else np.eye(4)
    places = (motion.places - above[:3, 3]) @ np.linalg.inv(above[:3, :3]).T
    return [*out, (root, "translation", places)]


def _rotation(matrices: Float) -> Float:
    """(…, 3, 3) without scale."""
    return matrices / np.linalg.norm(matrices, axis=-2, keepdims=True)


def _without_matrix(node: Any) -> None:
    """Animated nodes have translation, rotation and scale in place of a matrix, as glTF wants it."""
    if node.matrix is None:
        return
    M = np.array(node.matrix, dtype=float).reshape(4, 4).T
    node.matrix, node.translation = None, M[:3, 3].tolist()
    node.scale = np.linalg.norm(M[:3, :3], axis=0).tolist()
    node.rotation = Rotation.from_matrix(_rotation(M[:3, :3])).as_quat().tolist()
