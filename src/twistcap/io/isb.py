"""Joint angles after the recommendations of the International Society of Biomechanics.

Hip, ankle and spine: Wu et al. 2002, DOI 10.1016/S0021-9290(01)00222-6. Shoulder (thorax to humerus), elbow and wrist:
Wu et al. 2005, DOI 10.1016/j.jbiomech.2004.05.042. Knee: Grood and Suntay 1983, DOI 10.1115/1.3138397, whose method
these papers follow: the first rotation is about an axis of the upper bone, the last about one of the lower, and the
second about the axis across both. The bones' frames are those of `body.anatomy`. Left joints are mirrored, as Wu et al.
ask for, so that equal signs mean equal movements. Where a paper counts downwards, we count up: the elevation of the arm
and the flexion of the knee are positive.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.body.anatomy import Bone, bones_of
from twistcap.io import angles as convert

ISB = "isb_"
"""What the names of these angles begin with."""
_X, _Y, _Z = np.eye(3)
_ZXY = np.array([_Z, _X, _Y])
_YXY = np.array([_Y, _X, _Y])
_MIRROR = np.diag([1.0, 1.0, -1.0])
_PLAIN, _KNEE = np.ones(3), np.array([-1.0, 1.0, 1.0])
# Joint: upper bone, lower bone, names of its three angles. Positive for the right side: see CONVENTIONS.md.
_TRUNK: Mapping[str, tuple[str, str, tuple[str, str, str]]] = {
    "trunk": ("pelvis", "thorax", ("extension", "bending", "rotation")),
    "neck": ("thorax", "head", ("extension", "bending", "rotation")),
}
_LIMBS: Mapping[str, tuple[str, str, tuple[str, str, str]]] = {
    "shoulder": ("thorax", "humerus", ("plane", "elevation", "rotation")),
    "elbow": ("humerus", "forearm", ("flexion", "carrying", "pronation")),
    "wrist": ("forearm", "hand", ("flexion", "deviation", "rotation")),
    "hip": ("pelvis", "femur", ("flexion", "adduction", "rotation")),
    "knee": ("femur", "tibia", ("flexion", "adduction", "rotation")),
    "ankle": ("tibia", "foot", ("dorsiflexion", "inversion", "rotation")),
}


@dataclass(frozen=True)
class IsbJoint:
    """Three angles, named, between two bones."""

    names: tuple[str, ...]
    above: Bone
    below: Bone
    spins: bool = False  # whether it turns about y, x and y (the shoulder); the others about z, x and y
    mirrored: bool = False
    signs: Float = field(default_factory=lambda: _PLAIN)  # (3,) of the angles

    def angles(self, rotations: Float) -> Float:
        """Angles (T, 3) rad of rotations (T, 3, 3) of the lower bone in the upper one's axes."""
        R = _MIRROR @ rotations @ _MIRROR if self.mirrored else rotations
        return _elevation(R) if self.spins else self.signs * convert.decomposed(R, _ZXY, np.zeros(3))

    def rates(self, rotations: Float) -> Float:
        """(T, 3, 3) from the angular velocity in the upper bone's axes to the rates of the angles."""
        angles = self.angles(rotations)
        signs = np.array([1.0, -1.0, 1.0]) if self.spins else self.signs
        out = signs[:, None] * convert.rates(signs * angles, _YXY if self.spins else _ZXY)
        return out @ -_MIRROR if self.mirrored else out


def isb_joints(body: Body) -> list[IsbJoint]:
    """The joints that a body has, by those of its bones that are known (`body.anatomy`)."""
    bones, out = bones_of(body), list[IsbJoint]()
    for joint, (above, below, parts) in _TRUNK.items():
        if above in bones and below in bones:
            out.append(IsbJoint(tuple(f"{ISB}{joint}_{part}" for part in parts), bones[above], bones[below]))
    for side in ("_r", "_l"):
        for joint, (above, below, parts) in _LIMBS.items():
            upper = bones.get(above, bones.get(above + side))
            if upper is not None and below + side in bones:
                names = tuple(f"{ISB}{joint}_{part}{side}" for part in parts)
                signs = _KNEE if joint == "knee" else _PLAIN
                out.append(IsbJoint(names, upper, bones[below + side], joint == "shoulder", side == "_l", signs))
    return out


def _elevation(R: Float) -> Float:
    """Plane of elevation, elevation ≥ 0 and axial rotation (T, 3), with ``R = Ry(plane) Rx(−elevation) Ry(rotation)``,
    continuous over T frames.

    At elevation 0 only the sum of the other two is known; the plane is 0 there.
    """
    sine = np.hypot(R[:, 0, 1], R[:, 2, 1])
    out = np.stack(
        [np.arctan2(-R[:, 0, 1], -R[:, 2, 1]), np.arctan2(sine, R[:, 1, 1]), np.arctan2(-R[:, 1, 0], R[:, 1, 2])], 1
    )
    locked = sine < 1e-9
    out[locked, 0], out[locked, 2] = 0.0, np.arctan2(R[locked, 0, 2], R[locked, 0, 0])
    out[:, ::2] = np.unwrap(out[:, ::2], axis=0)
    return out
