"""Rigs that people use, told by the names of their bones, so that a rigged GLB of theirs needs no rig file.

Mixamo, Rigify (its metarig, and DEF- bones as exported), VRM (VRoid's bones), CMU, Unreal and Unity's humanoid. Each
gives segments, coordinates and signs of the built-in humanoid; all other bones go with the bone above them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float, Int
from twistcap.body.rig import SkinnedMesh
from twistcap.body.rig_spec import Aim, Axis, JointSpec, LandmarkSpec, RigSpec, Vector
from twistcap.errors import InputError

_MIDDLE = ("pelvis", "spine", "neck", "head")
_SIDED = ("arm", "forearm", "hand", "thigh", "shin", "foot", "toe")
_OPTIONAL = ("head", "toe")
_LIKELY = 0.6  # share of the bones from which a rig is taken for a known one with gaps
_HEIGHTS = (0.4, 3.5)  # m; what is beyond is in another unit


@dataclass(frozen=True)
class Preset:
    """The plain names (see `plain`) of a rig's bones: four of the middle, seven of a side, in which * is the side."""

    name: str
    middle: tuple[str, str, str, str]
    sided: tuple[str, str, str, str, str, str, str]
    sides: tuple[str, str] = ("left", "right")

    @property
    def bones(self) -> dict[str, str]:
        """Plain name by role, such as ``thigh_r``."""
        found: dict[str, str] = dict(zip(_MIDDLE, self.middle, strict=True))
        for side, word in zip("lr", self.sides, strict=True):
            found |= {f"{r}_{side}": n.replace("*", word) for r, n in zip(_SIDED, self.sided, strict=True)}
        return found


_CLASSIC = ("*arm", "*forearm", "*hand", "*upleg", "*leg", "*foot", "*toebase")
PRESETS = (
    Preset("CMU", ("hips", "lowerback", "neck", "head"), _CLASSIC),
    Preset("Mixamo", ("hips", "spine", "neck", "head"), _CLASSIC),
    Preset("Rigify", ("spine", "spine001", "spine004", "spine006"),
           ("upperarm*", "forearm*", "hand*", "thigh*", "shin*", "foot*", "toe*"), ("l", "r")),
    Preset("VRM", ("bipchips", "bipcspine", "bipcneck", "bipchead"),
           ("bip*upperarm", "bip*lowerarm", "bip*hand", "bip*upperleg", "bip*lowerleg", "bip*foot", "bip*toebase"),
           ("l", "r")),
    Preset("Unreal", ("pelvis", "spine01", "neck01", "head"),
           ("upperarm*", "lowerarm*", "hand*", "thigh*", "calf*", "foot*", "ball*"), ("l", "r")),
    Preset("Unity", ("hips", "spine", "neck", "head"),
           ("*upperarm", "*lowerarm", "*hand", "*upperleg", "*lowerleg", "*foot", "*toes")),
)  # fmt: skip


def plain(name: str) -> str:
    """A bone's name without what programs add: ``mixamorig:LeftArm`` is `leftarm`, ``DEF-thigh.L`` is `thighl`."""
    name = re.sub(r"^(mixamorig\d*|def|j)[-:_]?(?=[A-Za-z])", "", name.rpartition(":")[2], flags=re.IGNORECASE)
    return re.sub(r"[^a-z0-9]", "", name.lower())


def preset_spec(mesh: SkinnedMesh) -> RigSpec | None:
    """The rig description of a mesh whose bones have the names of a preset; None where they look like none.

    Raises InputError where a preset is likely but bones of it are missing, or the person is not of a person's height.
    """
    preset, joints = max(((p, _joints_of(mesh, p)) for p in PRESETS), key=lambda found: _share(*found))
    missing = [
        bone for role, bone in preset.bones.items() if role not in joints and role.split("_")[0] not in _OPTIONAL
    ]
    if missing and _share(preset, joints) < _LIKELY:
        return None
    if missing:
        some = ", ".join(missing[:4])
        raise InputError(
            f"{mesh.source}: its bones look like a {preset.name} rig, but {some} cannot be found; write a rig file "
            "beside it (docs/formats/body-files.md)."
        )
    return _spec(mesh, joints)


def _share(preset: Preset, joints: Mapping[str, int]) -> float:
    return len(joints) / len(preset.bones)


def _joints_of(mesh: SkinnedMesh, preset: Preset) -> dict[str, int]:
    """Joint by role. Of bones with one plain name (a control beside a DEF- bone) the one with most skin counts."""
    skin, found = mesh.weights.sum(axis=0), dict[str, list[int]]()
    for b, name in enumerate(mesh.joints):
        found.setdefault(plain(name), []).append(b)
    roles = {role: found[bone] for role, bone in preset.bones.items() if bone in found}
    return {role: max(bones, key=lambda b: skin[b]) for role, bones in roles.items()}


def _spec(mesh: SkinnedMesh, joints: Mapping[str, int]) -> RigSpec:
    forward = _forward(mesh, joints)
    spec = RigSpec(up="y", forward=forward, keep=[], root=mesh.joints[joints["pelvis"]], origin="mid_hip")
    at = mesh.vertices @ spec.to_rest().T, mesh.frames[:, :3, 3] @ spec.to_rest().T
    height = float(np.ptp(at[0][:, 2]))
    if not _HEIGHTS[0] < height < _HEIGHTS[1]:
        raise InputError(f"{mesh.source}: the body is {height:.3g} m high; export it in metres.")
    named = {role: mesh.joints[b] for role, b in joints.items()}
    specs = {named["pelvis"]: JointSpec(segment="pelvis"), **_trunk(named)}
    for side, sign in (("r", 1.0), ("l", -1.0)):
        specs |= _limbs(named, side, sign)
    return spec.model_copy(update={"joints": specs, "landmarks": _landmarks(mesh, joints, *at)})


def _forward(mesh: SkinnedMesh, joints: Mapping[str, int]) -> Axis:
    """The file's level axis that the body looks along: left × up, by the hips."""
    left = mesh.frames[joints["thigh_l"], :3, 3] - mesh.frames[joints["thigh_r"], :3, 3]
    ahead = np.cross(left, [0.0, 1.0, 0.0])
    axis: dict[tuple[int, bool], Axis] = {(0, True): "x", (0, False): "-x", (2, True): "z", (2, False): "-z"}
    k = 0 if abs(ahead[0]) > abs(ahead[2]) else 2
    return axis[k, bool(ahead[k] > 0)]


def _ball(segment: str, names: Sequence[str], limits: Sequence[tuple[float, float]], sign: float, first: str,
          aim: Aim | None = None) -> JointSpec:  # fmt: skip
    """A joint of flexion about −y, and of bending and rotation that mirror; `first` names the outermost."""
    flex, side, turn = (0.0, -1.0, 0.0), (sign, 0.0, 0.0), (0.0, 0.0, sign)
    axes: list[Vector] = [flex, side, turn] if first == "flexion" else [side, flex, turn]
    return JointSpec(kind="ball", axes=axes, names=list(names), limits_deg=list(limits), segment=segment, aim=aim)


def _trunk(named: Mapping[str, str]) -> dict[str, JointSpec]:
    out: dict[str, JointSpec] = {}
    for role, stem, segment, limits in (
        ("spine", "lumbar", "torso", [(-60.0, 25.0), (-35.0, 35.0), (-45.0, 45.0)]),
        ("neck", "neck", "head", [(-60.0, 75.0), (-45.0, 45.0), (-80.0, 80.0)]),
    ):
        names = [f"{stem}_{way}" for way in ("extension", "bending", "rotation")]
        out[named[role]] = _ball(segment, names, limits, 1.0, "flexion")
    return out


def _limbs(named: Mapping[str, str], side: str, sign: float) -> dict[str, JointSpec]:
    """Arms and legs of a side, turned straight down in the rest pose."""

    def bone(role: str) -> str:
        return named[f"{role}_{side}"]

    def down(role: str) -> Aim:
        return Aim(at=bone(role), along=(0.0, 0.0, -1.0))

    def hinge(segment: str, name: str, axis: Vector, limits: tuple[float, float], aim: Aim | None = None) -> JointSpec:
        return JointSpec(kind="revolute", axes=[axis], names=[f"{name}_{side}"], limits_deg=[limits],
                         segment=f"{segment}_{side}", aim=aim)  # fmt: skip

    arm = [f"{name}_{side}" for name in ("arm_add", "arm_flex", "arm_rot")]
    hip = [f"hip_{way}_{side}" for way in ("flexion", "adduction", "rotation")]
    ankle: list[Vector] = [(-0.105 * sign, -0.979, -0.174 * sign), (0.787 * sign, 0.121, 0.605 * sign)]
    foot = JointSpec(
        kind="universal", axes=ankle, names=[f"ankle_angle_{side}", f"subtalar_angle_{side}"],
        limits_deg=[(-50.0, 30.0), (-25.0, 35.0)], segment=f"foot_{side}",
        aim=Aim(at=bone("toe"), along="file") if f"toe_{side}" in named else None,
    )  # fmt: skip
    arm_limits, hip_limits = (
        [(-180.0, 45.0), (-60.0, 180.0), (-90.0, 90.0)],
        [(-30.0, 125.0), (-50.0, 30.0), (-45.0, 45.0)],
    )
    return {
        bone("arm"): _ball(f"humerus_{side}", arm, arm_limits, sign, "adduction", down("forearm")),
        bone("forearm"): hinge("ulna", "elbow_flex", (0.0, -1.0, 0.0), (0.0, 150.0), down("hand")),
        bone("hand"): hinge("radius", "pro_sup", (0.0, 0.0, sign), (-90.0, 90.0)),
        bone("thigh"): _ball(f"femur_{side}", hip, hip_limits, sign, "flexion", down("shin")),
        bone("shin"): hinge("tibia", "knee_angle", (0.0, 1.0, 0.0), (-10.0, 145.0), down("foot")),
        bone("foot"): foot,
    }


def _landmarks(
    mesh: SkinnedMesh, joints: Mapping[str, int], vertices: Float, heads: Float
) -> dict[str, str | LandmarkSpec]:
    """Joint centres, and of the surface the top of the head, tips of the toes and heels (our axes, m)."""
    marks: dict[str, str | LandmarkSpec] = {"neck": mesh.joints[joints["neck"]]}
    centres = {"hip": "thigh", "knee": "shin", "ankle": "foot", "shoulder": "arm", "elbow": "forearm", "wrist": "hand"}
    for side in "rl":
        marks |= {f"{m}_{side}": mesh.joints[joints[f"{role}_{side}"]] for m, role in centres.items()}
        foot = _below(mesh.parents, joints[f"foot_{side}"])
        marks |= _extremes(mesh, vertices, foot, {f"toe_{side}": (1.0, 0.0, 0.0), f"heel_{side}": (-1.0, 0.0, 0.0)})
    marks |= _extremes(mesh, vertices, _below(mesh.parents, joints["neck"]), {"head_top": (0.0, 0.0, 1.0)})
    middle = heads[[joints["thigh_r"], joints["thigh_l"]]].mean(axis=0)
    return marks | {"mid_hip": _at(mesh.joints[joints["pelvis"]], middle)}


def _extremes(
    mesh: SkinnedMesh, vertices: Float, bones: Int, wanted: Mapping[str, Vector]
) -> dict[str, str | LandmarkSpec]:
    """The farthest vertex in a direction, of those that follow some bones more than others."""
    own = vertices[mesh.weights[:, bones].sum(axis=1) > 0.5 * mesh.weights.sum(axis=1)]
    if not len(own):
        return {}
    return {mark: _at(mesh.joints[bones[0]], own[np.argmax(own @ np.array(way))]) for mark, way in wanted.items()}


def _at(joint: str, point: Float) -> LandmarkSpec:
    x, y, z = point.tolist()
    return LandmarkSpec(joint=joint, at=(x, y, z))


def _below(parents: Int, top: int) -> Int:
    """A bone and all below it; parents come before their children."""
    inside = [top]
    for b in range(len(parents)):
        if parents[b] in inside:
            inside.append(b)
    return np.array(inside, np.int32)
