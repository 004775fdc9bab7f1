"""Blender by its Python package: it wants another numpy than we do, so that it lives in an environment of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from twistcap.body import Body, Pose, Posed

HERE, REPOSITORY = Path(__file__).parent, Path(__file__).parents[3]


def _python() -> str | None:
    """A Python that can import bpy: of TWISTCAP_BPY, or of the repository's .venv-bpy (`make blender`)."""
    named = os.environ.get("TWISTCAP_BPY") or str(REPOSITORY / ".venv-bpy" / "bin" / "python")
    return shutil.which(named)


PYTHON = _python()
needs_blender = pytest.mark.skipif(PYTHON is None, reason="no Blender here (make blender, or TWISTCAP_BPY)")


def blender(script: str, *arguments: object) -> None:
    """Run one of the scripts beside this file."""
    command = [str(PYTHON), str(HERE / script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


ROLES = ("pelvis", "torso", "head", "humerus", "ulna", "radius", "femur", "tibia", "foot")
# Bones by role, those of a side with the side's word in place of *; then a toe, a finger and one that only they have.
NAMES = {
    "mixamo": (("mixamorig:Hips", "mixamorig:Spine", "mixamorig:Neck", "mixamorig:*Arm", "mixamorig:*ForeArm",
                "mixamorig:*Hand", "mixamorig:*UpLeg", "mixamorig:*Leg", "mixamorig:*Foot"),
               ("Left", "Right"), "mixamorig:*ToeBase", "mixamorig:*HandIndex1"),
    "rigify": (("DEF-spine", "DEF-spine.001", "DEF-spine.004", "DEF-upper_arm.*", "DEF-forearm.*", "DEF-hand.*",
                "DEF-thigh.*", "DEF-shin.*", "DEF-foot.*"), ("L", "R"), "DEF-toe.*", "DEF-f_index.01.*"),
}  # fmt: skip


def person(path: Path, body: Body, kind: str) -> Path:
    """The humanoid in a T pose as an NPZ for ``make_rigged.py``, with bones of a kind, toes, fingers and a pigtail."""
    q = np.zeros(len(body.coordinate_names))
    for side in "rl":
        q[body.coordinate(f"arm_add_{side}")] = np.radians(-85.0)
    posed = Posed(body, Pose(np.eye(4), q))
    middle, (left, right), toe, finger = NAMES[kind]
    words = {"_l": left, "_r": right}

    def named(segment: str) -> str:
        side = segment[-2:] if segment[-2:] in words else ""
        return middle[ROLES.index(segment.removesuffix(side))].replace("*", words.get(side, ""))

    origins = np.einsum("sij,sj->si", posed.segment_transforms[:, :3, :3], body.joint_origins)
    origins += posed.segment_transforms[:, :3, 3]
    names = [named(segment) for segment in body.segment_names]
    parents = [names[p] if p >= 0 else "" for p in body.segment_parent]
    heads, marks = list(origins), dict(zip(body.landmarks.names, posed.landmarks, strict=True))
    weights = np.zeros((len(body.vertices), len(names)))
    np.add.at(weights, (np.arange(len(weights))[:, None], body.skin_segments), body.skin_weights)
    tails = [heads[names.index(named(_next(s)))] if _next(s) else h + np.array([0.0, 0.0, 0.1])
             for s, h in zip(body.segment_names, heads, strict=True)]  # fmt: skip
    for side, word in words.items():
        for name, above, at in ((toe, f"foot{side}", marks[f"toe{side}"] - [0.06, 0, 0]),
                                (finger, f"radius{side}", marks[f"wrist{side}"] * [1, 1.12, 1])):  # fmt: skip
            names.append(name.replace("*", word))
            parents.append(named(above))
            heads.append(at)
            tails.append(at + np.array([0.05, 0.0, 0.0]))
    names, parents = [*names, "Pigtail"], [*parents, named("head")]
    heads, tails = [*heads, marks["head_top"]], [*tails, marks["head_top"] + [-0.2, 0.0, 0.0]]
    weights = np.hstack([weights, np.zeros((len(weights), len(names) - weights.shape[1]))])
    # Blender looks along −y: ours (x forward, y left, z up) is its (−y, x, z).
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.savez(path, names=names, parents=parents, heads=np.array(heads) @ turn.T, tails=np.array(tails) @ turn.T,
             vertices=posed.vertices @ turn.T, faces=body.faces, weights=weights)  # fmt: skip
    return path


def _next(segment: str) -> str:
    """The segment that a bone points to."""
    chain = {"pelvis": "torso", "torso": "head", "humerus": "ulna", "ulna": "radius", "femur": "tibia", "tibia": "foot"}
    side = segment[-2:] if segment[-2:] in ("_l", "_r") else ""
    return chain[segment.removesuffix(side)] + side if segment.removesuffix(side) in chain else ""
