"""Which axis of a calibration's world is up: found in the images, and turned to z only if the user says so."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from twistcap import se3
from twistcap.body.rig_spec import unit_vector
from twistcap.camera import Rig
from twistcap.errors import InputError

Up = Literal["x", "-x", "y", "-y", "z", "-z"]
_TOGETHER, _LEVEL = 0.7, 0.5  # how far the cameras' own ups agree; of z in the common one, at most
_CLEAR = np.cos(np.deg2rad(40.0))  # of the angle between an axis and up in the images


def axis_up(rig: Rig) -> Up | None:
    """The axis that is up by the images, of cameras that are held upright; None where no axis is near enough."""
    up = -np.mean([camera.T_cam_world[1, :3] for camera in rig], axis=0)
    size = float(np.linalg.norm(up))
    found = max(get_args(Up), key=lambda axis: float(up @ unit_vector(axis)))
    return found if size > 1e-6 and float(up @ unit_vector(found)) > _CLEAR * size else None


def up_instead_of_z(rig: Rig) -> Up | None:
    """The axis that is up by the images where that is surely not z: all cameras are upright and none looks steeply."""
    up = -np.mean([camera.T_cam_world[1, :3] for camera in rig], axis=0)
    size = float(np.linalg.norm(up))
    return None if size < _TOGETHER or up[2] > _LEVEL * size else axis_up(rig)


def with_z_up(rig: Rig, up: Up) -> Rig:
    """The rig in the world in which the axis `up` is z: the others are turned on by one place, never mirrored."""
    third = unit_vector(up)
    first = np.roll(np.abs(third), 1)
    turn = np.stack([first, np.cross(third, first), third])
    back = se3.transform(turn.T, np.zeros(3))
    return Rig(tuple(replace(camera, T_cam_world=camera.T_cam_world @ back) for camera in rig))


def check_z_up(rig: Rig, source: str, mend: str = 'set [cameras] up = "{}" (or "z"{})') -> None:
    """Raises InputError where another axis than z is surely up by the images of upright cameras; `mend` says what to do
    about it, with places for the axis and for when z is right.
    """
    found = up_instead_of_z(rig)
    if found is not None:
        to_do = mend.format(found, " if the cameras lie on their sides")
        raise InputError(f"{source}: by the images {found} is up, not z; {to_do}.")


def checked_up(rig: Rig, said: Up | None, source: str) -> tuple[Rig, str]:
    """The rig with z up, and a sentence that says how that is known.

    Raises InputError where the user does not say what is up, and the images do not agree that it is z.
    """
    found = axis_up(rig)
    if said is not None:
        doubt = f"; by the images it is {found}, so look at it" if found not in (said, None) else ""
        return with_z_up(rig, said), f"Up is {said}, as said{doubt}."
    if found == "z":
        return rig, "Up is z: the images agree."
    reason = "the images do not say what is up" if found is None else f"up is {found} by the images, not z"
    raise InputError(f"{source}: {reason}; say it: --up {found or 'z'} turns that axis to z.")
