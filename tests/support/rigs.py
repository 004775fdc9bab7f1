"""The humanoid as a rigged mesh of another program."""

from __future__ import annotations

from pathlib import Path

from pygltflib import GLTF2

from twistcap.body.gltf import save_glb
from twistcap.body.humanoid import humanoid

_SEGMENTS = ("pelvis", "torso", "head", "humerus", "ulna", "radius", "femur", "tibia", "foot")
RIGS = {  # names as the programs write them, in the order of _SEGMENTS; * is the side
    "Mixamo": ("mixamorig:Hips mixamorig:Spine mixamorig:Neck mixamorig:*Arm mixamorig:*ForeArm mixamorig:*Hand "
               "mixamorig:*UpLeg mixamorig:*Leg mixamorig:*Foot", "Right", "Left"),
    "Rigify": ("spine spine.001 spine.004 upper_arm.* forearm.* hand.* thigh.* shin.* foot.*", "R", "L"),
    "VRM": ("J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Neck J_Bip_*_UpperArm J_Bip_*_LowerArm J_Bip_*_Hand "
            "J_Bip_*_UpperLeg J_Bip_*_LowerLeg J_Bip_*_Foot", "R", "L"),
    "CMU": ("Hips LowerBack Neck *Arm *ForeArm *Hand *UpLeg *Leg *Foot", "Right", "Left"),
    "Unreal": ("pelvis spine_01 neck_01 upperarm_* lowerarm_* hand_* thigh_* calf_* foot_*", "r", "l"),
    "Unity": ("Hips Spine Neck *UpperArm *LowerArm *Hand *UpperLeg *LowerLeg *Foot", "Right", "Left"),
}  # fmt: skip


def bone_names(rig: str) -> tuple[str, ...]:
    """A rig's names of the humanoid's segments."""
    names, right, left = RIGS[rig]
    words = {"_r": right, "_l": left}

    def named(segment: str) -> str:
        side = segment[-2:] if segment[-2:] in words else ""
        return names.split()[_SEGMENTS.index(segment.removesuffix(side))].replace("*", words.get(side, ""))

    return tuple(map(named, humanoid().segment_names))


def rigged_glb(path: Path, **top: list[float]) -> Path:
    """The humanoid with Mixamo's bones, as a GLB that says nothing of twistcap.

    `top` are properties of the node above its bones.
    """
    save_glb(humanoid(), path)
    file = GLTF2().load(str(path))
    assert file is not None and file.skins[0].joints is not None and file.skins[0].skeleton is not None
    file.asset.extras = file.skins[0].extras = {}
    for joint, name in zip(file.skins[0].joints, bone_names("Mixamo"), strict=True):
        file.nodes[joint].name = name
    vars(file.nodes[file.skins[0].skeleton]).update(top)
    file.save(str(path))
    return path
