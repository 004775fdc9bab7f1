"""Export formats by name: our own, and those that installed packages offer in the group ``twistcap.exports``.

A format is an `ExportFormat`, or a function that gives one, named in `FORMATS` or as an entry point
(see ARCHITECTURE.md).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.body.gltf_animate import BoneMotion, animate_glb, bone_motion
from twistcap.body.gltf_write import save_glb
from twistcap.errors import InputError, check, check_choice
from twistcap.io.bvh import write_bone_bvh, write_bvh
from twistcap.io.c3d import write_c3d
from twistcap.io.coordinates import ANGLES, Angles
from twistcap.io.files import check_replaceable, replacing, unwritable, write_lines
from twistcap.io.markers import TO_FILE, WorldAxes, write_trc
from twistcap.io.motion_files import write_csv, write_mot
from twistcap.io.opensim_package import write_opensim
from twistcap.io.playback import Playback, playback
from twistcap.io.result import Result
from twistcap.io.usd import write_usd
from twistcap.registry import Registry

_NAMES = ("trc", "mot", "bvh", "csv", "glb", "usd", "c3d", "opensim")
_OWN = {name: f"twistcap.io.exports:{name}" for name in _NAMES}
FORMATS = Registry("export format", "twistcap.exports", _OWN)
_PACKAGES = {"c3d": "ezc3d", "usd": "pxr"}  # modules of optional packages that formats need
_PLAYED = ("fps", "into", "rig")  # what files that are played take
_FASTEST = 1000.0  # frames per second; more fills the memory, and no player shows it


def check_installed(kinds: Iterable[str]) -> None:
    """Raises InputError for a format whose optional package is not installed."""
    for kind in kinds:
        if kind in _PACKAGES and find_spec(_PACKAGES[kind]) is None:
            mend = f"install it with: pip install 'twistcap[{kind}]', or take {kind!r} out of [output] exports"
            raise InputError(f"{kind.upper()} files need a package that is not installed; {mend}.")


@dataclass(frozen=True)
class ExportOptions:
    """What files of one export have in common.

    Attributes:
        axes: how the world of points and angles lies in the file, see `io.markers`.
        angles: whose definitions the joint angles have, see `io.coordinates`.
        fill: whether frames that are lost or unseen hold the predicted pose; else they are empty where the format can
            say so (all but BVH, GLB and USD).
        fps: frames per second of BVH, GLB and USD, interpolated. None: BVH has the recording's, the others a key for
            each frame.
        into: the rigged GLB that was tracked: GLB and BVH then have its bones, and the GLB all of its content.
        rig: its rig file, where one is not beside it.

    Raises InputError for unknown axes or angles, or a rate that is not positive or above 1000.
    """

    axes: WorldAxes = "opensim"
    angles: Angles = "opensim"
    fill: bool = False
    fps: float | None = None
    into: Path | None = None
    rig: Path | None = None

    def __post_init__(self) -> None:
        check_choice("export: axes", self.axes, TO_FILE)
        check_choice("export: angles", self.angles, ANGLES)
        possible = self.fps is None or 0 < self.fps <= _FASTEST
        check("export: fps", possible, f"it is {self.fps}; it must be above 0 and at most {_FASTEST:g}")


DEFAULTS = ExportOptions()
_OPTIONAL = ("axes", "angles", "fps", "into", "rig")


@dataclass(frozen=True)
class ExportFormat:
    """How a result of one frame or more is written; `write` raises OSError if the file cannot be written."""

    file_name: str  # usual name of the file, such as ``angles.csv``
    about: str  # what is in it, in a few words for the report
    write: Callable[[Result, Path, ExportOptions], Any]
    takes: tuple[str, ...] = ("axes", "angles")  # the options that change it, beside `fill`
    beside: tuple[str, ...] = ()  # usual names of more files


def format_of(name: str) -> ExportFormat:
    """The format of a name. Raises InputError for a name that nobody has registered, or that stands for no format."""
    made: Any = FORMATS.get(name)
    made = made if isinstance(made, ExportFormat) else made()
    check(f"export: {name}", isinstance(made, ExportFormat), f"it is {made!r}, which is no ExportFormat")
    return made


def offered_formats() -> Iterator[ExportFormat]:
    """All formats, without those of installed packages that cannot be loaded."""
    for name in FORMATS.names():
        with nullcontext() if name in _OWN else suppress(Exception):
            yield format_of(name)


def shared(options: ExportOptions, name: str) -> ExportOptions:
    """The options of a run of several formats as one of them takes them. Raises InputError for an unknown format."""
    takes = format_of(name).takes
    return replace(options, **{key: getattr(DEFAULTS, key) for key in _OPTIONAL if key not in takes})


def export(
    result: Result, name: str, folder: Path, path: Path | None = None, options: ExportOptions = DEFAULTS
) -> Path:
    """Write a result in the format of a name; returns the file: `path`, or its usual name in the folder. Raises
    InputError for an unknown format, a result without frames, an option that the format does not take, or a file that
    cannot be written.
    """
    chosen = format_of(name)
    if not len(result):
        raise InputError("the result has no frame; there is nothing to export.")
    for key in _OPTIONAL:
        given = getattr(options, key) != getattr(DEFAULTS, key)
        check(f"export: {key}", not given or key in chosen.takes, f"{name} takes none; leave it away")
    check("export: rig", options.rig is None or options.into is not None, "it is that of the GLB of into; give both")
    path = path or folder / chosen.file_name
    check_replaceable(path)
    try:
        chosen.write(result, path, options)
    except OSError as error:  # of an installed format; ours raise InputError
        raise unwritable(path, error) from error
    return path


def _write_glb(result: Result, path: Path, options: ExportOptions) -> None:
    """A key for each frame, at its time, or at even times; the animation's extras hold the flags."""
    played = playback(result)
    played = played if options.fps is None else played.even(options.fps)
    with replacing(path) as part:
        if options.into is None:
            save_glb(result.body, part, played.poses, played.times, played.flags)
        else:
            motion = _bones(result, played, options.into, options.rig)
            animate_glb(motion, part, played.times, played.flags)


def _bones(result: Result, played: Playback, into: Path, rig: Path | None) -> BoneMotion:
    """The motion of the bones of a GLB; without a rig file that of the session, if it is still there."""
    named = str(result.config.get("body", {}).get("rig") or "")
    return bone_motion(result.body, played.poses, into, rig or (named if named and Path(named).is_file() else None))


def _write_bvh(result: Result, path: Path, options: ExportOptions) -> None:
    """Lines at an even rate; the flags stand in a JSON beside it, since the format has no place for them."""
    played = playback(result).even(options.fps)
    if options.into is None:
        write_bvh(path, result.body, played.poses, played.rate)
    else:
        write_bone_bvh(path, _bones(result, played, options.into, options.rig), played.rate)
    write_lines(path.with_suffix(".flags.json"), [json.dumps(played.flags)])


def _write_usd(result: Result, path: Path, options: ExportOptions) -> None:
    played = playback(result)
    write_usd(path, result.body, played if options.fps is None else played.even(options.fps))


def _write_landmarks(result: Result, path: Path, options: ExportOptions) -> None:
    points = np.where((result.known | options.fill)[:, None, None], result.landmarks, np.nan)
    write_trc(path, result.times, result.body.landmarks.names, points, axes=options.axes)


def _write_mot(result: Result, path: Path, o: ExportOptions) -> None:
    write_mot(path, result.body, result.times, result.poses, o.axes, o.angles, result.known, o.fill, result.indices)


trc = ExportFormat("joints.trc", "joint centres (OpenSim, Mokka)", _write_landmarks, ("axes",))
mot = ExportFormat("angles.mot", "joint angles (OpenSim)", _write_mot)
bvh = ExportFormat(
    "motion.bvh", "skeleton and motion (Blender, MotionBuilder)", _write_bvh, _PLAYED, ("motion.flags.json",)
)
csv = ExportFormat(
    "angles.csv", "joint angles and their standard deviations",
    lambda result, path, options: write_csv(path, result, options.axes, options.angles, options.fill),
)  # fmt: skip
glb = ExportFormat("motion.glb", "skinned body and motion (any glTF viewer)", _write_glb, _PLAYED)
usd = ExportFormat("motion.usd", "skinned body and motion (USD)", _write_usd, ("fps",))
c3d = ExportFormat(
    "motion.c3d", "points and segments (Visual3D, Mokka, Vicon)",
    lambda result, path, options: write_c3d(path, result, options.axes, options.fill), ("axes",),
)  # fmt: skip
opensim = ExportFormat(
    "opensim", "model, markers, motion and set-ups (OpenSim)",
    lambda result, path, options: write_opensim(path, result, options.axes, options.fill), ("axes",),
)  # fmt: skip
