"""BVH in and out.

Read by pybvh; what is ours is the unit, which the format does not state. Written with the format's y up, facing +z; one
joint per segment, rotations Z Y X.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pybvh

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.gltf_animate import BoneMotion
from twistcap.body.joints import Joint, joints_of
from twistcap.errors import InputError, check, naming
from twistcap.io.angles import decomposed
from twistcap.io.files import write_lines
from twistcap.io.markers import TO_FILE
from twistcap.motion.skeleton import SkeletonMotion, rest_positions

_TO_FILE = TO_FILE["pose2sim"]  # our (x, y, z) -> (y, z, x)
_ZYX = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
# Metres per unit that BVH files come in: metres, CMU's (inches / 0.45), inches, centimetres, millimetres.
UNITS = (1.0, 0.0254 / 0.45, 0.0254, 0.01, 0.001)
_ADULT = 1.65  # m; both the height and the span of the arms are near it


def read_bvh(path: Path | str) -> SkeletonMotion:
    """The motion of a BVH; end sites become joints named after theirs, `<joint>_end`.

    The unit is that of `UNITS` which makes an adult of the rest pose; up is the axis along which the rest pose is
    drawn. Raises InputError if it cannot be read or is no BVH with three rotations a joint, or for numbers that are not
    finite.
    """
    path = Path(path)
    try:
        bvh: Any = pybvh.read_bvh_file(path, warn_on_world_up_disagreement=False)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except Exception as error:  # pybvh raises what its parsing stumbles over: ValueError, IndexError, …
        raise InputError(f"{path}: not a BVH that can be read ({error}).") from error
    tree = bvh.fk_topology
    offsets: Float = np.asarray(tree.offsets, dtype=float)
    places, turns = bvh.to_rotmat()
    moving = np.asarray(tree.joint_idx)
    local = np.where(moving[:, None, None] >= 0, turns[:, moving], np.eye(3))
    unit = _unit(path, rest_positions(offsets, tree.parent_idx))
    up = "z" if str(bvh.rest_up).endswith("z") else "y"
    # The root's own offset is not added to its channels, as in Blender and pybvh.
    with naming(path):
        return SkeletonMotion.from_local(
            path.stem, _names(bvh, tree), list(tree.parent_idx), offsets * unit, local, places * unit, bvh.fps, up
        )


def _names(bvh: Any, tree: Any) -> list[str]:
    names = [str(node.name) for node in bvh.nodes]
    for s, joint in enumerate(tree.joint_idx):
        if joint < 0:
            names[s] = f"{names[tree.parent_idx[s]]}_end"
    return names


def _unit(path: Path, rest: Float) -> float:
    size = float(np.ptp(rest, axis=0).max())
    check(str(path), np.isfinite(size) and size > 0, "its joints have no distances between them")
    return min(UNITS, key=lambda unit: abs(np.log(unit * size / _ADULT)))


def write_bvh(path: Path | str, body: Body, poses: Sequence[Pose], fps: float) -> None:
    """Writes skeleton and motion, in m.

    Axes of one joint that do not meet in a point (ankle and subtalar) become two BVH joints, so that the file's forward
    kinematics are the body's. Raises InputError for a frame rate (1/s) that is not positive, sliding coordinates,
    several root segments, or if the file cannot be written.
    """
    path = Path(path)
    with naming(path):
        joints = joints_of(body)
    heads = np.array([joint.origin for joint in joints]) @ _TO_FILE.T
    names, parents = [joint.name for joint in joints], [joint.parent for joint in joints]
    lines, order = _hierarchy(names, parents, heads, lambda n: _TO_FILE @ _bone_of(body, joints[n]))
    place, turns = _channels(body, joints, poses)
    _write(path, lines, np.hstack([place, np.degrees(turns[:, order]).reshape(len(poses), -1)]), fps)


def write_bone_bvh(path: Path | str, motion: BoneMotion, fps: float) -> None:
    """Writes the motion of a rig of the user's own: its bone names, offsets as in its rest pose, y up as in its file.

    Joints above the root are left out. Raises InputError for a frame rate (1/s) that is not positive, or if the file
    cannot be written.
    """
    mesh, heads, rest, root = motion.rigged.mesh, motion.bind[:, :3, 3], motion.bind[:, :3, :3], motion.rest.root
    parents = [-1 if b == root else int(above) for b, above in enumerate(mesh.parents)]
    names = [name.replace(" ", "_") for name in mesh.joints]
    lines, order = _hierarchy(names, parents, heads, lambda b: 0.2 * (heads[b] - heads[parents[b]]), root)
    world = motion.turns @ rest.swapaxes(1, 2)  # from the file's rest pose
    local = [world[:, b] if b == root else world[:, parents[b]].swapaxes(1, 2) @ world[:, b] for b in order]
    turns = [np.degrees(decomposed(each, _ZYX, np.zeros(3))) for each in local]
    _write(Path(path), lines, np.hstack([motion.places, *turns]), fps)


def _write(path: Path, hierarchy: list[str], rows: Float, fps: float) -> None:
    check(str(path), fps > 0, f"the frame rate is {fps}; it must be positive")
    head = ["HIERARCHY", *hierarchy, "MOTION", f"Frames: {len(rows)}", f"Frame Time: {1.0 / fps:.8f}"]
    write_lines(path, [*head, *(" ".join(f"{v:.6f}" for v in row) for row in rows)])


def _hierarchy(
    names: Sequence[str], parents: Sequence[int], heads: Float, end: Callable[[int], Float], root: int = 0
) -> tuple[list[str], list[int]]:
    """The lines of the joints below a root, and their order, which is that of the channels.

    All in the file's axes: `heads` (J, 3) is where the joints are, and `end` (3,) how far from there the bone of one
    without children goes.
    """
    order = list[int]()

    def lines(n: int, depth: int) -> list[str]:
        order.append(n)
        tab, start = "\t" * depth, heads[parents[n]] if depth else heads[n]  # the root's place is in its channels
        head, places = ("JOINT", "3") if depth else ("ROOT", "6 Xposition Yposition Zposition")
        out = [f"{tab}{head} {names[n]}", f"{tab}{{", _offset(heads[n] - start, depth + 1)]
        out.append(f"{tab}\tCHANNELS {places} Zrotation Yrotation Xrotation")
        below = [m for m, above in enumerate(parents) if above == n]
        for m in below:
            out += lines(m, depth + 1)
        if not below:
            out += [f"{tab}\tEnd Site", f"{tab}\t{{", _offset(end(n), depth + 2), f"{tab}\t}}"]
        return [*out, f"{tab}}}"]

    return lines(root, 0), order


def _offset(vector: Float, depth: int) -> str:
    return "\t" * depth + "OFFSET " + " ".join(f"{v:.8f}" for v in vector)


def _bone_of(body: Body, joint: Joint) -> Float:
    """From the joint of a last segment to where that ends: its farthest landmark, or else its farthest vertex."""
    segment = body.segment(joint.name)
    points = body.landmarks.points[body.landmarks.segments == segment]
    away = np.linalg.norm(points - joint.origin, axis=1)
    if not len(points) or away.max() < 0.01:
        points = np.concatenate([body.vertices[body.vertex_part == segment], joint.origin[None]])
        away = np.linalg.norm(points - joint.origin, axis=1)
    return points[np.argmax(away)] - joint.origin


def _channels(body: Body, joints: list[Joint], poses: Sequence[Pose]) -> tuple[Float, Float]:
    """Place of the root (T, 3) and rotations of every joint in its parent (T, joints, 3; z, y, x) rad."""
    roots = np.array([pose.root for pose in poses]).reshape(-1, 4, 4)
    motions = np.array([Posed(body, pose).joint_transforms for pose in poses]).reshape(len(roots), -1, 4, 4)
    motions = np.concatenate([motions, roots[:, None]], axis=1)  # -1 picks the root
    R = _TO_FILE @ motions[:, [j.moved_by for j in joints], :3, :3] @ _TO_FILE.T
    turns = np.zeros((len(poses), len(joints), 3))
    for n, joint in enumerate(joints):
        local = R[:, n] if joint.parent < 0 else np.swapaxes(R[:, joint.parent], 1, 2) @ R[:, n]
        turns[:, n] = decomposed(local, _ZYX, np.zeros(3))
    return se3.apply(roots, joints[0].origin[None])[:, 0] @ _TO_FILE.T, turns
