"""The built-in humanoid: a sex-neutral adult of swept cross-sections, smoothly skinned. Own work."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Literal

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import _humanoid_profiles as P
from twistcap.body._humanoid_binding import binding
from twistcap.body._humanoid_field import field_of
from twistcap.body._humanoid_surface import surface
from twistcap.body.kinematics import Pose, Posed
from twistcap.body.model import Body, Landmarks
from twistcap.body.shape import rescaled
from twistcap.errors import InputError

Variant = Literal["full", "legs"]
_ARM_OUT, _LEG_OUT = np.deg2rad(42.0), np.deg2rad(7.0)  # modelling pose, in which no limbs touch
_FLEX, _SIDE, _TURN = (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
# Talocrural and subtalar axes after Inman, "The Joints of the Ankle" (1976), as gait models use them; right side.
_ANKLE, _SUBTALAR = (-0.105, -0.979, -0.174), (0.787, 0.121, 0.605)


def humanoid(
    variant: Variant = "full",
    *,
    stature: float = 1.75,
    lengths: Mapping[str, float] | None = None,
    girths: Mapping[str, float] | None = None,
    thorax: bool = False,
    neck: bool = True,
    clavicles: bool = False,
    wrists: bool = False,
) -> Body:
    """A person standing upright, arms at the sides, palms to the thighs; mid-hip at the origin, facing +x, z up.

    Args:
        variant: "full", or "legs" (pelvis and two legs, closed at the waist).
        stature: body height, m.
        lengths, girths: factors by segment name, see `body.shape.rescaled`.
        thorax: a second spine joint between the lumbar joint and the neck.
        neck: whether the head moves.
        clavicles, wrists: whether those joints have coordinates.

    Raises:
        InputError: for an unknown variant or segment, or a size that is not positive.
    """
    if variant not in ("full", "legs"):
        raise InputError(f"humanoid: variant {variant!r} is unknown; it is 'full' or 'legs'.")
    if not stature > 0:
        raise InputError(f"humanoid: stature is {stature}; it must be positive, in metres.")
    body = _reference(variant, thorax, neck, clavicles, wrists)
    if stature == P.H and not lengths and not girths:
        return body
    return rescaled(body, lengths, girths, stature / P.H)


@lru_cache(maxsize=16)
def _reference(variant: str, thorax: bool, neck: bool, clavicles: bool, wrists: bool) -> Body:
    """The body at the reference stature."""
    skeleton = _Skeleton()
    if variant == "full":
        _add_trunk(skeleton, thorax, neck)
        for side in "rl":
            _add_arm(skeleton, side, clavicles, wrists)
    for side in "rl":
        _add_leg(skeleton, side)
    return _with_surface(skeleton, variant)


class _Skeleton:
    """Joints, segments and landmarks, added one after the other."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.parent: list[int] = []
        self.twists: list[Float] = []
        self.segments: dict[str, int] = {"pelvis": -1}
        self.marks: dict[str, tuple[str, Float]] = {"mid_hip": ("pelvis", np.zeros(3))}

    def joint(self, segment: str, above: str, at: Float, axes: dict[str, tuple[float, float, float]]) -> None:
        """A segment on a joint of one coordinate per axis, all through one point."""
        last = self.segments[above]
        for name, axis in axes.items():
            omega = np.array(axis) / np.linalg.norm(axis)
            self.parent.append(last)
            self.names.append(name)
            self.twists.append(np.concatenate([omega, -np.cross(omega, at)]))
            last = len(self.names) - 1
        self.segments[segment] = last

    def mark(self, name: str, segment: str, at: Float) -> None:
        self.marks[name] = (segment, at)


def _add_trunk(s: _Skeleton, thorax: bool, neck: bool) -> None:
    def axes(prefix: str) -> dict[str, tuple[float, float, float]]:
        return {f"{prefix}_extension": _FLEX, f"{prefix}_bending": _SIDE, f"{prefix}_rotation": _TURN}

    s.joint("torso", "pelvis", np.array(P.LUMBAR), axes("lumbar"))
    if thorax:
        s.joint("thorax", "torso", np.array(P.THORAX), axes("thorax"))
    chest = _chest(s)
    if neck:
        s.joint("head", chest, np.array(P.NECK), axes("neck"))
    head = "head" if neck else chest
    s.mark("neck", head, np.array(P.NECK))
    s.mark("head_top", head, np.array([0.0, 0.0, P.TOP]))
    s.mark("nose", head, np.array([0.116, 0.0, 0.683]))
    for side, sign in (("r", -1), ("l", 1)):
        s.mark(f"eye_{side}", head, np.array([0.085, 0.032 * sign, P.RATIOS["eye_height"] * P.H + P.FLOOR]))
        s.mark(f"ear_{side}", head, np.array([0.0, 0.076 * sign, 0.700]))


def _chest(s: _Skeleton) -> str:
    return "thorax" if "thorax" in s.segments else "torso"


def _sided(side: str, point: tuple[float, float, float]) -> Float:
    return np.array(point) * [1.0, -1.0 if side == "r" else 1.0, 1.0]


def _axis(side: str, right: tuple[float, float, float]) -> tuple[float, float, float]:
    """An axis of the right side, mirrored in the sagittal plane (as an axial vector) for the left."""
    x, y, z = right
    return right if side == "r" else (-x, y, -z)


def _add_arm(s: _Skeleton, side: str, clavicles: bool, wrists: bool) -> None:
    above = _chest(s)
    if clavicles:
        axes = {
            f"clavicle_elevation_{side}": _axis(side, (-1, 0, 0)),
            f"clavicle_protraction_{side}": _axis(side, _TURN),
        }
        s.joint(f"clavicle_{side}", above, _sided(side, P.CLAVICLE), axes)
        above = f"clavicle_{side}"
    shoulder = {f"arm_add_{side}": _SIDE, f"arm_flex_{side}": _FLEX, f"arm_rot_{side}": _TURN}
    for segment, parent, at, axes, mark in (
        ("humerus", above, P.SHOULDER, shoulder, "shoulder"),
        ("ulna", f"humerus_{side}", P.ELBOW, {f"elbow_flex_{side}": _FLEX}, "elbow"),
        ("radius", f"ulna_{side}", P.WRIST, {f"pro_sup_{side}": _TURN}, "wrist"),
    ):
        sided = {name: _axis(side, axis) for name, axis in axes.items()}
        s.joint(f"{segment}_{side}", parent, _sided(side, at), sided)
        s.mark(f"{mark}_{side}", f"{segment}_{side}", _sided(side, at))
    if wrists:
        s.joint(f"hand_{side}", f"radius_{side}", _sided(side, P.WRIST), {f"wrist_flex_{side}": _axis(side, _SIDE)})


def _add_leg(s: _Skeleton, side: str) -> None:
    hip = {f"hip_flexion_{side}": _FLEX, f"hip_adduction_{side}": _SIDE, f"hip_rotation_{side}": _TURN}
    foot = {f"ankle_angle_{side}": _ANKLE, f"subtalar_angle_{side}": _SUBTALAR}
    for segment, above, at, axes, mark in (
        ("femur", "pelvis", P.HIP, hip, "hip"),
        ("tibia", f"femur_{side}", P.KNEE, {f"knee_angle_{side}": (0.0, 1.0, 0.0)}, "knee"),
        ("foot", f"tibia_{side}", P.ANKLE, foot, "ankle"),
    ):
        sided = {name: _axis(side, axis) for name, axis in axes.items()}
        s.joint(f"{segment}_{side}", above, _sided(side, at), sided)
        s.mark(f"{mark}_{side}", f"{segment}_{side}", _sided(side, at))
    for mark, x, y in (("toe", P.TOE_X - 0.01, -0.022), ("small_toe", 0.155, 0.036), ("heel", P.HEEL_X + 0.004, 0.0)):
        s.mark(f"{mark}_{side}", f"foot_{side}", _sided(side, (x, P.ANKLE[1] + y, P.FLOOR + 0.02)))


def _with_surface(s: _Skeleton, variant: str) -> Body:
    bare = _bare(s, variant)
    model = _modelling_pose(bare)
    motions = _left_motions()
    central = (P.TRUNK, *P.CENTRAL) if variant == "full" else (P.PELVIS_ONLY,)
    paired = (*P.UPPER_LEFT, *P.LOWER_LEFT) if variant == "full" else P.LOWER_LEFT
    field = field_of(central, paired, motions)
    points, faces = surface(field, variant, motions)
    segments, weights = binding(bare.segment_names, field, points, faces, motions)
    rest = _unposed(Posed(bare, model).segment_transforms, segments, weights, points)
    return _body(s, variant, rest, faces, segments, weights)


def _left_motions() -> dict[str, Float]:
    out: dict[str, Float] = {}
    for part, at, angle in (("arm", P.SHOULDER, _ARM_OUT), ("leg", P.HIP, _LEG_OUT)):
        omega = np.array([1.0, 0.0, 0.0])
        out[part] = se3.exp(angle * np.concatenate([omega, -np.cross(omega, at)]))
    return out


def _modelling_pose(body: Body) -> Pose:
    pose = Pose.rest(body)
    for name, angle in (("arm_add", _ARM_OUT), ("hip_adduction", _LEG_OUT)):
        for side in "rl":
            if f"{name}_{side}" in body.coordinate_names:
                pose.q[body.coordinate(f"{name}_{side}")] = -angle
    return pose


def _unposed(transforms: Float, segments: Int, weights: Float, points: Float) -> Float:
    """Rest positions (V, 3) that linear-blend skinning moves to the given points (V, 3)."""
    blended = np.einsum("vk,vkij->vij", weights, transforms[segments])
    return np.linalg.solve(blended[:, :3, :3], (points - blended[:, :3, 3])[..., None])[..., 0]


def _bare(s: _Skeleton, variant: str) -> Body:
    return _body(s, variant, np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 1), np.int32), np.zeros((0, 1)))


def _body(s: _Skeleton, variant: str, vertices: Float, faces: Int, segments: Int, weights: Float) -> Body:
    names = tuple(s.segments)
    limits = np.deg2rad([P.LIMITS_DEG[n] if n in P.LIMITS_DEG else P.LIMITS_DEG[n[:-2]] for n in s.names])
    marks = Landmarks(
        tuple(s.marks),
        np.array([names.index(m[0]) for m in s.marks.values()], np.int32),
        np.array([m[1] for m in s.marks.values()], dtype=np.float64),
    )
    return Body(
        name=f"humanoid-{variant}",
        coordinate_names=tuple(s.names),
        parent=np.array(s.parent, np.int32),
        twists=np.array(s.twists, dtype=np.float64),
        limits=np.asarray(limits, dtype=np.float64),
        segment_names=names,
        segment_joint=np.array([s.segments[n] for n in names], np.int32),
        vertices=vertices,
        faces=faces,
        skin_segments=segments,
        skin_weights=weights,
        landmarks=marks,
    )
