"""The meaning of a rigged mesh's joints: the TOML beside a GLB or an OBJ. All keys are optional; without [joints] those
of a GLB of a known rig (`rig_presets`) stay, and the other keys go over its own. An empty file asks for free joints.

    root = "Hips"            # the joint that carries the six degrees of freedom (default: the top of the tree)
    up = "y"                 # the file's vertical axis, "y" or "z"
    forward = "z"            # the file's axis the body looks along: "x", "-x", "y" … (default z for up = "y", else x)
    scale = 0.1              # metres per unit of the file
    origin = "mid_hip"       # landmark put at the origin, or "ground": the lowest vertex at z = 0; default "file"
    keep = ["LeftArm"]       # if given: joints neither here nor under [joints] are merged into their parents
    [joints.LeftLeg]
    kind = "revolute"        # "fixed" (merged into its parent) | "revolute" | "universal" | "ball" (default)
    axes = [[0, 1, 0]]       # 1, 2 or 3 axes; the ball has x, y, z when none are given
    frame = "rest"           # axes in our rest frame (x forward, y left, z up), or "joint": in the joint's own
    names = ["knee_angle_l"] # of the coordinates; default <joint>_x, _y, _z
    limits_deg = [[0, 140]]  # default ±180
    segment = "tibia_l"      # name of the segment; default the joint's
    aim = { at = "LeftFoot", along = [0, 0, -1] }   # turn the rest pose: the line to joint `at` gets this direction
    [landmarks]              # default: every joint that stays, under its own name
    knee_l = "LeftLeg"                                        # where that joint is
    nose = { joint = "Head", at = [0.2, 0.0, 1.6] }           # a point: our axes, m, before aim and origin
    toe_l = { joint = "LeftFoot", point = "joint-l-toe-1-3" } # a named point of the file
    heel_l = { joint = "LeftFoot", vertices = [12862] }       # mean of vertices, numbered as in the file (OBJ only)

Coordinates of one joint turn about their axes one after the other, the first in the parent's frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator

from twistcap.arrays import Float
from twistcap.doors.strict import validated
from twistcap.doors.text import read_toml

RIG_PAGE = "docs/formats/body-files.md"
"""About rig files."""
RIG_MEND = f"a GLB of no known rig needs a rig file ({RIG_PAGE})"
"""Where a body lacks joints that it should have."""
Vector = tuple[float, float, float]
Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
AXES: tuple[Axis, ...] = ("x", "y", "z", "-x", "-y", "-z")


class Aim(BaseModel, extra="forbid"):
    """Turn of the rest pose so that the line from the joint to joint `at` has a direction of the rest frame. "file"
    restores the joint's orientation in the file, whatever the joints above it did."""

    at: str
    along: Vector | Literal["file"]


class JointSpec(BaseModel, extra="forbid"):
    """One joint of the TOML; see the module's head."""

    kind: Literal["fixed", "revolute", "universal", "ball"] = "ball"
    axes: list[Vector] | None = None
    frame: Literal["rest", "joint"] = "rest"
    names: list[str] | None = None
    limits_deg: list[tuple[float, float]] | None = None
    segment: str | None = None
    aim: Aim | None = None


class LandmarkSpec(BaseModel, extra="forbid"):
    """One landmark of the TOML; see the module's head."""

    joint: str
    at: Vector | None = None
    point: str | None = None
    vertices: list[int] | None = None


class RigSpec(BaseModel, extra="forbid"):
    """The TOML beside a skinned mesh; see the module's head."""

    root: str | None = None
    up: Literal["y", "z"] = "y"
    forward: Axis | None = None
    scale: float = Field(default=1.0, ge=1e-5, le=1e3)
    origin: str = "file"
    keep: list[str] | None = None
    joints: dict[str, JointSpec] = Field(default_factory=dict[str, JointSpec])
    landmarks: dict[str, str | LandmarkSpec] | None = None

    @model_validator(mode="after")
    def _forward_is_level(self) -> RigSpec:
        if (self.forward or "").endswith(self.up):
            raise ValueError(f"forward = {self.forward!r} cannot be the vertical axis, up = {self.up!r}")
        return self

    @property
    def says_joints(self) -> bool:
        """Whether it says what the joints mean: under [joints], or, with no key at all, that each turns freely."""
        return "joints" in self.model_fields_set or not self.model_fields_set

    def to_rest(self) -> Float:
        """(3, 3) from the file's axes and units to ours: x forward, y left, z up, m."""
        up = unit_vector(self.up)
        forward = unit_vector(self.forward or ("z" if self.up == "y" else "x"))
        return self.scale * np.stack([forward, np.cross(up, forward), up])


def read_rig(path: Path | str) -> RigSpec:
    """The rig description of a TOML file. Raises InputError if it is missing, no TOML, or has an unknown key or a wrong
    value."""
    return validated(RigSpec, read_toml(Path(path), ""), str(path))


def unit_vector(axis: str) -> Float:
    """(3,) along an axis, such as "-x"."""
    return (-1.0 if axis.startswith("-") else 1.0) * np.eye(3)["xyz".index(axis[-1])]
