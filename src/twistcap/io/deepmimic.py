"""DeepMimic's motions in: JSON of Peng et al. 2018 (DOI 10.1145/3197517.3201311) and its skeleton `humanoid3d.txt`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field
from scipy.spatial.transform import Rotation, Slerp

from twistcap import se3
from twistcap.arrays import Float
from twistcap.doors.strict import validated
from twistcap.doors.text import number_array, read_json_table
from twistcap.errors import InputError, check, naming
from twistcap.motion.skeleton import SkeletonMotion

SKELETON = "humanoid3d.txt"
_UNEVEN = 5.0  # log of the greatest ratio of a duration to the usual one
_WIDTHS = {"spherical": 4, "revolute": 1, "fixed": 0}


class _Joint(BaseModel):
    Name: str
    Type: str
    Parent: int
    AttachX: float = Field(ge=-1e3, le=1e3)
    AttachY: float = Field(ge=-1e3, le=1e3)
    AttachZ: float = Field(ge=-1e3, le=1e3)


class _Skeleton(BaseModel):
    Joints: tuple[_Joint, ...] = Field(min_length=1)


class _SkeletonFile(BaseModel):
    Skeleton: _Skeleton


def read_deepmimic(path: Path | str, skeleton: Path | str | None = None) -> SkeletonMotion:
    """The motion of a DeepMimic clip.

    A frame is: its duration s, root position m, then quaternions (w x y z) of the root and the spherical joints, and
    angles rad of the revolute ones, which turn about z. Unequal durations are brought to their median by slerp.
    The skeleton None is `humanoid3d.txt` beside the clip. Raises InputError if a file is missing or no such JSON, a
    frame has the wrong length, or a number is not finite.
    """
    path = Path(path)
    content = read_json_table(path)
    joints = _joints(Path(skeleton) if skeleton is not None else path.with_name(SKELETON))
    rows = _rows(path, content, 8 + sum(_WIDTHS[joint.Type] for joint in joints[1:]))
    local = np.tile(np.eye(3), (len(rows), len(joints), 1, 1))
    local[:, 0], at = _of_quaternions(path, rows[:, 4:8]), 8
    for s, joint in enumerate(joints[1:], start=1):
        values = rows[:, at : at + _WIDTHS[joint.Type]]
        at += values.shape[1]
        if joint.Type == "spherical":
            local[:, s] = _of_quaternions(path, values)
        elif joint.Type == "revolute":
            local[:, s] = se3.exp_rotation(values * np.array([0.0, 0.0, 1.0]))
    offsets = np.array([(joint.AttachX, joint.AttachY, joint.AttachZ) for joint in joints])
    step, places, local = _even(path, rows[:-1, 0], rows[:, 1:4], local)
    names, parents = [joint.Name for joint in joints], [-1, *(joint.Parent for joint in joints[1:])]
    with naming(path):
        return SkeletonMotion.from_local(path.stem, names, parents, offsets, local, places, 1.0 / step, "y")


def _joints(path: Path) -> tuple[_Joint, ...]:
    check(str(path), path.is_file(), "DeepMimic's skeleton is not there; put it beside the clip or give skeleton=…")
    skeleton: _Skeleton = validated(_SkeletonFile, read_json_table(path), str(path)).Skeleton
    for s, joint in enumerate(skeleton.Joints[1:], start=1):
        if joint.Type not in _WIDTHS or not 0 <= joint.Parent < s:
            raise InputError(f"{path}: joint {joint.Name!r} has an unknown type or comes before its parent.")
    return skeleton.Joints


def _rows(path: Path, content: dict[str, Any], width: int) -> Float:
    """(N, width) the frames, every number finite."""
    frames = content.get("Frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: not a DeepMimic clip (no Frames).")
    return np.array([number_array(frame, (width,), f"{path}: frame {n}") for n, frame in enumerate(frames)])


def _of_quaternions(path: Path, values: Float) -> Float:
    if np.any(np.linalg.norm(values, axis=1) < 0.5):
        raise InputError(f"{path}: a quaternion has no direction (its length is below ½).")
    return Rotation.from_quat(values, scalar_first=True).as_matrix()


def _even(path: Path, durations: Float, places: Float, local: Float) -> tuple[float, Float, Float]:
    """Time step, places and rotations at even times."""
    check(str(path), len(durations), "one frame is no motion")
    step = float(np.median(durations))
    if not (np.all(durations > 0) and 1e-4 < step < 10.0 and np.all(np.abs(np.log(durations / step)) < _UNEVEN)):
        raise InputError(f"{path}: the duration of a frame is not positive, or far from that of the others.")
    if np.allclose(durations, step, rtol=0.01):
        return step, places, local
    times = np.concatenate([[0.0], np.cumsum(durations)])
    even = np.arange(int(times[-1] / step + 1e-6) + 1) * step
    even = even[even <= times[-1]]
    turned = [Slerp(times, Rotation.from_matrix(local[:, s]))(even).as_matrix() for s in range(local.shape[1])]
    moved = np.stack([np.interp(even, times, places[:, k]) for k in range(3)], axis=1)
    return step, moved, np.stack(turned, axis=1)
