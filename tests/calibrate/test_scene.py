"""Cameras by measured points of the scene."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from support.boards import BIG, SIZE, ring_rig, seen_by
from support.commands import refusal
from twistcap import se3
from twistcap.calibrate.advice import sentences
from twistcap.calibrate.calibrate import Options
from twistcap.calibrate.scene import calibrated_by_scene, read_scene
from twistcap.calibrate.sightings import LONE, Sighting
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.report.calibration import write_calibration_page


def written(path: Path, seed: int = 0) -> tuple[Path, Rig, list[Sighting]]:
    """A file of 16 points that were measured to 2 mm and clicked to 0.4 px, the cameras, and their lone pictures."""
    rng = np.random.default_rng(seed)
    rig, points = ring_rig(3, rng), rng.uniform([-1, -1, 0], [1, 1, 1.8], (16, 3))
    table, seen = dict[str, object](), list[Sighting]()
    for k, point in enumerate(points):
        pixels = {c.name: (c.project(point)[0] + 0.4 * rng.normal(size=2)).tolist() for c in rig}
        if k == 3:
            pixels["cam0"] = None
        table[f"p{k}"] = {"world_m": (point + 0.002 * rng.normal(size=3)).tolist(), "pixels": pixels}
    for c, camera in enumerate(rig):
        for m in range(14):
            turn = se3.exp_rotation(0.5 * rng.normal(size=3))
            before = se3.transform(turn, rng.uniform([-0.9, -0.6, 1.2], [-0.2, -0.1, 1.8]))
            ids, pixels = seen_by(camera, se3.inverse(camera.T_cam_world) @ before, BIG)
            if len(ids):
                noisy = pixels + 0.15 * rng.normal(size=pixels.shape)
                seen.append(Sighting(c, LONE * (c + 1) + m, ids, noisy, 2.0))
    path.write_text(json.dumps(table))
    return path, rig, seen


def test_measured_points_give_the_places_of_the_cameras(tmp_path: Path) -> None:
    path, rig, seen = written(tmp_path / "points.json")
    scene = read_scene(path)
    sizes = dict.fromkeys(range(3), SIZE)
    found = calibrated_by_scene(scene, seen, BIG, rig.names, sizes, Options(kinds=("brown",)))
    for c, (a, b) in enumerate(zip(found.rig, rig, strict=True)):
        assert a.K[0, 0] == pytest.approx(b.K[0, 0], rel=5e-3)
        assert np.linalg.norm(a.centre - b.centre) < 0.012
        off = se3.log(b.T_cam_world @ se3.inverse(a.T_cam_world))
        assert off @ np.linalg.solve(found.adjustment.places[c], off) < 25
    assert found.floor_known


def test_a_wrong_point_is_named(tmp_path: Path) -> None:
    path, rig, seen = written(tmp_path / "points.json")
    table = json.loads(path.read_text())
    table["p5"]["pixels"]["cam1"][0] += 60.0
    path.write_text(json.dumps(table))
    sizes = dict.fromkeys(range(3), SIZE)
    found = calibrated_by_scene(read_scene(path), seen, BIG, rig.names, sizes, Options(kinds=("brown",)))
    told = sentences(found)
    assert [s for s in told if "do not fit" in s] == [
        "Camera cam1: measured points that do not fit: p5; look at their places and pixels."
    ]
    assert all("measured points 0." in line for line in told[:3])
    page = write_calibration_page(found, tmp_path).read_text(encoding="utf-8")
    assert "3 cameras by 16 measured points of the scene, lenses by" in page


def test_points_that_do_not_do_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, rig, seen = written(tmp_path / "points.json")
    scene, sizes = read_scene(path), dict.fromkeys(range(4), SIZE)
    told = "camera else sees 0 measured points; .*; if it is one of cam0, cam1, cam2, write CAMERA=PATH"
    with pytest.raises(InputError, match=told):
        calibrated_by_scene(scene, seen, BIG, (*rig.names[:2], "else"), sizes, Options(kinds=("brown",)))
    table = json.loads(path.read_text())
    table["p1"]["world_m"] = [1, 2]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match="'p1': 'world_m' must hold 3 numbers"):
        read_scene(path)
    del table["p2"]["pixels"]
    path.write_text(json.dumps({"p2": table["p2"]}))
    assert "it needs 'world_m'" in refusal(
        capsys, "calibrate", tmp_path, "--board", "chessboard:8x5:60", "--points", path
    )
    floor = ("--points", path, "--floor", "0")
    told = refusal(capsys, "calibrate", tmp_path, "--board", "chessboard:8x5:60", *floor)
    assert "--floor is for videos of the board" in told
    assert "one of the two" in refusal(capsys, "calibrate", tmp_path, "--board", "chessboard:8x5:60")
