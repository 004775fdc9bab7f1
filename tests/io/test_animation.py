"""The animator's path: a rigged GLB of Blender's, tracked without a rig file, comes back with its own bones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pybvh
import pytest
from pygltflib import GLTF2
from scipy.spatial import cKDTree

from support.blender import NAMES, blender, needs_blender, person
from support.pages_shared import run
from twistcap import hindsight
from twistcap.arrays import Float
from twistcap.body import Posed
from twistcap.body.gltf import load_glb
from twistcap.body.humanoid import humanoid
from twistcap.body.rig_presets import plain
from twistcap.build import build
from twistcap.evaluate.metrics import JOINT_CENTRES
from twistcap.io.result import ResultWriter, read_result
from twistcap.studio import StudioConfig, capture
from twistcap.studio.motion import gait

FRAMES, FPS = 12, 60.0
TOLERANCE = 1e-4  # m


@pytest.fixture(scope="module", params=sorted(NAMES))
def tracked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Float]:
    """The rigged GLB, a result tracked with it, and the true joint centres (T, L, 3)."""
    folder = tmp_path_factory.mktemp(request.param)
    source, result = folder / "hero.glb", folder / "result.h5"
    blender("make_rigged.py", person(folder / "person.npz", humanoid(), request.param), source)
    body = load_glb(source)
    scene = StudioConfig(seed=5, views=3, frames=FRAMES, fps=FPS)
    walk = capture(scene, body, gait(body, fps=FPS, frames=FRAMES))
    with ResultWriter(result, body, walk.rig, {}) as writer:
        for estimate in hindsight.tracked(walk.frames(), build(body, walk.rig), walk.first_pose):
            writer.append(estimate)
    return source, result, np.array([Posed(body, pose).landmarks for pose in walk.true_poses])


def content(path: Path) -> tuple[GLTF2, bytes]:
    gltf = GLTF2().load(str(path))
    assert gltf is not None
    return gltf, bytes(gltf.binary_blob() or b"")


def played(motion: Path, times: Float, folder: Path) -> Any:
    out = folder / f"{motion.name}.npz"
    blender("play.py", motion, out, *times)
    return np.load(out)


CENTRES = {"shoulder": "upperarm arm", "elbow": "forearm", "wrist": "hand", "hip": "thigh upleg", "knee": "shin leg",
           "ankle": "foot"}  # fmt: skip


def bone_of(mark: str, names: Any) -> int:
    """The bone whose head is a joint centre, such as ``knee_r``."""
    joint, side = mark.split("_")
    words = {"r": "right", "l": "left"}[side]
    wanted = {w for bone in CENTRES[joint].split() for w in (words + bone, bone + side)}
    return next(k for k, name in enumerate(names) if plain(str(name)) in wanted)


def to_blender(points: Float) -> Float:
    """Our world (x forward, z up) as Blender shows a glTF: its −y is forward."""
    return np.stack([points[..., 1], -points[..., 0], points[..., 2]], axis=-1)


@needs_blender
def test_a_rig_of_known_names_is_tracked_without_a_rig_file(tracked: tuple[Path, Path, Float]) -> None:
    source, result, truth = tracked
    read, body = read_result(result), load_glb(source)
    assert not list(source.parent.glob("*.toml")) and not read.lost.any()
    assert body.coordinate_names == humanoid().coordinate_names
    k = [body.landmarks.index(name) for name in JOINT_CENTRES]
    errors = np.linalg.norm(np.array([Posed(body, p).landmarks[k] for p in read.poses]) - truth[:, k], axis=2)
    assert errors.mean() < 0.012  # m, as with the humanoid in three views


@needs_blender
def test_the_glb_comes_back_as_it_was_with_the_motion(tracked: tuple[Path, Path, Float], tmp_path: Path) -> None:
    source, result, _ = tracked
    out = tmp_path / "walk.glb"
    assert run("export", result, "--to", "glb", "--into", source, "--out", out) == 0
    (was, before), (now, after) = content(source), content(out)
    assert after[: len(before)] == before  # vertices, UVs, weights, bind matrices: byte for byte
    for part in ("nodes", "meshes", "materials", "skins", "scenes"):
        assert repr(getattr(now, part)) == repr(getattr(was, part)), part
    assert was.meshes[0].primitives[0].attributes.TEXCOORD_0 is not None and len(was.meshes[0].primitives) == 2
    moved = {now.nodes[channel.target.node].name for channel in now.animations[0].channels}
    assert "Pigtail" not in moved and not any("ndex" in name for name in moved)  # they go with the bone above them
    read, times = read_result(result), np.arange(FRAMES) / FPS
    between = (times[:-1] + times[1:]) / 2
    shown, rest = played(out, np.append(times, between), tmp_path), played(source, times[:1], tmp_path)
    np.testing.assert_array_equal(shown["names"], rest["names"])
    np.testing.assert_array_equal(shown["parents"], rest["parents"])
    np.testing.assert_allclose(shown["rest"], rest["rest"], atol=1e-6)
    assert list(shown["materials"]) == ["Skin", "Cloth"]
    assert np.ptp(shown["frame_range"]) / shown["fps"] == pytest.approx((FRAMES - 1) / FPS, abs=1e-4)
    marks, one = read.body.landmarks, read.body.skin_weights.max(axis=1) > 1 - 1e-6
    for frame, pose in enumerate(read.poses):
        posed = Posed(read.body, pose)
        for mark in (f"{joint}_{side}" for joint in CENTRES for side in "rl"):
            place = shown["heads"][frame, bone_of(mark, shown["names"])]
            np.testing.assert_allclose(place, to_blender(posed.landmarks[marks.index(mark)]), atol=TOLERANCE)
        off = cKDTree(shown["vertices"][frame]).query(to_blender(posed.vertices))[0]
        assert one.sum() > 700 and off[one].max() < TOLERANCE
        assert off.max() < 0.018  # at the shoulders: our rest pose has the arms down, and skin blends from there
    keys, half = shown["vertices"][:FRAMES], shown["vertices"][FRAMES:]  # between two keys: between two shapes
    middle = (keys[1:] + keys[:-1]) / 2
    assert np.linalg.norm(half - middle, axis=2).max() < 2e-3


@needs_blender
def test_the_bvh_has_the_same_bones_and_motion(tracked: tuple[Path, Path, Float], tmp_path: Path) -> None:
    source, result, _ = tracked
    out = tmp_path / "walk.bvh"
    assert run("export", result, "--to", "bvh", "--into", source, "--out", out) == 0
    bvh: Any = pybvh.read_bvh_file(out, warn_on_world_up_disagreement=False)
    assert bvh.fps == pytest.approx(FPS, rel=1e-6)
    read, times = read_result(result), np.arange(FRAMES) / FPS
    shown = played(out, times, tmp_path)
    glb = tmp_path / "walk.glb"
    run("export", result, "--to", "glb", "--into", source, "--out", glb)
    skinned = played(glb, times, tmp_path)
    assert list(shown["names"]) and set(shown["names"]) == set(skinned["names"])
    order = [list(skinned["names"]).index(name) for name in shown["names"]]
    np.testing.assert_allclose(shown["heads"], skinned["heads"][:, order], atol=TOLERANCE)
    for mark in ("ankle_r", "wrist_l"):
        k = read.body.landmarks.index(mark)
        places = np.array([Posed(read.body, pose).landmarks[k] for pose in read.poses])
        heads = shown["heads"][:, bone_of(mark, shown["names"])]
        np.testing.assert_allclose(heads, to_blender(places), atol=TOLERANCE)
    assert np.ptp(shown["frame_range"]) == FRAMES - 1  # a key for each frame; Blender takes no rate from a BVH


@needs_blender
def test_a_bvh_of_blenders_own_rate_plays_at_the_right_speed(tracked: tuple[Path, Path, Float], tmp_path: Path) -> None:
    source, result, _ = tracked
    out, glb = tmp_path / "slow.bvh", tmp_path / "walk.glb"
    assert run("export", result, "--to", "bvh", "--into", source, "--fps", 24, "--out", out) == 0
    assert run("export", result, "--to", "glb", "--into", source, "--out", glb) == 0
    times = np.arange(1 + int((FRAMES - 1) / FPS * 24)) / 24
    shown, skinned = played(out, times, tmp_path), played(glb, times, tmp_path)
    bvh: Any = pybvh.read_bvh_file(out, warn_on_world_up_disagreement=False)
    assert shown["fps"] == 24 and bvh.fps == pytest.approx(24, rel=1e-6)  # so that a line is a frame of the scene
    order = [list(skinned["names"]).index(name) for name in shown["names"]]
    np.testing.assert_allclose(shown["heads"], skinned["heads"][:, order], atol=1e-3)  # two ways to interpolate


@needs_blender
def test_a_file_that_was_not_tracked_is_refused(
    tracked: tuple[Path, Path, Float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, result, _ = tracked
    other = tmp_path / "other.glb"
    assert run("export", result, "--to", "glb", "--out", other) == 0  # the tracked body, of ours
    assert run("export", result, "--to", "glb", "--into", other) == 2
    assert "body of twistcap" in capsys.readouterr().err
    beside = source.with_name("renamed.glb")
    beside.write_bytes(source.read_bytes())
    beside.with_name("renamed.rig.toml").write_text("")  # every joint a ball: another body
    assert run("export", result, "--to", "glb", "--into", beside) == 2
    assert "not those of the tracked body" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "expected"),
    [("mixamorig:LeftArm", "leftarm"), ("mixamorig1:Hips", "hips"), ("mixamorigHips", "hips"),
     ("DEF-thigh.L", "thighl"), ("upper_arm.R", "upperarmr"), ("J_Bip_L_UpperArm", "biplupperarm"),
     ("spine_01", "spine01"), ("Hips", "hips")],
)  # fmt: skip
def test_names_lose_what_programs_add(name: str, expected: str) -> None:
    assert plain(name) == expected
