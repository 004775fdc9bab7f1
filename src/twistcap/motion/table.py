"""The meaning of a skeleton's joints: a TOML with the joint of each of our segments and its anatomical axes.

    name = "mine"
    [segments]
    pelvis  = { joint = "Hips", forward = [0, 0, 1], up = [0, 1, 0] }
    femur_r = { joint = ["RightUpLeg", "RightHip"], forward = [0, 0, 1], down = "tibia_r" }
    tibia_r = { joint = "RightLeg", forward = [0, 0, 1], down = "foot_r" }

- Keys under `segments` are the segments of the built-in humanoid: pelvis, torso, thorax, head, and with _r and _l
  clavicle, humerus, ulna, radius, hand, femur, tibia, foot. `pelvis`, both femurs and both tibias must be
  there. A body without a thorax takes the `thorax` row for its torso.
- `joint` is the one that the segment turns with; of several names the first that the skeleton has is taken.
- Axes are those of the segment's anatomy, in the skeleton's rest pose and the file's axes. `up` points to its upper end
  when the person stands with hanging arms, `down` is its opposite; either is a vector, or a segment of this table to
  whose joint it points. `forward` is its front then: for the upper arm the direction of the forearm when the elbow
  bends, for forearm and hand the side of the thumb. It need not be orthogonal to `up`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from pydantic import BaseModel, Field, model_validator

from twistcap.arrays import Float
from twistcap.doors.strict import validated
from twistcap.doors.text import read_toml
from twistcap.errors import InputError, check
from twistcap.motion.skeleton import SkeletonMotion

_SIDED = ("clavicle", "humerus", "ulna", "radius", "hand", "femur", "tibia", "foot")
SEGMENTS = ("pelvis", "torso", "thorax", "head", *(f"{part}_{side}" for part in _SIDED for side in "rl"))
REQUIRED = ("pelvis", "femur_r", "femur_l", "tibia_r", "tibia_l")
Vector = tuple[float, float, float]


class SegmentAxes(BaseModel, extra="forbid", frozen=True):
    """One row of the table; see the module's head."""

    joint: str | tuple[str, ...] = Field(min_length=1)
    forward: Vector
    up: Vector | str | None = None
    down: Vector | str | None = None

    @model_validator(mode="after")
    def _one_direction(self) -> SegmentAxes:
        if (self.up is None) == (self.down is None):
            raise ValueError("give either up or down")
        return self

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joint, the preferred one first."""
        return (self.joint,) if isinstance(self.joint, str) else self.joint


class SkeletonTable(BaseModel, extra="forbid", frozen=True):
    """The TOML of a skeleton; see the module's head."""

    name: str
    segments: dict[str, SegmentAxes]

    @model_validator(mode="after")
    def _known(self) -> SkeletonTable:
        for segment, axes in self.segments.items():
            if segment not in SEGMENTS:
                raise ValueError(f"unknown segment {segment!r}; the segments are {', '.join(SEGMENTS)}")
            for towards in (axes.up, axes.down):
                if isinstance(towards, str) and towards not in self.segments:
                    raise ValueError(f"{segment} points to {towards!r}, which the table does not have")
        missing = [segment for segment in REQUIRED if segment not in self.segments]
        if missing:
            raise ValueError(f"it lacks {missing[0]!r}")
        return self

    def found(self, motion: SkeletonMotion) -> dict[str, int]:
        """Index of the joint of each segment of the table that the skeleton has."""
        rows = {segment: [j for j in axes.joints if j in motion.joints] for segment, axes in self.segments.items()}
        return {segment: motion.joints.index(names[0]) for segment, names in rows.items() if names}


@dataclass(frozen=True)
class Calibration:
    """Those of our segments that a skeleton has: by name, the index of the skeleton's joint, and the axes. The columns
    of axes (3, 3) are the segment's forward, left and up in the skeleton's rest pose."""

    joints: Mapping[str, int]
    axes: Mapping[str, Float]


def calibrated(motion: SkeletonMotion, table: SkeletonTable) -> Calibration:
    """Anatomical axes of a skeleton's segments in its rest pose. Raises InputError where the skeleton lacks a required
    joint, or an axis has no direction."""
    joints, rest = table.found(motion), motion.rest_positions()
    for segment in REQUIRED:
        if segment not in joints:
            names = " or ".join(map(repr, table.segments[segment].joints))
            raise InputError(f"motion {motion.name!r}: it has no joint {names} ({segment} of table {table.name!r}).")
    axes: dict[str, Float] = {}
    for segment in joints:
        row = table.segments[segment]
        up = _direction(row.up or row.down, segment, joints, rest) * (-1.0 if row.up is None else 1.0)
        axes[segment] = _frame(np.array(row.forward), up, f"{table.name!r}: {segment}")
    return Calibration(joints, axes)


def _direction(towards: Vector | str | None, segment: str, joints: Mapping[str, int], rest: Float) -> Float:
    if not isinstance(towards, str):
        return np.array(towards, dtype=float)
    check("skeleton table", towards in joints, f"{segment} points to {towards!r}, whose joint the skeleton lacks")
    return rest[joints[towards]] - rest[joints[segment]]


def _frame(forward: Float, up: Float, where: str) -> Float:
    left = np.cross(up, forward)
    if np.linalg.norm(left) < 0.05 * np.linalg.norm(up) * np.linalg.norm(forward) or not np.any(left):
        raise InputError(f"skeleton table {where}: forward and up must be two directions, not one.")
    up, left = up / np.linalg.norm(up), left / np.linalg.norm(left)
    return np.stack([np.cross(left, up), left, up], axis=1)


@cache
def shipped_tables() -> tuple[SkeletonTable, ...]:
    """The tables of this package, in the order of trial."""
    folder = resources.files("twistcap.motion") / "tables"
    names = ("cmu", "cmu_arms_down", "deepmimic", "humanoid")
    return tuple(SkeletonTable.model_validate(tomllib.loads((folder / f"{n}.toml").read_text("utf-8"))) for n in names)


def table_for(motion: SkeletonMotion) -> SkeletonTable:
    """The shipped table that fits a skeleton: of those whose required joints it has, the one with most joints. Raises
    an InputError where there is none."""
    fits = [(table, table.found(motion)) for table in shipped_tables()]
    fits = [(len(found), table) for table, found in fits if set(REQUIRED) <= found.keys()]
    if not fits:
        known = ", ".join(table.name for table in shipped_tables())
        mend = "give a table of its joints (docs/formats/motion-files.md)"
        first = ", ".join(motion.joints[:4])
        raise InputError(f"motion {motion.name!r}: its skeleton ({first}, …) is none of {known}; {mend}.")
    return max(fits, key=lambda fit: fit[0])[1]


def body_table() -> SkeletonTable:
    """The table of the skeletons that `skeleton_of` makes of bodies with our segment names."""
    rows = {name: SegmentAxes(joint=name, forward=(1, 0, 0), up=(0, 0, 1)) for name in SEGMENTS}
    return SkeletonTable(name="body", segments=rows)


def read_table(path: Path | str) -> SkeletonTable:
    """A skeleton's table; an InputError if it is missing, no TOML, or has an unknown key or a wrong value."""
    return validated(SkeletonTable, read_toml(Path(path), ""), str(path))
