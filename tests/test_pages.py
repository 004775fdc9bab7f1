"""The viewer and the page for the first pose: a browser shows what they are given, and what it sends is kept."""

from __future__ import annotations

import base64
import http.client
import json
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from browser import CHROMIUM, Browser
from test_reference import hinged_box
from twistcap._typing import AnyArray
from twistcap.body import Pose, Posed, rescaled
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, look_at
from twistcap.cli import main
from twistcap.commands.init import clicking_of
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Keypoints
from twistcap.firstpose import Proportions
from twistcap.io.pose_file import body_at, write_pose
from twistcap.io.recording import open_recording
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.session import load_session
from twistcap.io.synthetic import write_session
from twistcap.pages import detectors
from twistcap.pages.assemble import packed, page
from twistcap.pages.outlines import body_outlines
from twistcap.pages.server import page_server
from twistcap.studio import StudioConfig, capture

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the page with")
SIX = ("shoulder_r", "shoulder_l", "hip_r", "hip_l", "knee_r", "ankle_l")
FRAMES = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A studio session of a few small frames, and its truth as a result that lost two of them."""
    folder = tmp_path_factory.mktemp("studio") / "walk"
    scene = capture(StudioConfig(seed=1, views=3, size=(192, 140), frames=FRAMES))
    write_session(scene, folder, masks=False)
    videos = {name: str(folder / "videos" / f"{name}.mp4") for name in scene.rig.names}
    dof = scene.true_body.dof
    for name, lost in (("one", (2, 3)), ("two", ())):
        (folder / name).mkdir()
        with ResultWriter(folder / name / "result.h5", scene.true_body, scene.rig, {"videos": videos}) as writer:
            for k, pose in enumerate(scene.true_poses):
                writer.append(Estimate(k, k / 60, pose, 1e-4 * np.eye(dof), lost=k in lost))
    return folder


@pytest.fixture
def session(made: Path, tmp_path: Path) -> Path:
    """A session for the studio's videos as a user would begin it."""
    code = run("new", tmp_path / "mine", "--calibration", made / "Calib.toml", "--videos", made / "videos")
    assert code == 0
    return tmp_path / "mine" / "session.toml"


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as done:
        main([str(a) for a in arguments])
    return int(done.value.code or 0)


def clicked(made: Path, clicking: Any, joints: tuple[str, ...] = SIX) -> dict[str, dict[str, list[float]]]:
    """The true joints as clicks in the first and third camera."""
    with np.load(made / "truth.npz") as truth:
        names, points = [str(n) for n in truth["names"]], truth["landmarks"][0]
    return {
        camera.name: {joint: camera.project(points[names.index(joint)])[0].tolist() for joint in joints}
        for camera in (clicking.rig[0], clicking.rig[2])
    }


def picture(browser: Browser, path: Path) -> AnyArray:
    return cv2.imread(str(browser.screenshot(path)))[..., ::-1].astype(int)


def has_colour(image: AnyArray, rgb: tuple[int, int, int], tolerance: int = 12, pixels: int = 30) -> bool:
    return bool((np.abs(image - rgb).max(axis=-1) <= tolerance).sum() >= pixels)


# ---- parts ----


def test_outlines_enclose_what_the_camera_sees() -> None:
    K = np.array([[900.0, 0, 500], [0, 900.0, 400], [0, 0, 1]])
    camera = Camera("a", K, look_at((3.0, 0.6, 0.4), (0, 0, 0)), (1001, 801), np.array([-0.2, 0.05, 0, 0, 0]))
    body = hinged_box()
    posed = Posed(body, Pose.rest(body))
    curves = body_outlines(camera, posed)
    corners, _ = camera.project(posed.vertices)
    hull = cv2.convexHull(corners.astype(np.float32))[:, 0]
    assert len(curves) == 1
    assert cv2.contourArea(curves[0].astype(np.float32)) == pytest.approx(cv2.contourArea(hull), rel=0.03)
    np.testing.assert_allclose(curves[0].min(axis=0), hull.min(axis=0), atol=2.0)
    np.testing.assert_allclose(curves[0].max(axis=0), hull.max(axis=0), atol=2.0)


def test_arrays_are_packed_little_endian() -> None:
    values = np.array([[1.5, -2.0]])
    document = packed(values)
    assert (document["type"], document["shape"]) == ("f4", [1, 2])
    np.testing.assert_array_equal(np.frombuffer(base64.b64decode(document["data"]), "<f4"), values[0])


def test_titles_and_data_cannot_break_out_of_the_page() -> None:
    text = page("view", "<b>title", {"evil": "</script><script>alert(1)</script> {{script}}"})
    assert "<b>title" not in text
    assert "alert(1)</script>" not in text
    assert '{{script}}"' in text  # data are never taken for a template


@contextmanager
def served(text: str, answers: Any) -> Iterator[int]:
    server = page_server(text, answers)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield int(server.server_address[1])
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def asked(port: int, path: str, body: str | None = None, **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    sent = {"Content-Type": "application/json", **headers}
    connection.request("GET" if body is None else "POST", path, body, sent)
    reply = connection.getresponse()
    return reply.status, reply.read().decode()


def test_the_server_answers_this_machine_alone() -> None:
    def answer(question: Any) -> Any:
        if "bad" in question:
            raise InputError("one clear sentence.")
        return {"twice": 2 * question["n"]}

    with served("<p>page", {"/double": answer}) as port:
        assert asked(port, "/") == (200, "<p>page")
        assert json.loads(asked(port, "/double", '{"n": 4}')[1]) == {"twice": 8}
        assert json.loads(asked(port, "/double", '{"bad": 1}')[1]) == {"error": "one clear sentence."}
        assert "error" in json.loads(asked(port, "/double", "[1")[1])
        assert asked(port, "/else")[0] == 404
        assert asked(port, "/double", "n=1", **{"Content-Type": "text/plain"})[0] == 404  # what a foreign form can send
        assert asked(port, "/", Host="evil.example")[0] == 403
        with pytest.raises(InputError, match="--port"):
            page_server("", port=port)


# ---- viewer ----


@pytest.fixture(scope="module")
def saved(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("view") / "both.html"
    results = [made / name / "result.h5" for name in ("one", "two")]
    assert run("view", *results, "--reference", made / "truth.npz", "--save", out) == 0
    return out


def test_a_saved_view_is_one_file(saved: Path) -> None:
    text = saved.read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=["']?(https?:|//)""", text)
    assert len(text) < 4e6


@needs_browser
def test_the_viewer_shows_a_result_and_plays_it(made: Path, saved: Path, tmp_path: Path) -> None:
    result = read_result(made / "one" / "result.h5")
    with Browser() as browser:
        browser.open(saved.as_uri())
        assert browser.run("document.body.dataset.webgl") == "yes"
        assert browser.run("document.querySelectorAll('.plot canvas').length") == len(result.body.coordinate_names)
        assert browser.run("document.querySelectorAll('#views canvas').length") == 3
        browser.run("twistcapView.seek(4)")
        skin = browser.run("Array.from(twistcapView.runs[0].mesh.geometry.attributes.position.array)")
        expected = Posed(result.body, result.poses[4]).vertices
        np.testing.assert_allclose(np.array(skin).reshape(-1, 3), expected, atol=1e-5)
        assert "lost" not in browser.run("document.getElementById('now').textContent")
        browser.run("twistcapView.seek(2)")
        assert "lost: one" in browser.run("document.getElementById('now').textContent")
        browser.run("window.visited = new Set(); document.getElementById('speed').value = '0.25'")
        watch = "new MutationObserver(() => visited.add(twistcapView.state.frame))"
        browser.run(f"{watch}.observe(document.body, {{ attributes: true }})")
        browser.run("document.getElementById('play').click()")
        browser.wait(f"visited.size >= 4 && visited.has({FRAMES - 1}) && visited.has(0)")  # to the end and round again
        browser.run("document.getElementById('play').click()")
        assert browser.run("twistcapView.state.playing") is False
        assert browser.problems == []  # neither an exception nor a look at the network


@needs_browser
def test_the_viewer_draws_bodies_lost_frames_and_the_reference(saved: Path, tmp_path: Path) -> None:
    blue, orange, red = (47, 125, 225), (239, 138, 36), (229, 72, 77)
    with Browser() as browser:
        browser.open(saved.as_uri())
        browser.run("twistcapView.seek(0)")
        start = picture(browser, tmp_path / "start.png")
        assert has_colour(start, blue) and has_colour(start, orange)  # legend, outlines, curves
        assert has_colour(start, red)  # marks on the time line
        box = browser.run("(({x, y, width, height}) => [x, y, width, height])(scene.getBoundingClientRect())")
        x, y, w, h = (round(v) for v in box)
        browser.run("document.getElementById('show-apart').click()")
        apart = picture(browser, tmp_path / "apart.png")
        together, beside = start[y : y + h, x : x + w], apart[y : y + h, x : x + w]
        # The same two bodies one in the other, then beside each other: more pixels leave the pale ground.
        dark = [(view.min(axis=-1) < 150).sum() for view in (together, beside)]
        assert dark[1] > 1.4 * dark[0]
        frames = browser.run("twistcapView.runs.map((run) => run.mesh.position.length())")
        np.testing.assert_allclose(frames, [0.0, 1.0], atol=1e-6)
        assert browser.problems == []


def test_a_result_without_videos_is_shown_without_images(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, bare, empty = read_result(made / "one" / "result.h5"), tmp_path / "bare.h5", tmp_path / "empty.h5"
    for path, estimates in ((bare, result.estimates), (empty, ())):
        with ResultWriter(path, result.body, result.rig, {}) as writer:
            for estimate in estimates:
                writer.append(estimate)
    assert run("view", bare, empty, "--save", tmp_path / "bare.html") == 0
    assert "cam02: its video  is not found" in capsys.readouterr().err
    found = re.search(r'id="data">(.*?)</script>', (tmp_path / "bare.html").read_text(), re.S)
    assert found is not None
    document = json.loads(found[1])
    assert document["shown"] == [] and document["cameras"][0]["images"] == []
    assert document["runs"][1]["rows"] == [-1] * FRAMES  # a run that was killed before its first frame


def test_a_view_says_what_is_wrong(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = made / "one" / "result.h5"
    empty = tmp_path / "empty.h5"
    with ResultWriter(empty, humanoid(), read_result(result).rig, {}):
        pass
    for arguments, words in (
        ((tmp_path / "none.h5",), "does not exist"),
        ((result, result), "twice"),
        ((result, "--reference", tmp_path / "none.trc"), "does not exist"),
        ((result, "--save", tmp_path / "no" / "folder.html"), "cannot be written"),
        ((result, "--session", tmp_path / "none.toml"), "cannot be read"),
        ((empty,), "no result holds a frame"),
    ):
        assert run("view", *arguments) == 2
        told = capsys.readouterr().err.strip().splitlines()[-1]
        assert words in told and told.startswith("twistcap:")


# ---- first pose ----


@needs_browser
def test_clicking_moves_the_body_and_saves_it(made: Path, session: Path, tmp_path: Path) -> None:
    clicking = clicking_of(load_session(session), session)
    clicks = clicked(made, clicking)
    with served(page("init", "test", clicking.document()), clicking.answers) as port, Browser() as browser:

        def on_screen(camera: str, x: float, y: float) -> tuple[float, float]:
            matrix = f"document.querySelector('[data-camera={camera}]').getScreenCTM()"
            at = browser.run(f"(p => [p.x, p.y])(new DOMPoint({x} + 0.5, {y} + 0.5).matrixTransform({matrix}))")
            return at[0], at[1]

        browser.open(f"http://127.0.0.1:{port}/")
        for camera, joints in clicks.items():
            for joint, (x, y) in joints.items():
                browser.run(f"document.querySelector('[data-name={joint}]').click()")
                browser.wait("document.body.dataset.busy !== 'yes'")  # an answer may shift the page under the mouse
                browser.click(*on_screen(camera, x, y))
        settled = "document.body.dataset.busy === 'no' && twistcapInit.state()"
        browser.wait(settled)
        seen = browser.run("twistcapInit.clicks")
        for camera, joints in clicks.items():
            for joint, pixel in joints.items():  # the mouse has whole screen pixels at best
                np.testing.assert_allclose(seen[camera][joint], pixel, atol=0.6)
        first = browser.run("twistcapInit.state()")
        assert has_colour(picture(browser, tmp_path / "fitted.png"), (41, 211, 255), 30)

        x, y = first["joints"]["cam01"]["wrist_r"]
        browser.drag(on_screen("cam01", x, y), on_screen("cam01", x - 14, y - 8))
        browser.wait(settled + " && twistcapInit.clicks.cam01.wrist_r")
        dragged = browser.run("twistcapInit.state()")
        moved = np.subtract(dragged["joints"]["cam01"]["wrist_r"], (x, y))
        np.testing.assert_allclose(moved, (-14, -8), atol=3.0)

        slider = "document.querySelector('[data-coordinate=knee_angle_l]')"
        browser.run(f"(s => {{ s.value = 60; s.dispatchEvent(new Event('input')); }})({slider})")
        browser.wait(settled + " && Math.abs(twistcapInit.state().q_deg.knee_angle_l - 60) < 0.1")
        browser.run("document.getElementById('save').click()")
        browser.wait("document.body.dataset.saved")
        assert browser.problems == []
    recording = open_recording(load_session(session))
    shown = clicking.shown
    assert shown is not None
    np.testing.assert_allclose(recording.first_pose.minus(shown.pose), 0.0, atol=1e-9)
    np.testing.assert_allclose(recording.body.vertices, shown.body.vertices, atol=1e-9)
    assert np.rad2deg(recording.first_pose.q[recording.body.coordinate("knee_angle_l")]) == pytest.approx(60.0)
    again = clicking_of(load_session(session), session)  # opened anew: the same clicks and the same pose
    assert set(again.clicks["cam01"]) == {*SIX, "wrist_r"}
    assert again.shown is not None
    np.testing.assert_allclose(again.shown.vertices, shown.vertices, atol=1e-9)


def test_six_joints_in_two_views_find_the_pose(made: Path, session: Path) -> None:
    clicking = clicking_of(load_session(session), session)
    answer = clicking.fit({"clicks": clicked(made, clicking)})
    assert answer["residual_px"] < 1.0
    with np.load(made / "truth.npz") as truth:
        names, points = [str(n) for n in truth["names"]], truth["landmarks"][0]
    body = clicking.generic
    errors = [
        np.linalg.norm(clicking.shown.landmarks[body.landmarks.index(joint)] - points[names.index(joint)])
        for joint in SIX
    ]
    assert max(errors) < 0.03


def test_a_held_angle_stays_in_further_fits(made: Path, session: Path) -> None:
    clicking = clicking_of(load_session(session), session)
    clicks = clicked(made, clicking)
    clicking.fit({"clicks": clicks})
    held = {"elbow_flex_r": 70.0, "knee_angle_l": 500.0}
    assert clicking.slide({"held": held})["q_deg"]["elbow_flex_r"] == pytest.approx(70.0)
    angles = clicking.fit({"clicks": clicks, "held": held})["q_deg"]
    assert angles["elbow_flex_r"] == pytest.approx(70.0)
    upper = clicking.generic.limits[clicking.generic.coordinate("knee_angle_l"), 1]
    assert angles["knee_angle_l"] == pytest.approx(np.rad2deg(upper), abs=0.01)  # no farther than the joint goes


def test_clicks_say_what_is_wrong(made: Path, session: Path) -> None:
    clicking = clicking_of(load_session(session), session)
    good = clicked(made, clicking)
    for question, words in (
        ({"clicks": {"cam09": {"hip_r": [1, 2]}}}, "cam09"),
        ({"clicks": {"cam01": {"tail": [1, 2]}}}, "tail"),
        ({"clicks": {"cam01": {"hip_r": [1, float("nan")]}}}, "finite"),
        ({"clicks": {"cam01": {"hip_r": "1, 2"}}}, "finite"),
        ({"clicks": None}, "object"),
        ({"clicks": {}}, "no joint"),
        ({"clicks": {"cam01": good["cam01"]}}, "two cameras"),
        ({"clicks": good, "held": {"wings": 3}}, "wings"),
    ):
        with pytest.raises(InputError, match=words):
            clicking.fit(question)
    for answer in (clicking.slide, clicking.save):
        with pytest.raises(InputError, match="click a handful"):
            answer({})


def test_a_session_that_reads_clicks_gets_clicks(made: Path, session: Path) -> None:
    session.write_text(session.read_text().replace('file = "first_pose.json"', 'clicks = "clicks.csv"'))
    clicking = clicking_of(load_session(session), session)
    assert clicking.document()["sliders"] is False
    clicking.fit({"clicks": clicked(made, clicking)})
    clicking.save({})
    recording = open_recording(load_session(session))
    assert clicking.shown is not None
    off = np.linalg.norm(Posed(recording.body, recording.first_pose).landmarks - clicking.shown.landmarks, axis=1)
    assert off.max() < 0.002  # the file keeps hundredths of a pixel


def test_a_session_that_reads_another_file_is_told_what_to_change(made: Path) -> None:
    path = made / "session.toml"  # its first pose is an NPZ
    clicking = clicking_of(load_session(path), path)
    clicking.fit({"clicks": clicked(made, clicking)})
    saved = clicking.save({})
    try:
        assert Path(saved["saved"]).is_file()
        assert 'file = "first_pose.json"' in saved["note"]
        with pytest.raises(InputError, match="--out"):
            clicking_of(load_session(path), path)
    finally:
        for file in made.glob("first_pose.*"):
            if file.suffix != ".npz":
                file.unlink()


def test_poor_proportions_in_a_pose_file_are_told(tmp_path: Path) -> None:
    body, path = humanoid(), tmp_path / "pose.json"
    good = Proportions({"tibia_r": 1.1, "tibia_l": 1.1}, {"pelvis": 0.9}, 1.02)
    write_pose(path, body, Pose.rest(body), good)
    expected = rescaled(body, good.lengths, good.girths, good.stature)
    np.testing.assert_allclose(body_at(path, body).vertices, expected.vertices)
    write_pose(path, body, Pose.rest(body))
    assert body_at(path, body) is body
    for poor, words in (
        (Proportions({"tail": 1.0}, {}), "tail"),
        (Proportions({"tibia_r": -1.0}, {}), "positive"),
        (Proportions({"tibia_r": float("nan")}, {}), "finite"),
    ):
        write_pose(path, body, Pose.rest(body), poor)
        with pytest.raises(InputError, match=words):
            body_at(path, body)
    path.write_text('{"proportions": {"stature": 1.0}}')
    with pytest.raises(InputError, match="stature, lengths and girths"):
        body_at(path, body)


@pytest.mark.parametrize("command", ["init", "view"])
def test_a_page_is_served_until_interrupted(command: str, made: Path, session: Path) -> None:
    target = session if command == "init" else made / "one" / "result.h5"
    process = subprocess.Popen(
        [sys.executable, "-m", "twistcap.cli", command, str(target)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)
        status, text = asked(int(address.rsplit(":", 1)[1].strip("/")), "/")
        assert status == 200 and 'id="data"' in text
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()


# ---- detectors ----


class FakePoints:
    """Entry points with one detector, as `importlib.metadata` gives them."""

    names = frozenset({"fake"})

    def __init__(self, detect: Any) -> None:
        self._detect = detect

    def select(self, name: str) -> list[FakePoints]:
        assert name == "fake"
        return [self]

    def load(self) -> Any:
        return self._detect


def test_a_detector_gives_the_first_clicks(made: Path, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = clicked(made, clicking_of(load_session(session), session))

    def detect(images: Any, rig: Any) -> Keypoints:
        assert [image.shape for image in images] == [(140, 192, 3)] * 3
        pixels, confidence = np.full((3, 7, 2), np.nan), np.zeros((3, 7))
        for c in (0, 2):
            pixels[c, :6] = list(truth[rig.names[c]].values())
            confidence[c, :6] = 0.8
        return Keypoints((*SIX, "not_of_this_body"), pixels, confidence)

    def found(group: str) -> FakePoints:
        assert group == "twistcap.detectors"
        return FakePoints(detect)

    monkeypatch.setattr(detectors, "entry_points", found)
    clicking = clicking_of(load_session(session), session, detector="fake")
    assert set(clicking.clicks) == {"cam01", "cam03"}
    np.testing.assert_allclose(clicking.clicks["cam03"]["knee_r"], truth["cam03"]["knee_r"])
    assert clicking.fit({"clicks": json.loads(json.dumps(clicking.clicks))})["residual_px"] < 1.0


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (Keypoints(("hip_r",), np.zeros((2, 1, 2)), np.zeros((2, 1))), "3 cameras"),
        (Keypoints(("hip_r",), np.full((3, 1, 2), np.nan), np.ones((3, 1))), "finite"),
        ({"hip_r": [1, 2]}, "must return Keypoints"),
    ],
)
def test_a_poor_detector_is_told(answer: Any, words: str, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detectors, "entry_points", lambda group: FakePoints(lambda images, rig: answer))
    with pytest.raises(InputError, match=words):
        clicking_of(load_session(session), session, detector="fake")


def test_a_detector_that_is_not_there_is_told(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("init", session, "--detector", "nobodys") == 2
    assert "'nobodys' is not installed" in capsys.readouterr().err
