"""USD: the skinned body and its motion, read by OpenUSD itself and by Blender."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.blender import blender, needs_blender
from support.cameras import ring
from support.commands import refusal, run
from twistcap.arrays import Float
from twistcap.body import Body, Posed
from twistcap.body.humanoid import humanoid
from twistcap.estimate import Estimate
from twistcap.io.result import ResultWriter, read_result
from twistcap.studio.motion import gait

FRAMES, FPS, LOST = 12, 60.0, (3, 4)
TOLERANCE = 1e-4  # m
FROM_GLTF = [2, 0, 1]  # ours of y up, facing +z
BODY = replace(humanoid(), segment_names=tuple(f"mixamorig:{name}.x" for name in humanoid().segment_names))


@pytest.fixture
def usd() -> Any:
    found = pytest.importorskip("pxr", reason="OpenUSD is not installed (pip install usd-core)")
    from pxr import Usd, UsdGeom, UsdSkel  # pyright: ignore[reportMissingImports]

    found.Usd, found.UsdGeom, found.UsdSkel = Usd, UsdGeom, UsdSkel
    return found


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A walk in which two frames are lost; frame 7 was dropped."""
    with ResultWriter(tmp_path / "r.h5", BODY, ring(), {}) as writer:
        for n, pose in enumerate(gait(BODY, fps=FPS, frames=FRAMES, heading=0.5)):
            if n != 7:
                writer.append(Estimate(n, 2 + n / FPS, pose, np.eye(BODY.dof) * 1e-6, lost=n in LOST))
    return tmp_path / "r.h5"


def heads(body: Body, posed: Posed) -> Float:
    """(S, 3) the proximal joints, m."""
    T = posed.segment_transforms
    return np.einsum("sij,sj->si", T[:, :3, :3], body.joint_origins) + T[:, :3, 3]


def test_openusd_plays_the_motion_of_joints_and_skin(usd: Any, result: Path, tmp_path: Path) -> None:
    assert run("export", result, "--to", "usd") == 0
    stage, read = usd.Usd.Stage.Open(str(tmp_path / "motion.usd")), read_result(result)
    assert usd.UsdGeom.GetStageUpAxis(stage) == "Y" and usd.UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == FPS
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, FRAMES - 1.0)
    root, cache = usd.UsdSkel.Root(stage.GetDefaultPrim()), usd.UsdSkel.Cache()
    cache.Populate(root, usd.Usd.TraverseInstanceProxies())
    skeleton = usd.UsdSkel.Skeleton(stage.GetPrimAtPath("/person/skeleton"))
    assert tuple(skeleton.GetJointNamesAttr().Get()) == BODY.segment_names
    query = cache.GetSkelQuery(skeleton)
    assert query and query.HasBindPose() and query.HasRestPose()
    np.testing.assert_allclose(np.array(query.ComputeJointSkelTransforms(0, True))[:, 3, FROM_GLTF], BODY.joint_origins)
    mesh = usd.UsdGeom.Mesh(stage.GetPrimAtPath("/person/body"))
    skin = cache.GetSkinningQuery(mesh.GetPrim())
    motion = stage.GetPrimAtPath("/person/motion")
    assert motion.GetAttribute("rotations").GetTimeSamples() == [float(n) for n in range(FRAMES) if n != 7]
    flags = motion.GetCustomDataByKey("twistcap")
    assert list(flags["lost"]) == [3, 4] and flags["start_s"] == 2.0 and flags["fps"] == FPS
    for n, pose in zip(read.indices.tolist(), read.poses, strict=True):
        posed, at = Posed(BODY, pose), usd.Usd.TimeCode(n)
        joints = np.array(query.ComputeJointSkelTransforms(at))[:, 3, FROM_GLTF]
        np.testing.assert_allclose(joints, heads(BODY, posed), atol=TOLERANCE)
        points = mesh.GetPointsAttr().Get()
        assert skin.ComputeSkinnedPoints(query.ComputeSkinningTransforms(at), points, at)
        np.testing.assert_allclose(np.array(points)[:, FROM_GLTF], posed.vertices, atol=TOLERANCE)


def test_another_rate(usd: Any, result: Path, tmp_path: Path) -> None:
    assert run("export", result, "--to", "usd", "--fps", 24, "--out", tmp_path / "slow.usda") == 2  # another ending
    assert run("export", result, "--to", "usd", "--fps", 24) == 0
    stage = usd.Usd.Stage.Open(str(tmp_path / "motion.usd"))
    assert stage.GetTimeCodesPerSecond() == 24.0 and stage.GetEndTimeCode() == 4.0  # of 11/60 s


@needs_blender
def test_blender_plays_it(usd: Any, result: Path, tmp_path: Path) -> None:
    assert run("export", result, "--to", "usd") == 0
    read = read_result(result)
    scene = 24.0  # Blender shows a time code in each frame, whatever its scene's rate
    blender("play.py", tmp_path / "motion.usd", tmp_path / "played.npz", *(read.indices / scene))
    shown = np.load(tmp_path / "played.npz")
    wanted = np.array([heads(BODY, Posed(BODY, pose)) for pose in read.poses])
    np.testing.assert_allclose(
        shown["heads"], np.stack([wanted[..., 1], -wanted[..., 0], wanted[..., 2]], -1), atol=1e-4
    )
    assert shown["people"] == 1


def test_usd_that_is_not_installed_is_said(
    result: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("pxr", "pxr.Gf"):  # the first may have been imported
        monkeypatch.setitem(sys.modules, name, None)
    assert "pip install 'twistcap[usd]'" in refusal(capsys, "export", result, "--to", "usd")
