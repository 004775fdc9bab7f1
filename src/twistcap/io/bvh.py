"""BVH in and out.

Read by pybvh; what is ours is the unit, which the format does not state. Written with the format's y up, facing +z; one
joint per segment, rotations Z Y X.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from twistcap.motion.skeleton import SkeletonMotion

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
    unit = _unit(path, _rest(offsets, tree.parent_idx))
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


def _rest(offsets: Float, parents: Any) -> Float:
    out = offsets.copy()
    for s in range(1, len(out)):
        out[s] += out[parents[s]]
    return out


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
    check(str(path), fps > 0, f"the frame rate is {fps}; it must be positive")
    with naming(path):
        joints = joints_of(body)
    lines = ["HIERARCHY", *_hierarchy(body, joints, 0, 0), "MOTION"]
    lines += [f"Frames: {len(poses)}", f"Frame Time: {1.0 / fps:.8f}"]
    place, turns = _channels(body, joints, poses)
    order = _depth_first(joints, 0)
    rows = np.hstack([place, np.degrees(turns[:, order]).reshape(len(poses), -1)])
    write_lines(path, [*lines, *(" ".join(f"{v:.6f}" for v in row) for row in rows)])


def write_bone_bvh(path: Path | str, motion: BoneMotion, fps: float) -> None:
    """Writes the motion of a rig of the user's own: its bone names, offsets as in its rest pose, y up as in its file.

    Joints above the root are left out. Raises InputError for a frame rate (1/s) that is not positive, or if the file
    cannot be written.
    """
    check(str(path), fps > 0, f"the frame rate is {fps}; it must be positive")
    mesh, heads, rest = motion.rigged.mesh, motion.bind[:, :3, 3], motion.bind[:, :3, :3]
    order = list[int]()

    def lines(b: int, depth: int) -> list[str]:
        order.append(b)
        tab, head = "\t" * depth, "ROOT" if depth == 0 else "JOINT"
        start = heads[mesh.parents[b]] if depth else heads[b]
        below = [n for n in range(len(heads)) if mesh.parents[n] == b]
        places = "6 Xposition Yposition Zposition" if depth == 0 else "3"
        out = [f"{tab}{head} {mesh.joints[b].replace(' ', '_')}", f"{tab}{{", _offset_line(heads[b] - start, depth + 1)]
        out.append(f"{tab}\tCHANNELS {places} Zrotation Yrotation Xrotation")
        for n in below:
            out += lines(n, depth + 1)
        if not below:  # along the bone of its parent, a fifth as long
            out += [f"{tab}\tEnd Site", f"{tab}\t{{", _offset_line(0.2 * (heads[b] - start), depth + 2), f"{tab}\t}}"]
        return [*out, f"{tab}}}"]

    tree = ["HIERARCHY", *lines(motion.rest.root, 0), "MOTION", f"Frames: {len(motion.places)}"]
    world = motion.turns @ rest.swapaxes(1, 2)  # from the file's rest pose
    local = {b: world[:, mesh.parents[b]].swapaxes(1, 2) @ world[:, b] for b in order[1:]} | {
        order[0]: world[:, order[0]]
    }
    turns = [np.degrees(decomposed(local[b], _ZYX, np.zeros(3))) for b in order]
    rows = np.hstack([motion.places, *turns])
    text = [*tree, f"Frame Time: {1.0 / fps:.8f}", *(" ".join(f"{v:.6f}" for v in row) for row in rows)]
    write_lines(Path(path), text)


def _hierarchy(body: Body, joints: list[Joint], number: int, depth: int) -> list[str]:
    joint, tab = joints[number], "\t" * depth
    start = joints[joint.parent].origin if joint.parent >= 0 else joint.origin  # the root's place is in its channels
    head = "ROOT" if joint.parent < 0 else "JOINT"
    places = "6 Xposition Yposition Zposition" if joint.parent < 0 else "3"
    lines = [f"{tab}{head} {joint.name}", f"{tab}{{", _offset(joint.origin - start, depth + 1)]
    lines.append(f"{tab}\tCHANNELS {places} Zrotation Yrotation Xrotation")
    below = [n for n, other in enumerate(joints) if other.parent == number]
    for n in below:
        lines += _hierarchy(body, joints, n, depth + 1)
    if not below:
        end = _offset(_tip(body, joint) - joint.origin, depth + 2)
        lines += [f"{tab}\tEnd Site", f"{tab}\t{{", end, f"{tab}\t}}"]
    return [*lines, f"{tab}}}"]


def _offset(vector: Float, depth: int) -> str:
    return _offset_line(_TO_FILE @ vector, depth)


def _offset_line(vector: Float, depth: int) -> str:
    return "\t" * depth + "OFFSET " + " ".join(f"{v:.8f}" for v in vector)


def _tip(body: Body, joint: Joint) -> Float:
    """Where a last segment ends: its farthest landmark, or else its farthest vertex."""
    segment = body.segment(joint.name)
    points = body.landmarks.points[body.landmarks.segments == segment]
    away = np.linalg.norm(points - joint.origin, axis=1)
    if not len(points) or away.max() < 0.01:
        points = np.concatenate([body.vertices[body.vertex_part == segment], joint.origin[None]])
        away = np.linalg.norm(points - joint.origin, axis=1)
    return points[np.argmax(away)]


def _depth_first(joints: list[Joint], number: int) -> list[int]:
    """Joints in the order of the hierarchy, which is that of the channels."""
    below = [n for n, other in enumerate(joints) if other.parent == number]
    return [number] + [m for n in below for m in _depth_first(joints, n)]


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
