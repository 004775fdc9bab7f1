"""Motion into a rigged GLB: only into the file that was tracked, in its own unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.rigs import rigged_glb
from twistcap import se3
from twistcap.body import Pose, Posed, rescaled
from twistcap.body.gltf import load_glb, load_rigged
from twistcap.body.gltf_animate import bone_motion
from twistcap.errors import InputError

MOVED = [3.0, 0.5, 1.0]  # m
LEGS = ("femur_r", "femur_l", "tibia_r", "tibia_l")


def pose_of(dof: int) -> Pose:
    return Pose(se3.transform(np.eye(3), np.array([0.4, -0.2, 0.9])), np.full(dof - 6, 0.1))


@pytest.mark.parametrize("top", [{}, {"translation": MOVED}, {"scale": [100.0] * 3}])
@pytest.mark.parametrize("factors", [{}, {"stature": 0.7}, {"lengths": dict.fromkeys(LEGS, 1.2)}])
def test_a_file_takes_the_motion_that_was_tracked_with_it(
    tmp_path: Path, top: dict[str, list[float]], factors: dict[str, Any]
) -> None:
    path = rigged_glb(tmp_path / "anna.glb", **top)
    scale = 0.01 if "scale" in top else 1.0
    path.with_suffix(".rig.toml").write_text(f"scale = {scale}")
    body = rescaled(load_glb(path), **factors)
    pose = pose_of(body.dof)
    motion = bone_motion(body, [pose], path)
    marks = Posed(body, pose).landmarks
    hips = marks[body.landmarks.index("mid_hip")]
    away = np.linalg.norm(scale * motion.places[0] - hips[[1, 2, 0]])
    assert away == pytest.approx(np.linalg.norm(motion.rest.frames[motion.rest.root, :3, 3]), abs=1e-6)


def test_another_version_of_the_file_is_refused(tmp_path: Path) -> None:
    """By a rig file whose origin has a place of its own, a mesh that stands elsewhere has joints elsewhere."""
    body = load_glb(rigged_glb(tmp_path / "anna.glb"))
    spec = load_rigged(tmp_path / "anna.glb").spec
    moved = rigged_glb(tmp_path / "moved.glb", translation=MOVED)
    with pytest.raises(
        InputError, match=r"moved\.glb: its joints are not those of the tracked body; give the file that"
    ):
        bone_motion(body, [pose_of(body.dof)], moved, spec)
    assert len(bone_motion(body, [pose_of(body.dof)], moved).places) == 1  # by its own rig, they are the same
