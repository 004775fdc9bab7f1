"""The ONNX detector, end to end with small models that find coloured dots."""

from __future__ import annotations

import hashlib
import threading
import zipfile
from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.cameras import ring
from support.commands import document, refusal
from support.networks import NAMES, constant_model, dotted, one_stage_model, simcc_model
from twistcap.adjust.first_pose import fit_keypoints
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.commands.init import clicking_of
from twistcap.errors import InputError
from twistcap.io.calibration import write_rig
from twistcap.io.model_file import cache_folder, model_bytes
from twistcap.io.onnx_detector import OnnxDetector, detected_by_model, load_detector, load_network
from twistcap.io.recording import open_recording
from twistcap.io.session import load_session

pytest.importorskip("onnx", reason="needs onnx, to make a model")
pytest.importorskip("onnxruntime", reason="needs the extra detect")

RIG = ring()
SIZE = RIG[0].size
GREY = np.zeros((64, 64, 3), np.uint8)
HIPS = tuple(f"{joint}_{side}" for joint in ("hip", "knee", "shoulder") for side in "rl")


@pytest.fixture(scope="module")
def person() -> Posed:
    body, root = humanoid("full"), np.eye(4)
    root[2, 3] = 0.93
    return Posed(body, Pose(root, np.array([0.4 if n.startswith("elbow") else 0.0 for n in body.coordinate_names])))


def off(found: Posed, person: Posed) -> float:
    """Median error of hips, knees and shoulders, m."""
    rows = [person.body.landmarks.names.index(name) for name in HIPS]
    return float(np.median(np.linalg.norm(found.landmarks[rows] - person.landmarks[rows], axis=1)))


# ---- networks ----


def test_a_simcc_model_gives_the_first_pose(tmp_path: Path, person: Posed) -> None:
    images = [dotted(camera, person) for camera in RIG]
    found = detected_by_model(load_detector(str(simcc_model(tmp_path / "pose.onnx", SIZE))), images, RIG)
    assert found.names == NAMES and (found.confidence > 0).sum() > 0.6 * found.confidence.size
    fit = fit_keypoints(person.body, RIG, found)
    assert off(Posed(fit.body, fit.pose), person) < 0.04


def test_a_finder_of_people_lets_rtmpose_see_several(tmp_path: Path, person: Posed) -> None:
    """Two people side by side, in an input of half the size with two bins for each pixel."""
    one = dotted(RIG[0], person)
    image = np.concatenate([one, one], axis=1)
    size, zoom = (320, 320), 320 / image.shape[1]
    boxes = [[[*(zoom * np.array([x + 100, 20, x + 290, 270])), s] for x, s in ((0, 0.9), (384, 0.8), (150, 0.9))]]
    finder = constant_model(tmp_path / "yolox.onnx", size, boxes, [[0, 0, 7]])  # the third is no person
    pose = simcc_model(tmp_path / "pose.onnx", (192, 256), split=2)
    found = load_detector(str(pose), str(finder)).people(image)
    assert found.shape == (2, 17, 3)
    true = RIG[0].project(person.landmarks)[0]
    seen = (found[0, :, 2] > 0) & (found[1, :, 2] > 0)
    assert seen.sum() > 8
    np.testing.assert_allclose(found[1, seen, 0] - found[0, seen, 0], 384.0, atol=4.0)
    marks = dict(zip(person.body.landmarks.names, true, strict=True))
    expected = np.stack([marks[name] for name in NAMES])
    assert np.median(np.abs(found[0, seen, :2] - expected[seen])) < 3.0


def test_a_one_stage_model_gives_everybody_in_the_image_s_pixels(tmp_path: Path) -> None:
    people = np.full((3, 17, 3), 0.8)
    people[..., 0], people[..., 1] = 10.0, 20.0
    people[1, :, 0] = 30.0
    detector = load_detector(str(one_stage_model(tmp_path / "rtmo.onnx", (64, 64), people)))
    found = detector.people(np.zeros((128, 128, 3), np.uint8))
    assert found.shape == (2, 17, 3)  # the third has a low score
    np.testing.assert_allclose(found[:, 0, :2], [[20, 40], [60, 40]], atol=1e-4)


def test_nobody_is_told(tmp_path: Path) -> None:
    detector = load_detector(str(simcc_model(tmp_path / "pose.onnx", (48, 64))))
    with pytest.raises(InputError, match=r"pose\.onnx finds nobody in cam0, cam1, cam2, cam3.*another frame"):
        detected_by_model(detector, [GREY, None, GREY, GREY], RIG)


# ---- files that are no such networks ----


def test_a_stranger_s_file_is_told_in_a_sentence(tmp_path: Path) -> None:
    path, boxes, small = tmp_path / "m.onnx", np.full((1, 2, 5), 0.5), (64, 64)
    for outputs, size, words in (
        ((boxes, np.ones((1, 2, 5, 3))), small, "gives 5 keypoints; layouts of 17, 26, 133"),
        ((boxes,), small, "has one output"),
        ((boxes, np.ones((1, 3, 17, 3))), small, "gives arrays of"),
        ((np.ones((1, 17, 64)), np.ones((1, 17, 32))), small, "gives arrays of"),
        ((np.ones((1, 17, 64)), np.full((1, 17, 64), np.nan)), small, "not finite"),
        ((boxes, boxes), ("w", "h"), "fixed size"),
        ((boxes, boxes), (4, 4), "fixed size"),
    ):
        constant_model(path, size, *outputs)
        with pytest.raises(InputError, match=words) as told:
            load_detector(str(path))
        assert str(path) in str(told.value) and "\n" not in str(told.value)
    constant_model(path, small, boxes, np.ones((1, 2, 17, 3)), kind=10)  # wants half floats
    with pytest.raises(InputError, match="fails on an image"):
        load_network(str(path))
    (tmp_path / "bad.onnx").write_bytes(b"none")
    with pytest.raises(InputError, match=r"bad\.onnx is no ONNX file"):
        load_detector(str(tmp_path / "bad.onnx"))
    (tmp_path / "ort.onnx").write_bytes(b"\x10\x00\x00\x00ORTM" + bytes(200))  # ONNX Runtime's own format
    with pytest.raises(InputError, match="no ONNX file"):
        load_detector(str(tmp_path / "ort.onnx"))
    with pytest.raises(InputError, match=r"none\.onnx does not exist; check the path"):
        load_detector(str(tmp_path / "none.onnx"))


def test_networks_in_the_wrong_place_are_told(tmp_path: Path) -> None:
    finder = str(constant_model(tmp_path / "yolox.onnx", (64, 64), np.full((1, 2, 5), 0.5), [[0, 0]]))
    all_at_once = str(one_stage_model(tmp_path / "rtmo.onnx", (64, 64), np.full((2, 17, 3), 0.8)))
    assert isinstance(load_detector(all_at_once), OnnxDetector)
    with pytest.raises(InputError, match="finds people, but no joints"):
        load_detector(finder)
    with pytest.raises(InputError, match="people is for RTMPose"):
        load_detector(all_at_once, finder)


# ---- where the file is ----


@contextmanager
def served(folder: Path) -> Generator[str]:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


def test_a_model_is_fetched_once_and_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "web").mkdir()
    path = one_stage_model(tmp_path / "net.onnx", (64, 64), np.full((2, 17, 3), 0.8))
    with zipfile.ZipFile(tmp_path / "web" / "net.zip", "w") as archive:
        archive.write(path, "sdk/end2end.onnx")
        archive.writestr("sdk/detail.json", "{}")
    checksum = hashlib.sha256((tmp_path / "web" / "net.zip").read_bytes()).hexdigest()
    with served(tmp_path / "web") as address:
        named = f"{address}/net.zip#sha256={checksum}"
        with pytest.raises(InputError, match=f"without its checksum.*{named}"):  # the sentence says what to write
            model_bytes(f"{address}/net.zip")
        with pytest.raises(InputError, match="checksum"):
            model_bytes(f"{address}/net.zip#sha256={'0' * 64}")
        with pytest.raises(InputError, match=r"other\.zip cannot be fetched"):
            model_bytes(f"{address}/other.zip#sha256={checksum}")
        assert not cache_folder().exists()
        assert model_bytes(named) == path.read_bytes()
    assert model_bytes(named) == path.read_bytes()  # the server is gone
    (kept,) = cache_folder().iterdir()
    kept.write_bytes(b"damaged")
    with pytest.raises(InputError, match=r"cannot be fetched.*give its path"):
        model_bytes(named)


def test_a_path_may_have_a_checksum_too(tmp_path: Path) -> None:
    path = one_stage_model(tmp_path / "net.onnx", (64, 64), np.full((2, 17, 3), 0.8))
    checksum = hashlib.sha256(path.read_bytes()).hexdigest()
    assert model_bytes(f"{path}#sha256={checksum.upper()}") == path.read_bytes()
    for name, words in (
        (f"{path}#sha256={'0' * 64}", f"has the checksum {checksum}"),
        (f"{path}#md5=00", "after # stands sha256="),
        (f"{tmp_path / 'a.zip'}", "cannot be unpacked"),
        (f"{tmp_path / 'empty.zip'}", "holds 0 ONNX files"),
    ):
        (tmp_path / "a.zip").write_bytes(b"PK")
        zipfile.ZipFile(tmp_path / "empty.zip", "w").close()
        with pytest.raises(InputError, match=words):
            model_bytes(name)


@pytest.mark.parametrize("change", ["lzma", "name"])
def test_a_damaged_zip_is_told(tmp_path: Path, change: str) -> None:
    path = tmp_path / "net.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("nät.onnx", bytes(range(256)) * 40)
    data = bytearray(path.read_bytes())
    if change == "lzma":
        start = 30 + len("nät.onnx".encode()) + 4 + 5  # behind the header, the name, LZMA's version and properties
        data[start : start + 60] = b"\xff" * 60
    else:
        at = data.rindex("ä".encode())
        data[at : at + 2] = b"\xff\xff"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"net\.zip cannot be unpacked"):
        model_bytes(str(path))


# ---- in a session ----


@pytest.fixture
def filmed(tmp_path: Path, person: Posed) -> Path:
    """A folder with calibration, three pictures of each camera, and a model; nobody is in the first picture."""
    write_rig(RIG, tmp_path / "Calib.toml")
    for camera in RIG:
        (tmp_path / "videos" / camera.name).mkdir(parents=True)
        for k in range(3):
            image = dotted(camera, person) if k else np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
            cv2.imwrite(str(tmp_path / "videos" / camera.name / f"{k:03d}.png"), image[..., ::-1])
    simcc_model(tmp_path / "pose.onnx", SIZE)
    return tmp_path


def session(folder: Path, more: str) -> Path:
    videos = "\n".join(f'{name} = "videos/{name}"' for name in RIG.names)
    text = f'frames = [1, 2]\n[cameras]\ncalibration = "Calib.toml"\n[videos]\n{videos}\n[first_pose]\n{more}\n'
    (folder / "session.toml").write_text(text)
    return folder / "session.toml"


def test_one_key_gives_the_first_pose(filmed: Path, person: Posed) -> None:
    path = session(filmed, 'detector = "pose.onnx"')
    recording = open_recording(load_session(path))
    assert off(Posed(recording.body, recording.first_pose), person) < 0.04
    assert recording.report is not None and recording.report.warnings == ()
    clicking = clicking_of(load_session(path), path)  # `init` begins with the same keypoints
    assert set(clicking.clicks) == set(RIG.names) and len(clicking.clicks["cam0"]) > 8
    several = session(filmed, 'detector = { model = "pose.onnx", frames = [1, 2] }')
    assert len(open_recording(load_session(several)).views) == 2


def test_exchanged_cameras_are_told_with_the_session(filmed: Path) -> None:
    path = session(filmed, 'detector = "pose.onnx"')
    text = path.read_text()
    path.write_text(text.replace("videos/cam0", "videos/?").replace("videos/cam1", "videos/cam0").replace("?", "cam1"))
    with pytest.raises(InputError, match=r"session\.toml: .*agree only if cam0 and cam1 are exchanged"):
        open_recording(load_session(path))


def test_one_option_of_init_gives_clicks(filmed: Path) -> None:
    path = session(filmed, "")
    clicking = clicking_of(load_session(path), path, detector=str(filmed / "pose.onnx"))
    answer = clicking.fit({"clicks": {c: {j: list(p) for j, p in its.items()} for c, its in clicking.clicks.items()}})
    assert answer["residual_px"] < 2.0


def test_new_writes_the_detector_and_shows_its_pose(filmed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in RIG.names:
        (filmed / "videos" / name / "000.png").unlink()
    given = ("--calibration", filmed / "Calib.toml", "--videos", filmed / "videos", "--stature", 1.75)
    told = document(capsys, "new", filmed / "s", *given, "--detector", filmed / "pose.onnx")
    assert max(told["first_pose"]["median_px"].values()) < 2.0 and told["first_pose"]["warnings"] == []
    assert 'model = "../pose.onnx"' in (filmed / "s" / "session.toml").read_text()
    assert told["next"] == [f"Next, track:  twistcap track {filmed / 's' / 'session.toml'}"]


def test_what_a_session_s_detector_lacks_is_told(filmed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more, words in (
        ('detector = "none.onnx"', "none.onnx"),
        ('detector = "nobodys"', "'nobodys' is not installed"),
        ('detector = { model = "pose.onnx", frames = [7] }', "frame 7 is after the end"),
        ('detector = { model = "pose.onnx", frames = [0] }', "finds nobody in cam0, cam1, cam2, cam3"),
        ('detector = { model = "nobodys", people = "yolox.onnx" }', "remove that key"),
        ('detector = "pose.onnx"\nclicks = "c.csv"', "not clicks and detector"),
        ("detector = 3", "detector"),
    ):
        assert words in refusal(capsys, "track", session(filmed, more), "--out", filmed / "out")
