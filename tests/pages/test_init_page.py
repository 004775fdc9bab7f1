"""The page on which joints are clicked: from the first click to the saved pose; detectors."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.browser import Browser
from support.commands import heeds_interrupts
from support.pages_shared import asked, has_colour, needs_browser, paper, picture, run, served, studio_walk, unreachable
from twistcap.adjust.first_pose import Proportions
from twistcap.body import Pose, Posed, rescaled
from twistcap.body.humanoid import humanoid
from twistcap.commands.init import clicking_of
from twistcap.commands.init import save as saved
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io import detectors
from twistcap.io.pose_file import body_at, frame_of, write_pose
from twistcap.io.recording import open_recording
from twistcap.io.session import load_session
from twistcap.io.start_report import start_report
from twistcap.io.synthetic import write_session
from twistcap.pages import clicking as module
from twistcap.pages.assemble import page
from twistcap.pages.clicking import LEAST_IOU, overlap
from twistcap.studio import StudioConfig, capture

SIX = ("shoulder_r", "shoulder_l", "hip_r", "hip_l", "knee_r", "ankle_l")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return studio_walk(tmp_path_factory.mktemp("studio") / "walk")


@pytest.fixture(scope="module")
def stride(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Long enough that the person leaves his place."""
    folder = tmp_path_factory.mktemp("stride") / "walk"
    write_session(capture(StudioConfig(seed=6, views=3, size=(192, 140), frames=90)), folder, masks=False)
    return folder


@pytest.fixture
def session(made: Path, tmp_path: Path) -> Path:
    """A session for the studio's videos as a user would begin it."""
    code = run("new", tmp_path / "mine", "--calibration", made / "Calib.toml", "--videos", made / "videos")
    assert code == 0
    return tmp_path / "mine" / "session.toml"


def clicked(made: Path, clicking: Any, joints: tuple[str, ...] = SIX) -> dict[str, dict[str, list[float]]]:
    """The true joints as clicks in the first and third camera."""
    with np.load(made / "truth.npz") as truth:
        names, points = [str(n) for n in truth["names"]], truth["landmarks"][0]
    return {
        camera.name: {joint: camera.project(points[names.index(joint)])[0].tolist() for joint in joints}
        for camera in (clicking.rig[0], clicking.rig[2])
    }


# ---- first pose ----


@needs_browser
def test_clicking_moves_the_body_and_saves_it(made: Path, session: Path, tmp_path: Path) -> None:
    clicking = clicking_of(load_session(session), session)
    clicks = clicked(made, clicking)
    with served(page("init", "test", clicking.document()), clicking.answers) as url, Browser() as browser:

        def on_screen(camera: str, x: float, y: float) -> tuple[float, float]:
            matrix = f"document.querySelector('[data-camera={camera}]').getScreenCTM()"
            at = browser.run(f"(p => [p.x, p.y])(new DOMPoint({x} + 0.5, {y} + 0.5).matrixTransform({matrix}))")
            return at[0], at[1]

        browser.open(url)
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


@needs_browser
@pytest.mark.parametrize("size", [(390, 844), (1280, 800), (3840, 2160)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_control_of_the_clicks_is_reached(
    made: Path, session: Path, size: tuple[int, int], scheme: str, tmp_path: Path
) -> None:
    clicking = clicking_of(load_session(session), session)
    clicking.fit({"clicks": clicked(made, clicking)})
    with served(page("init", "test", clicking.document()), clicking.answers) as url, Browser(size) as browser:
        browser.prefer(scheme)
        browser.open(url)
        assert unreachable(browser) == []
        assert browser.run("document.documentElement.scrollWidth") <= size[0]
        assert (paper(browser, tmp_path / "page.png") < 60) == (scheme == "dark")
        assert browser.problems == []


@needs_browser
def test_fingers_and_keys_click_as_the_mouse_does(made: Path, session: Path) -> None:
    clicking = clicking_of(load_session(session), session)
    loupe = "[...document.querySelectorAll('.loupe')].filter(l => !l.hidden).length"
    with served(page("init", "test", clicking.document()), clicking.answers) as url, Browser((390, 844)) as browser:
        browser.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        browser.open(url)
        x, y = browser.centre("[data-camera=cam01]")
        browser.touch("touchStart", (x, y))
        assert browser.run(loupe) == 1
        browser.touch("touchMove", (x + 12, y + 4))
        browser.touch("touchEnd")
        assert browser.run(loupe) == 0
        (joint,) = browser.run("Object.keys(twistcapInit.clicks.cam01)")
        before = browser.run("twistcapInit.clicks.cam01")[joint]
        browser.touch("touchStart", (x - 40, y))  # two fingers: zoom, and no click
        browser.touch("touchStart", (x - 40, y), (x + 40, y))
        browser.touch("touchMove", (x - 80, y), (x + 80, y))
        browser.touch("touchEnd")
        box = [
            float(v)
            for v in browser.run("document.querySelector('[data-camera=cam01]').getAttribute('viewBox')").split()
        ]
        assert box[2] == pytest.approx(192 / 2, rel=0.1) and len(browser.run("twistcapInit.clicks.cam01")) == 1
        browser.run("document.querySelector('[data-camera=cam02]').focus()")
        for key, code in (("ArrowRight", 39), ("ArrowDown", 40)):
            browser.key(key, code)
        assert browser.run(loupe) == 1
        browser.key("Enter", 13)
        ((name, pixel),) = browser.run("twistcapInit.clicks.cam02").items()
        assert name != joint and pixel == [97, 71]  # one right of and one below the middle of 192 × 140
        browser.run(f"document.querySelector('[data-name={joint}]').click(); document.getElementById('remove').click()")
        assert browser.run("twistcapInit.clicks.cam01 === undefined") and before[0] > 96
        assert browser.problems == []


@needs_browser
def test_save_turns_amber_where_a_view_without_clicks_does_not_fit(stride: Path, tmp_path: Path) -> None:
    path = stride / "session.toml"
    clicking = clicking_of(load_session(path), path, tmp_path / "pose.json")
    clicks = clicked(stride, clicking)
    good = clicking.fit({"clicks": clicks})["overlap"]
    assert set(good) == {"cam01", "cam02", "cam03"} and min(good.values()) > LEAST_IOU
    save = "document.getElementById('save').className"
    with served(page("init", "test", clicking.document()), clicking.answers) as url, Browser() as browser:
        browser.open(url)
        assert browser.run(save) == "" and "overlap" in browser.run(
            "document.querySelectorAll('.view b')[1].textContent"
        )
    clicks["cam03"] = {joint: [x - 25, y] for joint, (x, y) in clicks["cam03"].items()}
    clicking.shown = None
    bad = clicking.fit({"clicks": clicks})["overlap"]
    assert bad["cam02"] < LEAST_IOU
    with served(page("init", "test", clicking.document()), clicking.answers) as url, Browser() as browser:
        browser.open(url)
        assert browser.run(save) == "amber"
        assert browser.run("[...document.querySelectorAll('.view.amber b')].map(b => b.textContent)")[0].startswith(
            "cam02"
        )
        browser.click(*browser.centre("#save"))
        browser.wait("document.body.dataset.saved")  # it warns, and saves
        assert "cam02" in browser.run("document.getElementById('message').textContent")


def test_a_silhouette_that_says_nothing_is_not_held_against_the_pose(
    made: Path, session: Path, stride: Path, tmp_path: Path
) -> None:
    short = clicking_of(load_session(session), session)
    assert short.fit({"clicks": clicked(made, short)})["overlap"] == {}  # too short to know what is still
    path = stride / "session.toml"
    clicking = clicking_of(load_session(path), path, tmp_path / "pose.json")
    clicking.fit({"clicks": clicked(stride, clicking)})
    one = clicking.silhouettes[1]
    assert one is not None and clicking.shown is not None
    assert overlap(clicking.shown, one) is not None
    assert overlap(clicking.shown, replace(one, mask=np.zeros_like(one.mask))) is None
    away = Pose(clicking.shown.pose.root.copy(), clicking.shown.pose.q)
    away.root[:3, 3] += [40.0, 0.0, 0.0]
    assert overlap(Posed(clicking.shown.body, away), one) in (0.0, pytest.approx(0.0, abs=0.05))


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
        ({"clicks": {"cam01": {"hip_r": [1, 10**400]}}}, "finite"),
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


def test_clicks_that_could_not_be_fitted_are_not_saved_beside_another_pose(made: Path, session: Path) -> None:
    clicking = clicking_of(load_session(session), session)
    good = clicked(made, clicking)
    clicking.fit({"clicks": good})
    with pytest.raises(InputError, match="two cameras"):
        clicking.fit({"clicks": {"cam01": good["cam01"]}})
    with pytest.raises(InputError, match="not of these clicks"):
        clicking.save({})
    assert not clicking.target.path.exists()
    clicking.fit({"clicks": good})
    clicking.save({})
    assert clicking.target.path.exists()


def test_a_session_that_reads_clicks_gets_clicks(
    made: Path, session: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    session.write_text(session.read_text().replace("[first_pose]\n", '[first_pose]\nclicks = "clicks.csv"\n'))
    clicking = clicking_of(load_session(session), session)
    assert clicking.document()["sliders"] is False
    clicking.fit({"clicks": clicked(made, clicking)})
    capsys.readouterr()
    with monkeypatch.context() as counting:
        fits = list[Any]()
        counting.setattr(module, "start_report", lambda *given: fits.append(given) or start_report(*given))
        saved(clicking, {})
    assert len(fits) == 1  # a whole fit, for the page and the terminal together
    how_well = capsys.readouterr().err
    assert "First pose: px" in how_well and "Stature: fitted" in how_well and "knee_r" in how_well
    assert run("track", session, "--frames", "0:1", "--out", session.parent / "out") == 0
    assert how_well in capsys.readouterr().err  # `track` fits the same clicks
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
        assert frame_of(saved["saved"]) == 0
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
        (Proportions({"tibia_r": -1.0}, {}), "between 0.1 and 10"),
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
        [sys.executable, "-m", "twistcap.cli", command, str(target)],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=heeds_interrupts,
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{22}/", address)
        status, text = asked(address)
        assert status == 200 and 'id="data"' in text
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()


def test_keypoints_of_cameras_out_of_step_are_those_of_one_time(session: Path) -> None:
    """The clock of one camera is two frames off, so that its third image belongs to the first of the others."""
    for name in ("cam01", "cam02", "cam03"):
        folder = session.parent / "pose" / name
        folder.mkdir(parents=True)
        for k in range(5):
            row = [[10.0 + k, 20.0, 0.9]] * 17
            content = {"people": [{"pose_keypoints_2d": [number for point in row for number in point]}]}
            (folder / f"{k:03d}.json").write_text(json.dumps(content))
    folders = ", ".join(f'{name} = "pose/{name}"' for name in ("cam01", "cam02", "cam03"))
    table = f'[first_pose.keypoints]\nformat = "coco_17"\nperson = 0\nfolders = {{ {folders} }}\n'
    session.write_text(f"{session.read_text()}\n{table}\n[clocks.cam02]\noffset = {-2 / 60}\n")
    clicks = clicking_of(load_session(session), session).clicks
    assert {name: its["hip_r"][0] for name, its in clicks.items()} == {"cam01": 10.0, "cam02": 12.0, "cam03": 10.0}


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


def test_a_detector_that_fails_is_told(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def detect(images: Any, rig: Any) -> Keypoints:
        raise ValueError("boom")

    monkeypatch.setattr(detectors, "entry_points", lambda group: FakePoints(detect))
    with pytest.raises(InputError, match=r"detector 'fake' failed: ValueError: boom\."):
        clicking_of(load_session(session), session, detector="fake")


def test_a_detector_that_is_not_there_is_told(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("init", session, "--detector", "nobodys") == 2
    assert "'nobodys' is not installed" in capsys.readouterr().err
