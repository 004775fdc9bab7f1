"""Recorded motions that experiments track and learn from; they are not part of the package."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.errors import InputError
from twistcap.io.motions import read_motion
from twistcap.motion import MotionClip

_CMU_SKELETON = "motions/cmu/01.asf"  # those of 07 and 08 are not published with them
_OWN_SKELETON = ("motions/cmu/01_01.amc", "motions/cmu/11_01.amc")


@dataclass(frozen=True)
class Recording:
    """Poses of a motion file.

    Attributes:
        file: in the folder that TWISTCAP_DATA names.
        first, last: of the poses at the wanted rate; `last` is left out, None takes all.
        every: 2 takes every second pose: twice the speed.
        cycles: how often a clip that ends as it began is played.
    """

    file: str
    first: int = 0
    last: int | None = None
    every: int = 1
    cycles: int = 1

    def clip(self, body: Body, rate: float) -> MotionClip:
        """It in a body's coordinates.

        Raises:
            InputError: where TWISTCAP_DATA does not have the file.
        """
        amc = self.file.endswith(".amc") and self.file not in _OWN_SKELETON
        skeleton = data_file(_CMU_SKELETON) if amc else None
        whole = read_motion(data_file(self.file), body, skeleton=skeleton, rate=rate)
        part = slice(self.first, self.last, self.every)
        return looped(replace(whole, roots=whole.roots[part], q=whole.q[part]), self.cycles)


def looped(clip: MotionClip, cycles: int) -> MotionClip:
    """A clip of one cycle played `cycles` times; each cycle starts where the last ended.

    The difference between the ends is spread over the cycle.

    Raises:
        InputError: for no cycle, or a clip whose ends differ by more than 40° in a joint.
    """
    if cycles < 1:
        raise InputError(f"motion {clip.name!r}: {cycles} cycles were asked for; take 1 or more.")
    if cycles == 1:
        return clip
    gap = clip.q[-1] - clip.q[0]
    worst = float(np.degrees(np.abs(gap).max()))
    if worst > 40.0:
        raise InputError(f"motion {clip.name!r}: its ends differ by {worst:.0f}° in a joint: it is no cycle.")
    q = clip.q - np.linspace(-0.5, 0.5, len(clip))[:, None] * gap
    onward, roots = _level(clip.roots[-1] @ se3.inverse(clip.roots[0]), clip.roots[0], clip.roots[-1]), [clip.roots]
    for _ in range(cycles - 1):
        roots.append(onward @ roots[-1])
    parts = [part[:-1] for part in roots[:-1]]  # the last pose of a cycle is the first of the next one
    all_q = np.concatenate([*[q[:-1]] * (cycles - 1), q])
    return replace(clip, roots=np.concatenate([*parts, roots[-1]]), q=all_q)


def _level(motion: Float, before: Float, after: Float) -> Float:
    """(4, 4) the turn of a rigid motion about the vertical, with the shift from one root's place to another's."""
    angle = np.arctan2(motion[1, 0] - motion[0, 1], motion[0, 0] + motion[1, 1])
    R = se3.exp_rotation(np.array([0.0, 0.0, angle]))
    shift = after[:3, 3] - R @ before[:3, 3]
    return se3.transform(R, shift * [1.0, 1.0, 0.0])


def data_file(name: str) -> Path:
    """A file of the folder that the environment variable TWISTCAP_DATA names.

    Raises:
        InputError: where it is not there.
    """
    folder = os.environ.get("TWISTCAP_DATA")
    if folder is None:
        raise InputError(f"this experiment needs {name}: set TWISTCAP_DATA to the folder that holds it.")
    path = Path(folder) / name
    if not path.exists():
        raise InputError(
            f"this experiment needs {path}, which is not there; set TWISTCAP_DATA to the folder that has it."
        )
    return path
