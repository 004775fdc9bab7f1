"""BVH and GLB: their times and rates, and the flag of frames that are predicted."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pybvh
import pytest
from pygltflib import GLTF2

from support.cameras import ring
from support.commands import refusal, run
from twistcap.arrays import Float
from twistcap.body import Body, Pose
from twistcap.body._gltf_buffers import Buffers
from twistcap.body.humanoid import humanoid
from twistcap.estimate import Estimate
from twistcap.io.playback import playback
from twistcap.io.result import ResultWriter, read_result
from twistcap.studio.motion import gait

BODY, FPS = humanoid("legs"), 60.0
LOST = (5, 6, 20)


def written(folder: Path, times: Float, poses: Sequence[Pose], body: Body = BODY) -> Path:
    unit = np.eye(body.dof) * 1e-4
    with ResultWriter(folder / "r.h5", body, ring(), {}) as writer:
        for n, (time, pose) in enumerate(zip(times, poses, strict=True)):
            writer.append(Estimate(n, float(time), pose, unit, lost=n in LOST))
    return folder / "r.h5"


def walk(times: Float, body: Body = BODY) -> list[Pose]:
    """A walk at any times: multiples of 1/600 s, the first at 2 s."""
    fine = gait(body, fps=600.0, frames=1200)
    return [fine[round((time - 2.0) * 600)] for time in times]


def keys(path: Path) -> tuple[Float, Any]:
    """Key times of a GLB's first animation, and its extras."""
    gltf = GLTF2().load(str(path))
    assert gltf is not None
    animation = gltf.animations[0]
    return Buffers(gltf, path).accessor(animation.samplers[0].input, "times")[:, 0], animation.extras["twistcap"]


def hips(poses: Sequence[Pose]) -> Float:
    """(T, 3) the joint of the pelvis, in our world."""
    return np.array([pose.root[:3, :3] @ BODY.joint_origins[0] + pose.root[:3, 3] for pose in poses])


def roots(path: Path) -> Float:
    """(T, 3) places of the first joint of a BVH, in our world."""
    bvh: Any = pybvh.read_bvh_file(path, warn_on_world_up_disagreement=False)
    return bvh.joint_positions()[:, 0, [2, 0, 1]]


def test_a_glb_has_a_key_for_each_frame_at_its_time_and_the_flag(tmp_path: Path) -> None:
    times = 2.0 + np.delete(np.arange(40), [11, 12]) / FPS  # two frames were dropped
    result = written(tmp_path, times, walk(times))
    assert run("export", result, "--to", "glb") == 0
    found, extras = keys(tmp_path / "motion.glb")
    np.testing.assert_allclose(found, times - 2.0, atol=1e-6)
    assert extras == {"fps": 60.0, "frames": 38, "start_s": 2.0, "lost": [[5, 6], [20, 20]]}


def test_a_bvh_is_even_where_the_recording_is_not(tmp_path: Path) -> None:
    times = 2.0 + np.delete(np.arange(40), [11, 12]) / FPS
    result = written(tmp_path, times, walk(times))
    assert run("export", result, "--to", "bvh") == 0
    even = 2.0 + np.arange(40) / FPS
    wanted = hips(walk(even))
    places = roots(tmp_path / "motion.bvh")
    np.testing.assert_allclose(places, wanted, atol=5e-3)  # straight across the gap
    kept = np.delete(np.arange(40), [11, 12])
    np.testing.assert_allclose(places[kept], wanted[kept], atol=1e-5)
    flags = json.loads((tmp_path / "motion.flags.json").read_text())
    assert flags == {
        "fps": 60.0,
        "frames": 40,
        "start_s": 2.0,
        "lost": [[5, 6], [11, 12], [22, 22]],
    }  # as C3D: nobody saw it


def test_a_long_gap_is_flagged_from_end_to_end(tmp_path: Path) -> None:
    times = 2.0 + np.delete(np.arange(100), np.arange(30, 90)) / FPS
    result = written(tmp_path, times, walk(times))
    for rate, lost in ((60, [30, 89]), (30, [15, 44])):
        assert run("export", result, "--to", "bvh", "--fps", rate) == 0
        assert lost in json.loads((tmp_path / "motion.flags.json").read_text())["lost"]


@pytest.mark.parametrize("kind", ["bvh", "glb"])
def test_another_rate_plays_the_same_motion(tmp_path: Path, kind: str) -> None:
    times = 2.0 + np.arange(60) / FPS
    result = written(tmp_path, times, walk(times))
    assert run("export", result, "--to", kind, "--fps", 24) == 0
    even = 2.0 + np.arange(24) / 24  # the last frame is at 59/60 s, after the last line
    if kind == "glb":
        found, flags = keys(tmp_path / "motion.glb")
        np.testing.assert_allclose(found, even - 2.0, atol=1e-6)
    else:
        bvh: Any = pybvh.read_bvh_file(tmp_path / "motion.bvh", warn_on_world_up_disagreement=False)
        assert bvh.fps == pytest.approx(24.0, rel=1e-6)
        wanted = hips(walk(even))
        places = roots(tmp_path / "motion.bvh")
        np.testing.assert_allclose(places, wanted, atol=2e-3)
        flags = json.loads((tmp_path / "motion.flags.json").read_text())
    # 5 and 6 lie at 83 and 100 ms, 20 at 333: lines 2 (83 ms) and 8 (333 ms) fall on them, 3 (125 ms) has 7 and 8.
    assert flags["lost"] == [[2, 2], [8, 8]] and flags["frames"] == 24


def test_frames_as_they_are_stay_as_they_are(tmp_path: Path) -> None:
    times = 2.0 + np.arange(30) / FPS
    result = read_result(written(tmp_path, times, walk(times)))
    played = playback(result)
    assert played.even().poses is played.poses and not played.known[list(LOST)].any()
    one = read_result(written(tmp_path, times[:1], walk(times[:1])))
    assert len(playback(one).even().poses) == 1 and len(playback(one).even(24.0).poses) == 1


@pytest.mark.parametrize(("arguments", "words"), [
    (("--to", "bvh", "--fps", "0"), "above 0 and at most 1000"),
    (("--to", "glb", "--fps", "nan"), "above 0 and at most 1000"),
    (("--to", "bvh", "--fps", "1e12"), "above 0 and at most 1000"),
    (("--to", "mot", "--fps", "24"), "mot takes none"),
])  # fmt: skip
def test_rates_that_cannot_be(
    tmp_path: Path, arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    times = 2.0 + np.arange(12) / FPS
    result = written(tmp_path, times, walk(times))
    assert words in refusal(capsys, "export", result, *arguments)
