"""Rigs that people use, told by the names of their bones, so that a rigged GLB of theirs needs no rig file.

Mixamo, Rigify (its metarig, and DEF- bones as exported), VRM (VRoid's bones), CMU, Unreal and Unity's humanoid. Each
gives segments, coordinates and signs of the built-in humanoid; all other bones go with the bone above them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float, Int
from twistcap.body import proportions as P
from twistcap.body.rig import KINDS, SkinnedMesh
from twistcap.body.rig_spec import AXES, RIG_PAGE, Aim, Axis, JointSpec, LandmarkSpec, RigSpec, Vector, unit_vector
from twistcap.errors import InputError

_MIDDLE = ("pelvis", "spine", "neck", "head")
_SIDED = ("arm", "forearm", "hand", "thigh", "shin", "foot", "toe")
_OPTIONAL = ("head", "toe")
_TRUNK = {"spine": "torso", "neck": "head"}
"""The humanoid's segment by role."""
_LIMBS = {
    "arm": ("humerus", "forearm"), "forearm": ("ulna", "hand"), "hand": ("radius", ""),
    "thigh": ("femur", "shin"), "shin": ("tibia", "foot"), "foot": ("foot", "toe"),
}  # fmt: skip
"""The same, and the role that each points to."""
_LIKELY = 0.6  # share of the bones from which a rig is taken for a known one with gaps


@dataclass(frozen=True)
class Preset:
    """The usual names of a rig's bones: four of the middle, seven of a side, in which * is the side."""

    name: str
    middle: tuple[str, str, str, str]
    sided: tuple[str, str, str, str, str, str, str]
    sides: tuple[str, str] = ("Left", "Right")

    @property
    def bones(self) -> dict[str, str]:
        """Usual name by role, such as ``thigh_r``."""
        found: dict[str, str] = dict(zip(_MIDDLE, self.middle, strict=True))
        for side, word in zip("lr", self.sides, strict=True):
            found |= {f"{r}_{side}": n.replace("*", word) for r, n in zip(_SIDED, self.sided, strict=True)}
        return found


_CLASSIC = ("*Arm", "*ForeArm", "*Hand", "*UpLeg", "*Leg", "*Foot", "*ToeBase")
PRESETS = (
    Preset("CMU", ("Hips", "LowerBack", "Neck", "Head"), _CLASSIC),
    Preset("Mixamo", ("Hips", "Spine", "Neck", "Head"), _CLASSIC),
    Preset("Rigify", ("spine", "spine.001", "spine.004", "spine.006"),
           ("upper_arm.*", "forearm.*", "hand.*", "thigh.*", "shin.*", "foot.*", "toe.*"), ("L", "R")),
    Preset("VRM", ("J_Bip_C_Hips", "J_Bip_C_Spine", "J_Bip_C_Neck", "J_Bip_C_Head"),
           ("J_Bip_*_UpperArm", "J_Bip_*_LowerArm", "J_Bip_*_Hand", "J_Bip_*_UpperLeg", "J_Bip_*_LowerLeg",
            "J_Bip_*_Foot", "J_Bip_*_ToeBase"), ("L", "R")),
    Preset("Unreal", ("pelvis", "spine_01", "neck_01", "head"),
           ("upperarm_*", "lowerarm_*", "hand_*", "thigh_*", "calf_*", "foot_*", "ball_*"), ("l", "r")),
    Preset("Unity", ("Hips", "Spine", "Neck", "Head"),
           ("*UpperArm", "*LowerArm", "*Hand", "*UpperLeg", "*LowerLeg", "*Foot", "*Toes")),
)  # fmt: skip


def plain(name: str) -> str:
    """A bone's name without what programs add: ``mixamorig:LeftArm`` is `leftarm`, ``DEF-thigh.L`` is `thighl`."""
    name = re.sub(r"^(mixamorig\d*|def|j)[-:_]?(?=[A-Za-z])", "", name.rpartition(":")[2], flags=re.IGNORECASE)
    return re.sub(r"[^a-z0-9]", "", name.lower())


@dataclass(frozen=True)
class Fit:
    """The preset whose bones a mesh has most of, and the joint of each that it has, by role."""

    preset: Preset
    joints: Mapping[str, int]

    @property
    def share(self) -> float:
        return len(self.joints) / len(self.preset.bones)

    @property
    def missing(self) -> list[str]:
        """Usual names of the bones that it must have and has not."""
        needed = {role: bone for role, bone in self.preset.bones.items() if role.split("_")[0] not in _OPTIONAL}
        return [bone for role, bone in needed.items() if role not in self.joints]

    @property
    def in_words(self) -> str:
        """What the joints are taken for, and what to do where that is nothing."""
        known = f"{len(self.joints)} of its {len(self.preset.bones)} bones are found by name"
        if not self.missing:
            return f"it is taken for the rig of {self.preset.name}: {known}"
        return (
            f"its rig is not known ({self.preset.name} is nearest, but only {known}), so that each joint turns freely; "
            f"for joint angles with names write a rig file ({RIG_PAGE})"
        )


def best_fit(mesh: SkinnedMesh) -> Fit:
    """The preset that a mesh is likeliest to have."""
    return max((Fit(preset, _joints_of(mesh, preset)) for preset in PRESETS), key=lambda fit: fit.share)


def preset_spec(mesh: SkinnedMesh, said: RigSpec | None = None) -> RigSpec | None:
    """The rig description of a mesh whose bones have the names of a preset; None where they look like none.

    What is `said` of a rig file without [joints] goes over the preset's.
    Raises InputError where a preset is likely but bones of it are missing.
    """
    fit = best_fit(mesh)
    if fit.missing and fit.share < _LIKELY:
        return None
    if fit.missing:
        lacks, has = ", ".join(fit.missing[:4]), ", ".join(_other_bones(mesh, fit)[:4]) or "no other bone"
        mend = f"it has {has}; rename them, or write a rig file with [joints] ({RIG_PAGE})"
        look = f"its bones look like the rig of {fit.preset.name}, but {lacks} cannot be found"
        raise InputError(f"{mesh.source}: {look}: {mend}.")
    return _spec(mesh, fit.joints, said or RigSpec())


def _other_bones(mesh: SkinnedMesh, fit: Fit) -> list[str]:
    """The bones that have no role, those with most skin first."""
    order, known = np.argsort(-mesh.weights.sum(axis=0)).tolist(), set(fit.joints.values())
    return [mesh.joints[b] for b in order if b not in known]


def _joints_of(mesh: SkinnedMesh, preset: Preset) -> dict[str, int]:
    """Joint by role. Of bones with one plain name (a control beside a DEF- bone) the one with most skin counts."""
    skin, found = mesh.weights.sum(axis=0), dict[str, list[int]]()
    for b, name in enumerate(mesh.joints):
        found.setdefault(plain(name), []).append(b)
    roles = {role: found[plain(bone)] for role, bone in preset.bones.items() if plain(bone) in found}
    return {role: max(bones, key=lambda b: skin[b]) for role, bones in roles.items()}


def _spec(mesh: SkinnedMesh, joints: Mapping[str, int], said: RigSpec) -> RigSpec:
    own = {"forward": _forward(mesh, joints, unit_vector(said.up)), "root": mesh.joints[joints["pelvis"]]}
    spec = RigSpec.model_validate({**own, "keep": [], "origin": "mid_hip"} | said.model_dump(exclude_unset=True))
    at = mesh.vertices @ spec.to_rest().T, mesh.frames[:, :3, 3] @ spec.to_rest().T
    named = {role: mesh.joints[b] for role, b in joints.items()}
    specs = {named["pelvis"]: JointSpec(segment="pelvis")}
    specs |= {named[role]: _joint(segment, "") for role, segment in _TRUNK.items()}
    for side in "rl":
        specs |= _limbs(named, side)
    marks = _landmarks(mesh, joints, *at) | (said.landmarks or {})
    return spec.model_copy(update={"joints": specs, "landmarks": marks})


def _forward(mesh: SkinnedMesh, joints: Mapping[str, int], up: Float) -> Axis:
    """The file's level axis that the body looks along: left × up, by the hips."""
    left = mesh.frames[joints["thigh_l"], :3, 3] - mesh.frames[joints["thigh_r"], :3, 3]
    ahead = np.cross(left, up)
    return AXES[int(np.argmax(np.r_[ahead, -ahead]))]


def _joint(segment: str, side: str, aim: Aim | None = None) -> JointSpec:
    """The joint that moves a segment of the built-in humanoid."""
    own = P.JOINTS[segment]
    return JointSpec(
        kind=KINDS[len(own) - 1], axes=[P.of_side(axis, side) for axis, _ in own.values()],
        names=[P.sided(name, side) for name in own], limits_deg=[limits for _, limits in own.values()],
        segment=P.sided(segment, side), aim=aim,
    )  # fmt: skip


def _limbs(named: Mapping[str, str], side: str) -> dict[str, JointSpec]:
    """Arms and legs of a side, turned straight down in the rest pose."""
    out: dict[str, JointSpec] = {}
    for role, (segment, below) in _LIMBS.items():
        at = named.get(f"{below}_{side}")
        along = "file" if role == "foot" else (0.0, 0.0, -1.0)
        out[named[f"{role}_{side}"]] = _joint(segment, side, Aim(at=at, along=along) if at else None)
    return out


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
