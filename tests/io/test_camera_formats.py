"""Calibrations of other programs: round trips, files by the book, what must be said, and what is refused."""

from __future__ import annotations

import os
import pickle
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.cameras import ring
from support.commands import document, refusal, run
from twistcap import se3
from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError
from twistcap.io.calibration import knows_floor, read_rig, write_rig
from twistcap.io.cameras import FORMATS, Asked, format_of, read_cameras, write_cameras
from twistcap.io.cameras.axes import axis_up, with_z_up
from twistcap.io.number_pickle import read_number_pickle
from twistcap.io.opencv_storage import read_storage

SIZE = (1280, 720)
LENSES = {"vicon": [-0.12, 0.03, 0.0, 0.0, 0.0], "projections": [0.0] * 5}
POINTS = np.random.default_rng(0).uniform(-0.6, 0.6, (30, 3)) + np.array([0.0, 0.0, 1.0])


def rig_with(dist: list[float]) -> Rig:
    cameras = []
    for c, camera in enumerate(ring()):
        K = np.array([[900.0 + c, 0, 640.5], [0, 905.0, 351.25], [0, 0, 1]])
        cameras.append(Camera(f"cam_{c}", K, camera.T_cam_world, SIZE, np.array(dist)))
    return Rig(tuple(cameras))


@pytest.mark.parametrize("name", list(FORMATS))
def test_what_is_written_is_read(name: str, tmp_path: Path) -> None:
    rig = rig_with(LENSES.get(name, [-0.2, 0.08, 0.001, -0.0006, -0.01]))
    files = {"qualisys": "a.qca.txt", "vicon": "a.xcp", "toml": "a.toml", "caliscope": "a.toml"}
    path = tmp_path / files.get(name, "out")
    write_cameras(rig, path, name)
    assert format_of(path).name == name
    read, _ = read_cameras(path, asked=Asked(1.0 if name == "colmap" else None, SIZE), up="z")
    assert read.names == rig.names
    for mine, theirs in zip(rig, read, strict=True):
        assert theirs.size == SIZE
        pixels = mine.project(POINTS)[0]
        np.testing.assert_allclose(theirs.project(POINTS)[0], pixels, atol=0.05 if name == "vicon" else 1e-6)


def test_calibrations_by_the_book_of_opencv(tmp_path: Path) -> None:
    """Written by OpenCV itself, as YAML and as XML."""
    rig = rig_with([-0.2, 0.08, 0.001, -0.0006, -0.01])
    for camera, ending in zip(rig, ("yml", "xml", "yaml", "yml"), strict=False):
        storage = cv2.FileStorage(str(tmp_path / f"{camera.name}.{ending}"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", camera.size[0])
        storage.write("image_height", camera.size[1])
        storage.write("camera_matrix", camera.K)
        storage.write("distortion_coefficients", camera.dist[None])
        storage.write("rvec", cv2.Rodrigues(camera.T_cam_world[:3, :3])[0])
        storage.write("tvec", camera.T_cam_world[:3, 3:])
        storage.release()
    read, _ = read_cameras(tmp_path, up="z")
    for camera in read:
        same = next(c for c in rig if c.name == camera.name)
        np.testing.assert_allclose(camera.project(POINTS)[0], same.project(POINTS)[0], atol=1e-6)


def test_opencv_reads_what_we_write(tmp_path: Path) -> None:
    rig = rig_with([-0.2, 0.08, 0.001, -0.0006, -0.01])
    write_cameras(rig, tmp_path / "easy", "easymocap")
    storage = cv2.FileStorage(str(tmp_path / "easy/intri.yml"), cv2.FILE_STORAGE_READ)
    names = storage.getNode("names")
    assert [names.at(i).string() for i in range(names.size())] == list(rig.names)
    np.testing.assert_array_equal(storage.getNode(f"K_{rig[1].name}").mat(), rig[1].K)


def test_colmap_by_its_manual(tmp_path: Path) -> None:
    """https://colmap.github.io/format.html: pixel centres at halves, a line of points after each image."""
    (tmp_path / "cameras.txt").write_text(
        "# Camera list\n1 SIMPLE_RADIAL 640 480 500 320 240 -0.1\n2 PINHOLE 640 480 510 512 300 250\n"
    )
    T = [look_at((3.0, 0.4, 1.5), (0, 0, 1.0)), look_at((0.3, 3.0, 1.6), (0, 0, 1.0))]
    lines = ["# Image list with two lines of data per image:"]
    for i, place in enumerate(T):
        w = 0.5 * np.sqrt(1 + np.trace(place[:3, :3]))
        x, y, z = se3.vee(place[:3, :3] - place[:3, :3].T) / (4 * w) if w > 1e-6 else (0, 0, 0)
        t = " ".join(str(v) for v in place[:3, 3])
        lines += [f"{i + 1} {w} {x} {y} {z} {t} {i + 1} side/view{i}.jpg", "12.5 3.25 -1 40 2 7" if i == 0 else ""]
    (tmp_path / "images.txt").write_text("\n".join(lines) + "\n")
    rig, _ = read_cameras(tmp_path, asked=Asked(1.0))
    assert rig.names == ("view0", "view1")
    np.testing.assert_allclose(rig[0].K, [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
    np.testing.assert_allclose(rig[0].dist, [-0.1, 0, 0, 0, 0])
    np.testing.assert_allclose([c.T_cam_world for c in rig], T, atol=1e-9)
    with pytest.raises(InputError, match=r"no scale of its own; .* --unit m"):
        read_cameras(tmp_path)


def test_projection_matrices_of_any_scale_and_sign(tmp_path: Path) -> None:
    rig = rig_with([0.0] * 5)
    text = "# 1 2 3\n" + "\n".join(
        f"{c.name}:\n" + "\n".join(" ".join(map(str, row)) for row in -0.37 * c.P) for c in rig
    )
    (tmp_path / "P.txt").write_text(text)
    with pytest.raises(InputError, match="does not say how large the images are"):
        read_cameras(tmp_path / "P.txt")
    read, _ = read_cameras(tmp_path / "P.txt", asked=Asked(size=SIZE), up="z")
    assert read.names == rig.names
    for a, b in zip(rig, read, strict=True):
        np.testing.assert_allclose(b.K, a.K, rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(b.T_cam_world, a.T_cam_world, atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ([], "cam_1.txt: it holds no 3 × 4 matrix; mend it, or move it elsewhere"),
        (["a b c d"], "cam_1.txt: it holds no 3 × 4 matrix; mend it"),
        (["1 2 3"] * 3, "cam_1.txt: the line '1 2 3' is no row of a matrix; it needs 4 numbers"),
        (["nan 2 3 4"] * 3, "cam_1.txt"),
        (["x 2 3 4"] * 3, "cam_1.txt"),
        (["1 0 0 1", "0 1 0 1", "other:", "0 0 1 1"], "cam_1.txt: a matrix ends too early"),
    ],
)
def test_a_damaged_matrix_drops_no_camera(
    rows: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_cameras(rig_with([0.0] * 5), tmp_path / "P", "projections")
    (tmp_path / "P" / "cam_1.txt").write_text("\n".join(rows))
    asked = ("convert", tmp_path / "P", tmp_path / "out.toml", "--size", "1280x720", "--up", "z")
    assert told in refusal(capsys, *asked) and not (tmp_path / "out.toml").exists()


def test_vicon_by_the_book(tmp_path: Path) -> None:
    """World to camera is the quaternion (x, y, z, w); POSITION is the centre, mm, as Pose2Sim reads it."""
    place = look_at((3.0, 1.0, 1.5), (0, 0, 1.0))
    other = look_at((-1.0, 3.0, 1.5), (0, 0, 1.0))
    frames = []
    for name, T in (("v1", place), ("v2", other)):
        turn = se3.log_rotation(T[:3, :3])
        angle = np.linalg.norm(turn)
        q = np.r_[np.sin(angle / 2) * turn / angle, np.cos(angle / 2)]
        at = -1e3 * T[:3, :3].T @ T[:3, 3]
        frames.append(
            f'<Camera DEVICEID="{name}" TYPE="VideoCamera" SENSOR_SIZE="1920 1080" PIXEL_ASPECT_RATIO="1"><KeyFrames>'
            f'<KeyFrame FOCAL_LENGTH="1500" PRINCIPAL_POINT="960 540" ORIENTATION="{" ".join(map(str, q))}"'
            f' POSITION="{" ".join(map(str, at))}" VICON_RADIAL="-1e-8 0"/></KeyFrames></Camera>'
        )
    (tmp_path / "a.xcp").write_text("<Cameras>" + "".join(frames) + '<Camera DEVICEID="ir" TYPE="T40"/></Cameras>')
    rig, _ = read_cameras(tmp_path / "a.xcp")
    np.testing.assert_allclose([c.T_cam_world for c in rig], [place, other], atol=1e-9)
    seen = 600.0
    straight = seen * (1 - 1e-8 * seen**2)
    pixel = rig[0].project(rig[0].centre + place[:3, :3].T @ np.array([straight / 1500, 0, 1.0]))[0]
    assert pixel[0] == pytest.approx(960 + seen, abs=0.05)


def test_the_real_qualisys_file(shared_data: Path) -> None:
    """The rebuilt calibration differs from it by up to 6 cm (its README); cam03 has the same grid."""
    folder = shared_data / "balance_4view"
    rig, notes = read_cameras(folder / "calibration/Calib.qca.txt")
    rebuilt = read_rig(folder / "Calib.toml")
    assert notes == ["Up is z: the images agree."]
    np.testing.assert_allclose(rig[2].K, rebuilt[2].K, atol=1e-3)
    np.testing.assert_allclose(rig[2].dist[:4], rebuilt[2].dist[:4])
    assert max(np.linalg.norm(a.centre - b.centre) for a, b in zip(rig, rebuilt, strict=True)) < 0.07


def test_a_calibration_of_theia_is_said_to_be_one(tmp_path: Path) -> None:
    """By its maker's page it is as Qualisys', without a field of view."""
    write_cameras(rig_with([0.0] * 5), tmp_path / "a.qca.txt", "qualisys")
    text = (tmp_path / "a.qca.txt").read_text()
    (tmp_path / "a.qca.txt").write_text(re.sub(r"<fov_video.*?/>", "", text))
    with pytest.raises(InputError, match="Theia3D's own are not read, but the Qualisys or Vicon file"):
        read_cameras(tmp_path / "a.qca.txt")


def test_the_real_caliscope_file(shared_data: Path) -> None:
    path = shared_data / "charuco_4cam/tests/sessions/post_optimization/camera_array.toml"
    rig, _ = read_cameras(path)
    assert rig.names == ("cam_0", "cam_1", "cam_2", "cam_3") and rig[0].K[0, 0] == 903.550124089999


def in_units(rig: Rig, unit: float) -> Rig:
    """The rig as a file has it whose unit is so many metres."""
    places = [se3.transform(c.T_cam_world[:3, :3], c.T_cam_world[:3, 3] / unit) for c in rig]
    return Rig(tuple(replace(c, T_cam_world=T) for c, T in zip(rig, places, strict=True)))


@pytest.mark.parametrize("name", ["opencv", "easymocap", "caliscope", "projections", "toml"])
@pytest.mark.parametrize(("unit", "told"), [(1.0, "metres"), (1e-3, "millimetres"), (0.06, None), (0.01, None)])
def test_a_unit_that_a_file_does_not_say_is_told(name: str, unit: float, told: str | None, tmp_path: Path) -> None:
    """By the distances of the cameras, 5.7 to 8 m; of squares of a board it is asked for."""
    rig, path = rig_with([0.0] * 5), tmp_path / "out.toml"
    write_cameras(in_units(rig, unit), path, name)
    if name == "toml":
        path.write_text(path.read_text().replace('unit = "m"\n', ""))
    if told is None:
        with pytest.raises(InputError, match=r"out.toml: cameras are .* apart, which fits neither.*: --unit mm, or"):
            read_cameras(path, name, Asked(size=SIZE), up="z")
        read, notes = read_cameras(path, name, Asked(unit, SIZE), up="z")
        assert len(notes) == 1
    else:
        read, notes = read_cameras(path, name, Asked(size=SIZE), up="z")
        assert (
            notes[1]
            == f"The calibration is taken to be in {told}: cameras are 5.66 to 8 m apart. If it is not, give --unit."
        )
    np.testing.assert_allclose([c.centre for c in read], [c.centre for c in rig], atol=1e-6)


def test_caliscope_keeps_the_numbers_of_cameras(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`new` pairs each video with the camera of its number."""
    rig = rig_with([0.0] * 5)
    for names, numbers in (
        (("cam_1", "cam_2", "cam_3", "cam_4"), (1, 2, 3, 4)),
        (("c07", "c03", "c11", "c02"), (7, 3, 11, 2)),
        (("left1", "right1", "front", "back"), (0, 1, 2, 3)),
    ):
        named = Rig(tuple(replace(c, name=name) for c, name in zip(rig, names, strict=True)))
        write_cameras(named, tmp_path / "Calib.toml", "toml")
        told = document(
            capsys, "convert", tmp_path / "Calib.toml", tmp_path / "a.toml", "--to", "caliscope", "--overwrite"
        )
        read, _ = read_cameras(tmp_path / "a.toml")
        by_name = {c.name: c.centre for c in read}
        for camera, number in zip(named, numbers, strict=True):
            np.testing.assert_allclose(by_name[f"cam_{number}"], camera.centre, atol=1e-9)
        mapping = [s for s in told["statements"] if "other names" in s]
        assert len(mapping) == (names[0] != "cam_1")
        assert all(f"{names[0]} = cam_{numbers[0]}, {names[1]} = cam_{numbers[1]}" in s for s in mapping)


@pytest.mark.parametrize("given", ["", "intrinsics.yml", "extrinsics.yml"])
def test_the_pair_of_opencvs_stereo_calibration(given: str, tmp_path: Path) -> None:
    """As samples/cpp/stereo_calib.cpp writes it, in squares of a board of 60 mm."""
    left, right = rig_with([-0.2, 0.08, 0.001, -0.0006, 0.0]).cameras[:2]
    between = right.T_cam_world @ se3.inverse(left.T_cam_world)
    rows = {
        "intrinsics.yml": {"M1": left.K, "D1": left.dist[None], "M2": right.K, "D2": right.dist[None]},
        "extrinsics.yml": {"R": between[:3, :3], "T": between[:3, 3:] / 0.06, "R1": np.eye(3), "R2": np.eye(3)}
        | {"P1": np.eye(3, 4), "P2": np.eye(3, 4), "Q": np.eye(4)},
    }
    for name, entries in rows.items():
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for key, value in entries.items():
            storage.write(key, value)
        storage.release()
    with pytest.raises(InputError, match="say it: --unit"):
        read_cameras(tmp_path / given, asked=Asked(size=SIZE), up="-y")
    read, _ = read_cameras(tmp_path / given, asked=Asked(0.06, SIZE), up="-y")
    assert read.names == ("1", "2")
    for a, b in zip(read, (left, right), strict=True):
        np.testing.assert_allclose(a.K, b.K)
        np.testing.assert_allclose(a.dist, b.dist)
    found = read[1].T_cam_world @ se3.inverse(read[0].T_cam_world)
    np.testing.assert_allclose(found, between, atol=1e-9)
    (tmp_path / "extrinsics.yml").unlink()
    with pytest.raises(InputError, match=r"half of OpenCV's stereo calibration; put intrinsics.yml .* one folder"):
        read_cameras(tmp_path / "intrinsics.yml", asked=Asked(0.06, SIZE), up="-y")


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "-z"])
def test_a_world_that_is_not_z_up_must_be_said(up: str, tmp_path: Path) -> None:
    rig = rig_with([0.0] * 5)
    axis = (-1.0 if up.startswith("-") else 1.0) * np.eye(3)["xyz".index(up[-1])]
    turn = np.stack([np.roll(np.abs(axis), 1), np.cross(axis, np.roll(np.abs(axis), 1)), axis])
    other = Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ se3.transform(turn, np.zeros(3))) for c in rig))
    assert axis_up(other) == up
    write_cameras(other, tmp_path / "a.toml", "caliscope")
    with pytest.raises(InputError, match=f"up is {up} by the images, not z; say it: --up {up}"):
        read_cameras(tmp_path / "a.toml")
    read, _ = read_cameras(tmp_path / "a.toml", up=up)  # pyright: ignore
    assert axis_up(read) == "z"
    before, after = ([np.linalg.norm(c.centre - r[0].centre) for c in r] for r in (other, read))
    np.testing.assert_allclose(before, after, atol=1e-9)
    assert np.linalg.det(with_z_up(other, up)[0].T_cam_world[:3, :3]) == pytest.approx(1.0)  # pyright: ignore


class _Evil:
    def __reduce__(self) -> object:
        return os.system, ("touch /tmp/twistcap-was-here",)


@pytest.mark.parametrize("content", [{"a": _Evil()}, [1], {"a": np.array([{}], object)}, {"a": Path("b")}])
def test_a_pickle_builds_nothing_but_numbers(content: object, tmp_path: Path) -> None:
    (tmp_path / "a.pickle").write_bytes(pickle.dumps(content))
    with pytest.raises(InputError, match="pickle"):
        read_number_pickle(tmp_path / "a.pickle")
    assert not Path("/tmp/twistcap-was-here").exists()


@pytest.mark.parametrize(
    ("name", "file", "before", "after", "told"),
    [
        ("vicon", "", r'POSITION="[^"]*"', 'POSITION="1 2"', "camera 'cam_0', POSITION: it must hold 3 numbers"),
        (
            "easymocap",
            "intri.yml",
            "W_cam_0: 1280",
            "W_cam_0: a",
            "camera 'cam_0', W_cam_0 and H_cam_0: 'a' is no number",
        ),
        (
            "colmap",
            "cameras.txt",
            r"FULL_OPENCV 1280",
            "FULL_OPENCV a",
            "camera '1', WIDTH and HEIGHT: 'a' is no number",
        ),
        ("colmap", "cameras.txt", r" 0\.0\n", "\n", "camera '1', PARAMS: it must hold 12 numbers, and has 11"),
        ("colmap", "images.txt", r"\n1 \S+", "\n1 a", "image 'cam_0', QW to TZ: 'a' is no number"),
    ],
)
def test_a_bad_number_is_told_with_its_field(
    name: str, file: str, before: str, after: str, told: str, tmp_path: Path
) -> None:
    path = tmp_path / ("a.xcp" if name == "vicon" else "a")
    write_cameras(rig_with([0.0] * 5), path, name)
    damaged = path / file if file else path
    damaged.write_text(re.sub(before, after, damaged.read_text(), count=1))
    with pytest.raises(InputError, match=re.escape(told)):
        read_cameras(path, name, Asked(1.0, SIZE), up="z")


def test_storages_refuse_what_grows(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text('<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage>&b;</opencv_storage>')
    with pytest.raises(InputError, match="document type"):
        read_storage(tmp_path / "a.xml")
    (tmp_path / "a.yml").write_text("K: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 2. ]\n")
    with pytest.raises(InputError, match=r"'K': it must hold 3 × 3 numbers"):
        read_storage(tmp_path / "a.yml")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ((), "floor = false is written"),
        (("--unit", "0.9"), "floor = false is written"),
        (("--up", "-y"), "floor = false is written"),
        (("--to", "easymocap"), "easymocap cannot say that, so set [cameras] floor = false in the session"),
    ],
)
def test_a_floor_that_is_not_known_stays_so(
    options: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for known in (True, False):
        write_rig(rig_with([0.0] * 5), tmp_path / "in.toml", floor=known)
        out = tmp_path / ("out" if "--to" in options else "out.toml")
        said = document(capsys, "convert", tmp_path / "in.toml", out, "--overwrite", *options)["statements"]
        assert (f"The calibration does not know the floor: {told}." in said) is not known
        assert "--to" in options or knows_floor(out) is known


@pytest.mark.parametrize(
    ("to", "told"),
    [
        ("toml", "floor = false is written"),
        ("easymocap", "easymocap cannot say that, so set [cameras] floor = false in the session"),
    ],
)
def test_the_floor_of_opencap_is_not_known(
    to: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_cameras(rig_with([0.0] * 5), tmp_path / "Videos", "opencap")
    out = tmp_path / f"out{FORMATS[to].ending}"
    said = document(capsys, "convert", tmp_path / "Videos", out, "--to", to)["statements"]
    why = "OpenCap's world begins at its checkerboard, so the height of the floor is not known"
    assert f"{why}: {told}." in said and (to != "toml" or not knows_floor(out))


@pytest.mark.parametrize("name", list(FORMATS))
def test_files_that_are_there_are_kept(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_cameras(rig_with(LENSES.get(name, [-0.2, 0.08, 0.0, 0.0, 0.0])), tmp_path / "in.toml", "toml")
    asked = ("convert", tmp_path / "in.toml", tmp_path / f"out{FORMATS[name].ending}", "--to", name, "--up", "z")
    assert run(*asked) == 0
    files = [file for file in asked[2].rglob("*") if file.is_file()] or [asked[2]]
    for file in files[1:]:
        file.unlink()
    files[0].write_text("mine")
    told = refusal(capsys, *asked)
    assert f"{files[0]} exists; choose another place, or replace it with --overwrite." in told
    assert files[0].read_text() == "mine" and not any(file.exists() for file in files[1:])
    assert run(*asked, "--overwrite") == 0 and files[0].stat().st_size > 10 and all(file.exists() for file in files)


def test_the_command_converts_and_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = rig_with([-0.2, 0.08, 0.0, 0.0, 0.0])
    write_cameras(rig, tmp_path / "a.qca.txt", "qualisys")
    output = document(capsys, "convert", tmp_path / "a.qca.txt", tmp_path / "Calib.toml", "--up", "z")
    assert output["up"].startswith("Up is z, as said") and read_rig(tmp_path / "Calib.toml").names == rig.names
    assert "does not exist" in refusal(capsys, "convert", tmp_path / "none.toml", tmp_path / "b.toml")
    assert "WIDTHxHEIGHT" in refusal(capsys, "convert", tmp_path / "a.qca.txt", tmp_path / "b", "--size", "big")
    assert "distortion, which a 3 × 4" in refusal(
        capsys, "convert", tmp_path / "a.qca.txt", tmp_path / "b" / "c", "--to", "projections", "--up", "z"
    )
    assert not (tmp_path / "b").exists()
    strange = Rig((replace(rig[0], name="../x"), *rig.cameras[1:]))
    write_cameras(strange, tmp_path / "a.qca.txt", "qualisys")
    told = refusal(capsys, "convert", tmp_path / "a.qca.txt", tmp_path / "b" / "c", "--to", "opencv", "--up", "z")
    assert "camera '../x': its name can be no file's" in told and not (tmp_path / "b").exists()
