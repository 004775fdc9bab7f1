"""Rigs that are told by the names of their bones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.rigs import RIGS, bone_names
from twistcap import se3
from twistcap.body.humanoid import humanoid
from twistcap.body.rig import SkinnedMesh, build_body
from twistcap.body.rig_presets import best_fit, preset_spec
from twistcap.body.rig_spec import RigSpec
from twistcap.errors import InputError

TO_FILE = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # ours to glTF: y up, facing z


def mesh_of(rig: str, turn: float = 0.0, axis: int = 1, scale: float = 1.0) -> SkinnedMesh:
    """The humanoid's surface and joints under a rig's names, turned about an axis of the file, by default its
    vertical."""
    body = humanoid()
    C = scale * se3.exp_rotation(turn * np.eye(3)[axis]) @ TO_FILE
    weights = np.zeros((len(body.vertices), len(body.segment_names)))
    np.add.at(weights, (np.arange(len(weights))[:, None], body.skin_segments), body.skin_weights)
    frames = se3.transform(np.eye(3), body.joint_origins @ C.T)
    return SkinnedMesh(
        "x", "x.glb", bone_names(rig), body.segment_parent, frames, body.vertices @ C.T, body.faces, weights
    )


@pytest.mark.parametrize("turn", [0.0, np.pi, np.pi / 2])  # VRM 0 looks along −z
@pytest.mark.parametrize("rig", sorted(RIGS))
def test_a_known_rig_becomes_the_humanoid(rig: str, turn: float) -> None:
    mesh, ours = mesh_of(rig, turn), humanoid()
    spec = preset_spec(mesh)
    assert spec is not None
    body = build_body(mesh, spec, 8)
    assert body.coordinate_names == ours.coordinate_names and body.segment_names == ours.segment_names
    np.testing.assert_allclose(body.twists[:, :3], ours.twists[:, :3], atol=1e-6)
    np.testing.assert_allclose(body.limits, ours.limits, atol=1e-9)
    for name in ("hip_r", "knee_l", "ankle_r", "shoulder_l", "mid_hip", "head_top"):
        mine, theirs = (b.landmarks.points[b.landmarks.index(name)] for b in (body, ours))
        np.testing.assert_allclose(mine, theirs, atol=0.03)  # its legs are turned straight down


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        (mesh_of("Unreal", np.pi / 2, axis=0), RigSpec(up="z")),
        (mesh_of("Mixamo", scale=100.0), RigSpec(scale=0.01, landmarks={"fist_r": "mixamorig:RightHand"})),
    ],
)
def test_a_rig_file_without_joints_goes_over_the_preset(mesh: SkinnedMesh, said: RigSpec) -> None:
    spec, ours = preset_spec(mesh, said), humanoid()
    assert spec is not None and not said.says_joints and RigSpec().says_joints and RigSpec(joints={}).says_joints
    body = build_body(mesh, spec, 8)
    assert body.coordinate_names == ours.coordinate_names
    np.testing.assert_allclose(body.twists[:, :3], ours.twists[:, :3], atol=1e-6)
    np.testing.assert_allclose(np.ptp(body.vertices[:, 2]), np.ptp(ours.vertices[:, 2]), atol=0.01)
    assert ("fist_r" in body.landmarks.names) == (said.scale != 1.0)


def test_a_rig_with_gaps_is_told_and_an_unknown_one_is_left_alone() -> None:
    mesh = mesh_of("Mixamo")
    gap = replace(mesh, joints=tuple("Stump" if "LeftFoot" in name else name for name in mesh.joints))
    with pytest.raises(
        InputError, match="the rig of Mixamo, but LeftFoot cannot be found: it has Stump; rename them, or"
    ):
        preset_spec(gap)
    strange = replace(mesh, joints=tuple(f"bone_{k}" for k in range(len(mesh.joints))))
    assert preset_spec(strange) is None
    assert "only 0 of its 18 bones are found by name" in best_fit(strange).in_words
    assert "write a rig file (docs/formats/body-files.md)" in best_fit(strange).in_words
    assert best_fit(mesh).in_words == "it is taken for the rig of Mixamo: 15 of its 18 bones are found by name"


@pytest.mark.parametrize("file", [False, True])
@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        (mesh_of("Unreal", np.pi / 2, axis=0), r'head is not above the feet.* \+Y up, or say up = "z" in a rig file'),
        (mesh_of("Unreal", scale=100.0), "175 m high; export it in metres, or say scale .* scale = 0.01 for cm"),
    ],
)
def test_another_axis_up_and_another_unit_are_told(mesh: SkinnedMesh, said: str, file: bool) -> None:
    """Without a rig file, and with one, whose landmarks have places of their own."""
    spec = preset_spec(mesh_of("Unreal") if file else mesh)
    assert spec is not None
    with pytest.raises(InputError, match=said):
        build_body(mesh, spec, 8)
