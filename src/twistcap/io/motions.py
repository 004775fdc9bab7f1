"""`read_motion` and `write_motion`: any motion file as a clip in a body's coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twistcap import se3
from twistcap.arrays import UNEVEN, Bool, Float, even_clock, runs
from twistcap.body import Body
from twistcap.errors import InputError
from twistcap.io.asf import read_amc
from twistcap.io.bvh import read_bvh, write_bvh
from twistcap.io.deepmimic import read_deepmimic
from twistcap.io.markers import WorldAxes
from twistcap.io.motion_files import poses_of_file, write_mot
from twistcap.io.result import read_result
from twistcap.motion import MotionClip, SkeletonMotion, SkeletonTable, body_table, read_table, retarget, skeleton_of

SKELETON_FILES = (".bvh", ".amc", ".txt", ".json")
COORDINATE_FILES = (".mot", ".sto", ".h5", ".hdf5")


def read_motion(
    path: Path | str, body: Body, *, skeleton: Path | str | None = None,
    table: Path | str | SkeletonTable | None = None, rate: float | None = None, scale: float | None = None,
    axes: WorldAxes = "opensim",
) -> MotionClip:  # fmt: skip
    """The motion of a file in a body's coordinates, z up.

    BVH, AMC and DeepMimic's JSON are retargeted (`motion.retarget`); a rest pose that stands as first frame is cut.
    MOT, STO and our results hold coordinates already, which pass as they are if the body has them; of a result the
    longest stretch that was not lost is taken.

    Args:
        path: .bvh, .amc, .txt or .json (DeepMimic), .mot, .sto, .h5.
        skeleton: the ASF of an AMC or DeepMimic's humanoid3d.txt, where it is not beside the motion.
        table: what the skeleton's joints mean, or its TOML (docs/formats/motion-files.md); None takes one of ours.
        rate: poses per second of the clip; None keeps the file's.
        scale: of the root's path when retargeted; None takes the ratio of the legs' lengths.
        axes: how the world of a MOT is turned about the vertical, see `io.markers`.

    Raises InputError if the file is missing, broken, of an unknown kind or skeleton, or a number is not finite.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind in COORDINATE_FILES:
        source, clip = _of_mot(path, axes) if kind in (".mot", ".sto") else _of_result(path)
        clip = _carried(source, clip, body, scale)
    else:
        motion = without_rest_frame(read_skeleton(path, skeleton))
        known = read_table(table) if isinstance(table, (str, Path)) else table
        motion = motion if rate is None else motion.resampled(rate)  # rotations on geodesics, before they become angles
        return retarget(motion, body, known, scale)
    return clip if rate is None or rate == clip.rate else clip.resampled(rate)


def write_motion(path: Path | str, body: Body, clip: MotionClip, axes: WorldAxes = "opensim") -> None:
    """A clip as MOT, STO or BVH, by the file's ending; lengths in m.

    `axes` is how the world of a MOT is turned about the vertical, see `io.markers`. Raises InputError for another
    ending, a clip of other coordinates, or if the file cannot be written.
    """
    path = Path(path)
    if clip.names != body.coordinate_names:
        raise InputError(f"motion {clip.name!r}: its coordinates are not those of body {body.name!r}.")
    kind = path.suffix.lower()
    if kind in (".mot", ".sto"):
        write_mot(path, body, np.arange(len(clip)) / clip.rate, clip.poses(), axes)
    elif kind == ".bvh":
        write_bvh(path, body, clip.poses(), clip.rate)
    else:
        raise InputError(f"motion {path} has an unknown ending; motions are written as .mot, .sto or .bvh.")


def read_skeleton(path: Path | str, skeleton: Path | str | None = None) -> SkeletonMotion:
    """The motion of a skeleton file as it stands: .bvh, .amc, .txt or .json of DeepMimic. Raises InputError as
    `read_motion`."""
    path = Path(path)
    kind = path.suffix.lower()
    if kind == ".bvh":
        return read_bvh(path)
    if kind == ".amc":
        return read_amc(path, skeleton)
    if kind in (".txt", ".json"):
        return read_deepmimic(path, skeleton)
    raise InputError(f"motion {path} has an unknown ending; give {', '.join(SKELETON_FILES + COORDINATE_FILES)}.")


def without_rest_frame(motion: SkeletonMotion) -> SkeletonMotion:
    """The motion without its first frame, where that is a rest pose: a jump of 10° and five times any later one."""
    if len(motion) < 4:
        return motion
    steps = se3.log_rotation(np.swapaxes(motion.rotations[:-1], 2, 3) @ motion.rotations[1:])
    size = np.sqrt(np.mean(np.sum(steps**2, axis=2), axis=1))
    return motion[1:] if size[0] > np.radians(10.0) and size[0] > 5.0 * size[1:].max() else motion


def _of_mot(path: Path, axes: WorldAxes) -> tuple[Body, MotionClip]:
    body, table, poses = poses_of_file(path, axes)
    rate = _even_rate(path, table.times)
    q, roots = np.array([pose.q for pose in poses]), np.array([pose.root for pose in poses])
    return body, MotionClip(path.stem, body.coordinate_names, rate, roots, q)


def _of_result(path: Path) -> tuple[Body, MotionClip]:
    result = read_result(path)
    kept = longest_run(~result.lost)
    if kept.stop - kept.start < 2:
        raise InputError(f"motion {path}: it has no two frames in a row that are not lost.")
    rate = _even_rate(path, result.times[kept])
    return result.body, MotionClip(path.stem, result.body.coordinate_names, rate, result.roots[kept], result.q[kept])


def longest_run(good: Bool) -> slice:
    """The longest stretch of true values of (N,)."""
    return slice(*max(runs(good), key=lambda run: run[1] - run[0], default=(0, 0)))


def _even_rate(path: Path, times: Float) -> float:
    if len(times) > 1 and np.all(np.diff(times) > 0):
        rate, ticks, off = even_clock(times)
        if ticks[-1] == len(times) - 1 and off < UNEVEN:
            return round(rate, 6)
    raise InputError(f"motion {path}: its times must rise in even steps; resample it.")


def _carried(source: Body, clip: MotionClip, body: Body, scale: float | None) -> MotionClip:
    """Coordinates as they are where the body has all that move, about the same axes; else by retargeting."""
    common = np.array([name in body.segment_names for name in source.segment_names])
    moving = [k for k in range(len(clip.names)) if np.any(clip.q[:, k]) and np.any(common & (source.chain[:, k] != 0))]
    same = all(
        clip.names[k] in body.coordinate_names
        and np.allclose(source.twists[k, :3], body.twists[body.coordinate(clip.names[k]), :3], atol=1e-6)
        for k in moving
    )
    if not same:
        motion = skeleton_of(source, clip.poses(), clip.rate, clip.name)
        return retarget(motion, body, body_table(), scale)
    q = np.zeros((len(clip), len(body.coordinate_names)))
    for k in moving:
        q[:, body.coordinate(clip.names[k])] = clip.q[:, k]
    return MotionClip(clip.name, body.coordinate_names, clip.rate, clip.roots, q)
