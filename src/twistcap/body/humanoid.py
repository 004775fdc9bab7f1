"""The built-in humanoid: a sex-neutral adult, smoothly skinned. Own work.

Its surface, in a modelling pose in which no limbs touch, is that of swept cross-sections. `humanoid.npz` holds it for
each variant: points (V, 3), faces (F, 3) and, for each limb, how much nearer (m) each point is to it than to the rest
of the body, its mirror image left out. ``python -m reproduce.humanoid`` computes the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib import resources
from typing import Literal

import numpy as np
from scipy.sparse import coo_matrix

from twistcap import se3
from twistcap.arrays import AnyArray, Float, Int
from twistcap.body import proportions as P
from twistcap.body.binding import Binding, ramp, strongest, unposed
from twistcap.body.kinematics import Pose, Posed
from twistcap.body.model import Body, Landmarks, edges_of
from twistcap.body.shape import rescaled
from twistcap.errors import check

Variant = Literal["full", "legs"]
# Joints of a side, outwards: segment, centre, landmark at the centre.
_CLAVICLE, _HAND = ("clavicle", P.CLAVICLE, ""), ("hand", P.WRIST, "")
_ARM = (("humerus", P.SHOULDER, "shoulder"), ("ulna", P.ELBOW, "elbow"), ("radius", P.WRIST, "wrist"))
_LEG = (("femur", P.HIP, "hip"), ("tibia", P.KNEE, "knee"), ("foot", P.ANKLE, "ankle"))
_SOLE = (("toe", P.TOE_X - 0.01, -0.022), ("small_toe", 0.155, 0.036), ("heel", P.HEEL_X + 0.004, 0.0))

_OUT = {"arm": (P.SHOULDER, np.deg2rad(42.0)), "leg": (P.HIP, np.deg2rad(7.0))}  # how limbs are held in modelling
_SOFT = 0.035  # m, half of the blending zone of trunk and limb
_SMOOTHINGS = 3
_BRANCHES = {"arm": "humerus", "leg": "femur"}
_HINGES = {  # joint, above, below, half of the blending zone in m
    "arm": ((P.ELBOW, "humerus", "ulna", 0.04), (P.WRIST, "radius", "hand", 0.025)),
    "leg": ((P.KNEE, "femur", "tibia", 0.05), (P.ANKLE, "tibia", "foot", 0.03)),
}


def humanoid(
    variant: Variant = "full", *, stature: float = 1.75, lengths: Mapping[str, float] | None = None,
    girths: Mapping[str, float] | None = None, thorax: bool = False, neck: bool = True, clavicles: bool = False,
    wrists: bool = False,
) -> Body:  # fmt: skip
    """A person standing upright, arms at the sides, palms to the thighs; mid-hip at the origin, facing +x, z up.

    Args:
        variant: "full", or "legs" (pelvis and two legs, closed at the waist).
        stature: body height, m.
        lengths, girths: factors by segment name, see `body.shape.rescaled`.
        thorax, neck, clavicles, wrists: whether those joints move; the thorax is a second one of the spine.

    Raises InputError for an unknown variant or segment, or a size that is not positive.
    """
    check("humanoid", variant in ("full", "legs"), f"variant {variant!r} is unknown; it is 'full' or 'legs'")
    check("humanoid", stature > 0, f"stature is {stature}; it must be positive, in metres")
    body = _reference(variant, thorax, neck, clavicles, wrists)
    if stature == P.H and not lengths and not girths:
        return body
    return rescaled(body, lengths, girths, stature / P.H)


def limb_motions() -> dict[str, Float]:
    """Motions (4, 4) of the left "arm" and "leg" from the neutral to the modelling pose."""
    omega = np.array(P.SIDE)
    return {n: se3.exp(angle * np.concatenate([omega, -np.cross(omega, at)])) for n, (at, angle) in _OUT.items()}


@lru_cache(maxsize=16)
def _reference(variant: str, thorax: bool, neck: bool, clavicles: bool, wrists: bool) -> Body:
    """The body at the reference stature."""
    skeleton = _Skeleton()
    if variant == "full":
        chest = _add_trunk(skeleton, thorax, neck)
        joints = (*[_CLAVICLE][:clavicles], *_ARM, *[_HAND][:wrists])
        for side in "rl":
            skeleton.limb(joints, chest, side)
    for side in "rl":
        skeleton.limb(_LEG, "pelvis", side)
        for mark, x, y in _SOLE:
            skeleton.mark(mark, "foot", (x, P.ANKLE[1] + y, P.FLOOR + 0.02), side)
    return _with_surface(skeleton.body(variant), variant)


class _Skeleton:
    """Joints, segments and landmarks, added one after the other. Places are those of the left side."""

    def __init__(self) -> None:
        self.names, self.parent, self.twists = list[str](), list[int](), list[Float]()
        self.limits_deg = list[tuple[float, float]]()
        self.segments: dict[str, int] = {"pelvis": -1}
        self.marks: dict[str, tuple[str, Float]] = {"mid_hip": ("pelvis", np.zeros(3))}

    def joint(self, segment: str, above: str, at: P.Vector, side: str = "") -> None:
        """A segment on its joint, whose axes all go through one point."""
        last, place = self.segments[above], _placed(at, side)
        for name, (axis, limits_deg) in P.JOINTS[segment].items():
            omega = np.array(P.of_side(axis, side)) / np.linalg.norm(axis)
            self.parent.append(last)
            self.names.append(P.sided(name, side))
            self.twists.append(np.concatenate([omega, -np.cross(omega, place)]))
            self.limits_deg.append(limits_deg)
            last = len(self.names) - 1
        self.segments[P.sided(segment, side)] = last

    def mark(self, name: str, segment: str, at: P.Vector, side: str = "") -> None:
        self.marks[P.sided(name, side)] = (P.sided(segment, side), _placed(at, side))

    def limb(self, joints: Sequence[tuple[str, P.Vector, str]], above: str, side: str) -> None:
        """The joints of a side, one on the other, the first one on a segment of the trunk."""
        for segment, at, mark in joints:
            self.joint(segment, above, at, side)
            above = f"{segment}_{side}"
            if mark:
                self.mark(mark, segment, at, side)

    def body(self, variant: str) -> Body:
        """The body without a surface."""
        names = tuple(self.segments)
        limits = np.deg2rad(self.limits_deg)
        owners = np.array([names.index(segment) for segment, _ in self.marks.values()], np.int32)
        marks = Landmarks(tuple(self.marks), owners, np.array([at for _, at in self.marks.values()], dtype=np.float64))
        return Body(
            f"humanoid-{variant}", tuple(self.names), np.array(self.parent, np.int32), np.array(self.twists),
            np.asarray(limits, np.float64), names, np.array(list(self.segments.values()), np.int32), np.zeros((0, 3)),
            np.zeros((0, 3), np.int32), np.zeros((0, 1), np.int32), np.zeros((0, 1)), marks,
        )  # fmt: skip


def _placed(at: P.Vector, side: str) -> Float:
    return np.array(at) * [1.0, -1.0 if side == "r" else 1.0, 1.0]


def _add_trunk(s: _Skeleton, thorax: bool, neck: bool) -> str:
    """Spine, head and its landmarks; the name of the segment that carries the arms."""
    spine = [("torso", "pelvis", P.LUMBAR), ("thorax", "torso", P.THORAX)][: 1 + thorax]
    chest = spine[-1][0]
    for segment, above, at in [*spine, ("head", chest, P.NECK)][: len(spine) + neck]:
        s.joint(segment, above, at)
    head = "head" if neck else chest
    for mark, at in (("neck", P.NECK), ("head_top", (0.0, 0.0, P.TOP)), ("nose", (0.116, 0.0, 0.683))):
        s.mark(mark, head, at)
    for side in "rl":
        for mark, at in (("eye", (0.085, 0.032, P.RATIOS["eye_height"] * P.H + P.FLOOR)), ("ear", (0.0, 0.076, 0.700))):
            s.marks[f"{mark}_{side}"] = (head, _placed(at, side))
    return chest


def _with_surface(bare: Body, variant: str) -> Body:
    with (resources.files("twistcap.body") / "humanoid.npz").open("rb") as file:
        arrays = np.load(file)
        shape = {n.removeprefix(f"{variant}_"): arrays[n] for n in arrays.files if n.startswith(variant)}
    pose = Pose.rest(bare)
    for joint, (_, angle) in zip(("arm_add", "hip_adduction"), _OUT.values(), strict=True):
        for name in (f"{joint}_r", f"{joint}_l"):
            if name in bare.coordinate_names:
                pose.q[bare.coordinate(name)] = -angle
    segments, weights = _bound(bare.segment_names, shape)
    rest = unposed(Posed(bare, pose).segment_transforms[segments], weights, shape["points"])
    return replace(bare, vertices=rest, faces=shape["faces"], skin_segments=segments, skin_weights=weights)


def _bound(names: tuple[str, ...], shape: Mapping[str, AnyArray]) -> tuple[Int, Float]:
    """Segments and weights (V, 4): from the trunk outwards, weight moves smoothly to the segment below each joint."""
    points, motions = shape["points"], limb_motions()
    out, z, chest = Binding(names, len(points)), points[:, 2], "thorax" if "thorax" in names else "torso"
    out.move("pelvis", "torso", ramp(z, P.LUMBAR[2], 0.08))
    out.move("torso", "thorax", ramp(z, P.THORAX[2], 0.07))
    out.move(chest, "head", ramp(z + 0.3 * points[:, 0], P.NECK[2] + 0.035, 0.045))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        mirrored = points * [1.0, sign, 1.0]
        out.move(chest, f"clavicle_{side}", ramp(mirrored[:, 1], 0.09, 0.06) * ramp(z, 0.40, 0.10))
        for part in _BRANCHES:
            if f"{part}_{side}" in shape:
                near = ramp(shape[f"{part}_{side}"], 0.0, _SOFT) * ramp(mirrored[:, 1], 0.015, 0.015)
                _bind_limb(out, part, side, near, se3.apply(se3.inverse(motions[part]), mirrored))
    return strongest(_smoothed(out.weights, shape["faces"]), least=0.01)


def _bind_limb(out: Binding, part: str, side: str, near: Float, local: Float) -> None:
    """One limb: `near` (V,) is its weight against the trunk, `local` (V, 3) the points in the left neutral pose."""
    for above in ("pelvis", "torso", "thorax", f"clavicle_{side}"):
        out.move(above, f"{_BRANCHES[part]}_{side}", near)
    for at, above, below, width in _HINGES[part]:
        if above == "radius":  # pronation twists the whole forearm evenly
            top, bottom = P.ELBOW[2] - 0.05, P.WRIST[2] + 0.01
            out.move(f"ulna_{side}", f"radius_{side}", np.clip((top - local[:, 2]) / (top - bottom), 0.0, 1.0))
        out.move(f"{above}_{side}", f"{below}_{side}", ramp(at[2] - local[:, 2], 0.0, width))


def _smoothed(weights: Float, faces: Int) -> Float:
    """The binding (V, S) averaged with that of the neighbours, against creases at bent joints."""
    edges, _ = edges_of(faces)
    links = coo_matrix((np.ones(2 * len(edges)), (edges.ravel(), edges[:, ::-1].ravel()))).tocsr()
    degree = np.asarray(links.sum(axis=1))
    for _ in range(_SMOOTHINGS):
        weights = 0.5 * (weights + links @ weights / degree)
    return weights
