"""Calibration files: round trip, and one clear sentence for each thing that cannot be true."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.cameras import ring
from twistcap import se3
from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig, write_rig
from twistcap.io.cameras import read_cameras, write_cameras
from twistcap.io.plausible import check_plausible, check_upright

PERSON = np.array([[0, 0, 0.02], [0, 0, 0.9], [0, 0.2, 1.4], [0, 0, 1.75]])


@pytest.fixture
def calib(tmp_path: Path) -> Path:
    path = tmp_path / "Calib.toml"
    write_rig(ring(), path)
    return path


def edit(path: Path, pattern: str, new: str, count: int = 1) -> Path:
    text, changed = re.subn(pattern, new, path.read_text(), count=count, flags=re.M)
    assert changed, pattern
    path.write_text(text)
    return path


def test_round_trip(calib: Path) -> None:
    for read, made in zip(read_rig(calib), ring(), strict=True):
        assert read.name == made.name and read.size == made.size
        np.testing.assert_allclose(read.K, made.K)
        np.testing.assert_allclose(read.dist, made.dist)
        np.testing.assert_allclose(read.T_cam_world, made.T_cam_world, atol=1e-12)


def test_millimetres_and_rotation_matrix(calib: Path) -> None:
    camera = ring()[0]
    edit(calib, r"^rotation = .*", f"rotation = {camera.T_cam_world[:3, :3].tolist()}")
    metres = read_rig(calib)
    np.testing.assert_allclose(metres[0].T_cam_world, camera.T_cam_world, atol=1e-9)
    for made in ring():
        t = made.T_cam_world[:3, 3]
        edit(calib, re.escape(f"translation = {t.tolist()}"), f"translation = {(1000 * t).tolist()}")
    np.testing.assert_allclose(read_rig(calib, "mm")[1].centre, metres[1].centre, atol=1e-9)
    with pytest.raises(InputError, match=r"cam0.*cam1.* m apart.*millimetres.*unit = \"mm\", or say --unit mm"):
        read_rig(calib)


@pytest.mark.parametrize("name", ["a.toml", "a.xcp", "a.yml", "a.qca.txt", "P.txt", "easy"])
def test_calibrations_of_other_programs_are_to_be_converted(name: str, tmp_path: Path) -> None:
    """A camera_array.toml of caliscope among them, and folders."""
    path = tmp_path / name
    write_cameras(ring(), path, {"easy": "easymocap"}.get(name, "caliscope"))
    with pytest.raises(InputError, match=rf"{name} is of another program; make a Calib.toml of it:  twistcap convert"):
        read_rig(path)


def test_a_folder_that_holds_a_calibration_is_no_other_program(calib: Path) -> None:
    folder = calib.parent
    with pytest.raises(InputError, match=rf"^calibration {re.escape(str(folder))} is a folder; name .*/Calib\.toml\.$"):
        read_rig(folder)
    with pytest.raises(InputError, match=r"is a folder; name .*/Calib\.toml\.$"):
        read_cameras(folder)


def test_real_file_agrees_with_opencv(shared_data: Path) -> None:
    rig = read_rig(shared_data / "balance_4view" / "Calib.toml")
    assert rig.names == ("cam01", "cam02", "cam03", "cam04")
    rvec = np.array([1.6941898740645656, 1.0541664745946182, -0.42509822826569554])
    tvec = np.array([0.3376563381480771, 0.9543065767348416, 2.9233559704789145])
    dist = np.array([-0.046183, 0.139983, 0.000608, 0.00069])
    expected = cv2.projectPoints(PERSON, rvec, tvec, rig[0].K, dist)[0][:, 0]
    np.testing.assert_allclose(rig[0].project(PERSON)[0], expected, atol=1e-6)
    check_plausible(rig, PERSON)


@pytest.mark.parametrize(
    ("pattern", "new", "message"),
    [
        (r"^matrix = .*\n", "", "camera 'cam0': the field 'matrix' is missing"),
        (r"^matrix = \[\[500.0", "matrix = [[nan", r"cam0.matrix.0.0' is nan; write a finite number"),
        (r"^translation = \[", "translation = [inf, 0, 0] #", r"cam0.translation.0' is inf; write a finite number"),
        (r"^matrix = \[\[500.0", "matrix = [[-500.0", "focal lengths"),
        (r"^size = .*", "size = [384]", "'size' must hold 2 numbers"),
        (r"^size = .*", "size = ['a', 'b']", "'size' must hold 2 numbers"),
        (r"^fisheye = false", "fisheye = 1", "'fisheye' must be true or false"),
        (r"^rotation = .*", "rotation = [[1,0,0],[0,1,0],[0,0,-1]]", "mirrored"),
        (r"^rotation = .*", "rotation = [[1,0,0],[0,2,0],[0,0,1]]", "no rotation"),
        (r"^\[\"cam0\"\]", "[cam0", "not valid TOML"),
        (r'^name = "cam0"', 'name = "cam1"', "two cameras are named 'cam1'"),
        (r'^unit = "m"', 'unit = "inch"', "unit 'inch' is unknown"),
        (r"^distortions = .*", "distortions = [0, 0, 0, 0, 0, 1, 1, 1]", "at most five"),
    ],
)
def test_bad_entries_are_refused(calib: Path, pattern: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_rig(edit(calib, pattern, new))
    assert str(calib) in str(caught.value) and str(caught.value).count("\n") == 0


def test_missing_and_empty_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_rig(tmp_path / "none.toml")
    for name in ("Calib.qca.txt", "a.xcp", "intri.yml", "cam 1.pickle"):
        with pytest.raises(
            InputError, match=r"of another program; make a Calib.toml of it:  twistcap convert .*Calib.toml"
        ):
            read_rig(tmp_path / name)
    (tmp_path / "cam01.mp4").write_bytes(b"\x00\xff\xfe")
    with pytest.raises(InputError, match=r"cam01\.mp4 is not a text .*; if it is no calibration, check"):
        read_rig(tmp_path / "cam01.mp4")
    (tmp_path / "empty.toml").write_text("[metadata]\nerror = 1\n")
    with pytest.raises(InputError, match="holds no camera"):
        read_rig(tmp_path / "empty.toml")


def moved(rig: Rig, motion: np.ndarray) -> Rig:
    return Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ se3.inverse(motion)) for c in rig))


def test_plausible_rigs_pass() -> None:
    for count in (1, 2, 3, 8):
        check_plausible(ring(count), PERSON)


def test_cameras_inside_each_other() -> None:
    a, b, c, d = ring()
    with pytest.raises(InputError, match="'cam0' and 'cam1' stand inside each other"):
        check_plausible(Rig((a, replace(b, T_cam_world=a.T_cam_world), c, d)))


def test_cameras_that_look_away() -> None:
    K = ring()[0].K
    eyes = [np.array([0.5, 0, 1.4]), np.array([-0.5, 0, 1.4])]
    away = Rig(tuple(Camera(f"c{i}", K, look_at(e, 3 * e), (384, 280)) for i, e in enumerate(eyes)))
    with pytest.raises(InputError, match="look away from each other"):
        check_plausible(away)


def test_inverted_extrinsics_are_found() -> None:
    """Camera-to-world written where world-to-camera belongs."""
    wrong = Rig(tuple(replace(c, T_cam_world=se3.inverse(c.T_cam_world)) for c in ring()))
    with pytest.raises(InputError):
        check_plausible(wrong, PERSON)


def test_underground_and_upside_down() -> None:
    flip = se3.transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))  # a board whose z axis points down
    with pytest.raises(InputError, match="every camera stands underground"):
        check_plausible(moved(ring(), flip))
    with pytest.raises(InputError, match=r"person of the first pose is underground .*-0\.59 m"):
        check_plausible(ring(), PERSON - [0, 0, 0.61])
    check_plausible(ring(), PERSON - [0, 0, 0.61], floor=-0.6)
    with pytest.raises(InputError, match="no camera sees the person"):
        check_plausible(ring(), PERSON + np.array([0, 0, 50]))
    with pytest.raises(InputError, match="NaN"):
        check_plausible(ring(), PERSON * np.nan)
    with pytest.raises(InputError, match="stands on the head"):
        check_upright({"nose": [0, 0, 0.1], "ankle_r": [0, 0, 1.6]})
    check_upright({"nose": [0, 0, 1.6], "ankle_r": [0, 0, 0.1]})
