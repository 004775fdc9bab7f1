"""The viewer shows cameras as they stood in a frame, and each picture at the camera that took it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.pages_shared import FRAMES, studio_walk
from twistcap import se3
from twistcap.camera.bump import bumped
from twistcap.io.result import read_result
from twistcap.io.video import open_source
from twistcap.pages.viewer import _as_it_stood, _pictures  # pyright: ignore[reportPrivateUsage]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return studio_walk(tmp_path_factory.mktemp("studio") / "walk")


def test_outlines_are_of_cameras_as_they_stood(made: Path) -> None:
    """Those of another result as well, which may have fewer cameras, in another order."""
    result, turn = read_result(made / "one" / "result.h5"), np.deg2rad([0.0, 5.0, 0.0])
    rig, bumps = result.rig, np.zeros((FRAMES, 3, 3))
    bumps[:, 2] = turn
    three = replace(result, bumps=bumps)
    swapped = replace(result, rig=replace(rig, cameras=(rig[2], rig[0])), bumps=bumps[:, [2, 0]])
    assert np.allclose(_as_it_stood(rig[2], three, 1).project(result.landmarks[1])[0],
                       bumped(rig[2], turn).project(result.landmarks[1])[0])  # fmt: skip
    for camera, degrees in zip(rig, (0.0, 0.0, 5.0), strict=True):  # the second is not known there
        stood = _as_it_stood(camera, swapped, 1).T_cam_world[:3, :3] @ camera.T_cam_world[:3, :3].T
        assert np.rad2deg(np.linalg.norm(se3.log_rotation(stood))) == pytest.approx(degrees, abs=1e-6)


def test_pictures_are_shown_at_the_cameras_that_took_them(made: Path) -> None:
    """Where two were swapped; a camera whose video is not there has no pictures, nor has the other one then."""
    result = read_result(made / "one" / "result.h5")
    given = np.tile(np.arange(3, dtype=np.int32), (FRAMES, 1))
    given[1] = (1, 0, 2)
    swapped, names = replace(result, sources=given), result.rig.names
    sources = {name: open_source(path) for name, path in result.config["videos"].items()}
    plain, sorted_ = (_pictures(r, sources, np.arange(FRAMES, dtype=np.int32), 64) for r in (result, swapped))
    assert [a == b for a, b in zip(plain[names[0]], sorted_[names[0]], strict=True)] == [k != 1 for k in range(FRAMES)]
    assert sorted_[names[0]][1] == plain[names[1]][1] and sorted_[names[1]][1] == plain[names[0]][1]
    assert sorted_[names[2]] == plain[names[2]]
    alone = _pictures(swapped, {names[0]: sources[names[0]]}, np.arange(FRAMES, dtype=np.int32), 64)
    assert alone[names[0]][1] is None and alone[names[1]] == [] and alone[names[0]][0] == plain[names[0]][0]
