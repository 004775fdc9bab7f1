"""The page on which measured points are clicked: its answers, the file that is written, and the page itself."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.browser import Browser
from support.commands import heeds_interrupts, refusal
from support.pages_shared import asked, needs_browser, served, unreachable
from twistcap import se3
from twistcap.calibrate.board import board_of
from twistcap.calibrate.scene import read_scene
from twistcap.camera import Camera, look_at
from twistcap.commands.points import pointing_of
from twistcap.io.calibration import read_rig
from twistcap.io.video import open_source
from twistcap.pages.assemble import page
from twistcap.pages.pointing import Pointing

NAMES = [*(f"p{k}" for k in range(6)), "corner \"<b>&'s"]
SIZE = (160, 120)


def folders(root: Path, size: tuple[int, int] = SIZE) -> Path:
    """A folder of pictures for each of two cameras."""
    for camera in ("left", "right"):
        (root / camera).mkdir(parents=True)
        picture = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), np.uint8)
        for k in range(3):
            cv2.imwrite(str(root / camera / f"{k}.png"), picture)
    return root


@pytest.fixture
def points(tmp_path: Path) -> Path:
    """Names and places only, but for a pixel of another camera and a remark."""
    table: dict[str, Any] = {name: {"world_m": [0.1 * k, 0.2, 0.3 * k]} for k, name in enumerate(NAMES)}
    table["p2"] |= {"pixels": {"third": [1, 2]}, "remark": "loose"}
    path = tmp_path / "points.json"
    path.write_text(json.dumps(table))
    return path


@pytest.fixture
def pointing(points: Path, tmp_path: Path) -> Pointing:
    return opened(points, folders(tmp_path / "scene"))


def opened(points: Path, scene: Path) -> Pointing:
    sources = {camera: open_source(scene / camera) for camera in ("left", "right")}
    return pointing_of(points, sources, sources)


def all_clicked() -> dict[str, dict[str, Any]]:
    return {camera: {name: [10.0 * k + 5, 7.5] for k, name in enumerate(NAMES)} for camera in ("left", "right")}


def test_clicks_are_written_beside_the_points(pointing: Pointing, points: Path, tmp_path: Path) -> None:
    before, clicks = points.read_text(), all_clicked()
    clicks["right"]["p1"] = None
    del clicks["right"]["p0"]
    with served("", pointing.answers) as url:
        said = json.loads(asked(url, "/save", json.dumps({"clicks": clicks}))[1])
        assert said["saved"] == str(tmp_path / "points.clicked.json") and "right has 5 of 6" in said["note"]
        assert "right has 5 of 6" in asked(url, "/go", json.dumps({"clicks": clicks}))[1]
        assert not pointing.done.is_set()
    assert points.read_text() == before
    scene, table = read_scene(pointing.target), json.loads(pointing.target.read_text())
    np.testing.assert_allclose(scene.points[3], [0.3, 0.2, 0.9])
    assert set(scene.pixels["left"]) == set(range(7)) and set(scene.pixels["right"]) == {2, 3, 4, 5, 6}
    np.testing.assert_allclose(scene.pixels["left"][3], [35, 7.5])
    assert table["p2"]["remark"] == "loose" and table["p2"]["pixels"]["third"] == [1, 2]
    assert table["p1"]["pixels"]["right"] is None and "right" not in table["p0"]["pixels"]
    for again in (points, pointing.target):  # opened anew, by either file: the same clicks, the same file
        later = opened(again, tmp_path / "scene")
        assert later.document()["clicks"] == clicks and later.target == pointing.target


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("[", "question"),
        ("{}", "clicks must be an object"),
        ('{"clicks": {"left": [1]}}', "clicks of left must be an object"),
        ('{"clicks": {"up": {}}}', "camera 'up' is unknown"),
        ('{"clicks": {"left": {"p9": [1, 2]}}}', "no point 'p9'"),
        ('{"clicks": {"left": {"p1": [1, 119.6]}}}', "out of the picture"),
        ('{"clicks": {"left": {"p1": [-1, 2]}}}', "out of the picture"),
        ('{"clicks": {"left": {"p1": [1]}}}', "2 numbers"),
        ('{"clicks": {"left": {"p1": "x"}}}', "p1 in left"),
    ],
)
def test_no_question_ends_in_a_traceback(pointing: Pointing, body: str, said: str) -> None:
    with served("", pointing.answers) as url:
        for path in ("/save", "/go"):
            status, text = asked(url, path, body)
            assert status == 200 and said in json.loads(text)["error"]
        assert asked(re.sub(r"/[\w-]+/$", "/wrong/", url), "/save", body)[0] == 404
    assert not pointing.target.exists() and not pointing.done.is_set()


def test_what_cannot_be_clicked_is_told(points: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, small = folders(tmp_path / "scene"), folders(tmp_path / "small", (80, 60))
    begin = ("calibrate", tmp_path / "rig", "--board", "chessboard:8x5:60", "--click", scene)
    given = ("--points", points, "--lens-of")
    assert "differ in size (160×120 and 80×60" in refusal(capsys, *begin, *given, small)
    assert "same cameras" in refusal(capsys, *begin, *given, small / "left")
    assert "does not go with --json" in refusal(capsys, *begin, *given, scene, "--json")
    assert "--lens-of" in refusal(capsys, *begin, "--points", points)
    assert "--points" in refusal(capsys, *begin, "--videos", scene)
    points.write_text('{"p": {"world_m": [1, 2]}}')
    assert "must hold 3 numbers" in refusal(capsys, *begin, *given, scene)


def filmed(root: Path, camera: Camera, rng: np.random.Generator) -> None:
    """Pictures of the board by one camera, turned and moved about before it."""
    image = cv2.copyMakeBorder(BOARD.image(40), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=(255,))
    to_board = np.diag([BOARD.square / 40, BOARD.square / 40, 1.0])
    to_board[:2, 2] = (0.5 - 40) * BOARD.square / 40
    root.mkdir(parents=True)
    middle = np.array([*BOARD.size, 0.0]) / 2
    for k in range(6):
        R = se3.exp_rotation(0.5 * rng.normal(size=3))
        at = np.array([*rng.uniform(-0.12, 0.12, 2), rng.uniform(0.9, 1.4)]) - R @ middle
        H = camera.K @ np.column_stack([R[:, :2], at]) @ to_board
        cv2.imwrite(str(root / f"{k:02}.png"), cv2.warpPerspective(image, H, camera.size, borderValue=(128,)))


@contextmanager
def running(folder: Path, *words: object) -> Generator[tuple[str, subprocess.Popen[str]]]:
    """A command in a folder, and the address that it prints."""
    command = [sys.executable, "-m", "twistcap", *map(str, words)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder, preexec_fn=heeds_interrupts
    ) as process:  # fmt: skip
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip(), process
        finally:
            process.kill()


BOARD = board_of("charuco:8x5:60:45:4X4_50")
BEGIN = ("calibrate", "rig", "--board", "charuco:8x5:60:45:4X4_50", "--points", "points.json")


def test_calibration_goes_on_with_the_clicks(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    K = np.array([[600, 0, 320], [0, 600, 240], [0, 0, 1.0]])
    places = rng.uniform([-0.8, -0.8, 0.2], [0.8, 0.8, 1.8], (12, 3))
    eyes = {"left": [3.0, -1, 1.4], "right": [3.0, 1.5, 1.6]}
    rig = [Camera(name, K, look_at(eye, [0, 0, 1.0]), (640, 480)) for name, eye in eyes.items()]
    for camera in rig:
        filmed(tmp_path / "lenses" / camera.name, camera, rng)
    (tmp_path / "points.json").write_text(json.dumps({f"p{k}": {"world_m": p.tolist()} for k, p in enumerate(places)}))
    clicks = {c.name: {f"p{k}": p for k, p in enumerate(c.project(places)[0].tolist())} for c in rig}
    with running(tmp_path, *BEGIN, "--click", "lenses", "--lens-of", "lenses", "--lens", "brown") as (url, process):
        assert "error" not in asked(url, "/go", json.dumps({"clicks": clicks}))[1]
        _, told = process.communicate(timeout=600)
        assert process.returncode == 0, told
    assert (tmp_path / "rig" / "calibration.html").is_file()
    found = read_rig(tmp_path / "rig" / "Calib.toml")
    for camera in rig:
        assert np.linalg.norm(found[found.names.index(camera.name)].centre - camera.centre) < 0.02


def test_a_page_that_is_left_says_what_was_kept(points: Path, tmp_path: Path) -> None:
    folders(tmp_path / "scene")
    for saves, said in ((False, "nothing was saved"), (True, "the clicks are in")):
        with running(tmp_path, *BEGIN, "--click", "scene", "--lens-of", "scene") as (url, process):
            if saves:
                assert "error" not in asked(url, "/save", json.dumps({"clicks": all_clicked()}))[1]
            else:
                assert asked(url)[0] == 200
            process.send_signal(signal.SIGINT)
            _, told = process.communicate(timeout=60)
            assert process.returncode == 0 and f"Not calibrated: {said}" in " ".join(told.split())
    assert len(read_scene(tmp_path / "points.clicked.json").pixels["left"]) == 7


@needs_browser
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_each_point_is_asked_for_in_each_camera(pointing: Pointing, size: tuple[int, int]) -> None:
    with served(page("points", "test", pointing.document()), pointing.answers) as url, Browser(size) as browser:

        def on_screen(camera: str, x: float, y: float) -> tuple[float, float]:
            view = f"document.querySelector('[data-camera={camera}]')"
            browser.run(f"{view}.scrollIntoView({{ block: 'end' }})")
            matrix = f"{view}.getScreenCTM()"
            at = browser.run(f"(p => [p.x, p.y])(new DOMPoint({x} + 0.5, {y} + 0.5).matrixTransform({matrix}))")
            return at[0], at[1]

        browser.open(url)
        for camera in ("left", "right"):
            for k, name in enumerate(NAMES):
                assert browser.run("[twistcapPoints.asked(), twistcapPoints.current()]") == [camera, name]
                assert f"“{name}” in {camera}" in browser.run("document.getElementById('message').textContent")
                if (camera, k) == ("right", 0):
                    browser.run("document.getElementById('skip').click()")
                else:
                    browser.click(*on_screen(camera, 15 + 20 * k, 20 + 10 * k))
        browser.drag(on_screen("left", 15, 20), on_screen("left", 40, 70))
        browser.run("document.getElementById('save').click()")
        browser.wait("document.body.dataset.saved")
        clicks = json.loads(json.dumps(browser.run("twistcapPoints.clicks")))
        assert unreachable(browser) == []
        assert browser.run("document.documentElement.scrollWidth") <= size[0]
        browser.run("document.getElementById('go').click()")
        browser.wait("document.getElementById('go').disabled")
        assert browser.problems == []
    pixels = read_scene(pointing.target).pixels
    np.testing.assert_allclose(pixels["left"][0], [40, 70], atol=1.0)
    np.testing.assert_allclose(pixels["left"][6], [135, 80], atol=1.0)
    assert clicks["right"]["p0"] is None and set(pixels["right"]) == {1, 2, 3, 4, 5, 6}
    assert pointing.done.is_set()


@needs_browser
def test_points_are_clicked_and_taken_away_by_keys(pointing: Pointing) -> None:
    with served(page("points", "test", pointing.document()), pointing.answers) as url, Browser() as browser:
        browser.open(url)
        now = "[twistcapPoints.asked(), twistcapPoints.current(), twistcapPoints.clicks.right]"
        browser.run("document.querySelector('[data-camera=right]').focus()")
        browser.keys(3, "ArrowRight", 39)
        assert browser.run("[...document.querySelectorAll('.loupe')].filter(l => !l.hidden).length") == 1
        browser.keys(1, "Enter", 13)
        assert browser.run(now) == ["right", "p1", {"p0": [83, 60]}]
        browser.run("document.querySelector('[data-name=p0]').click()")
        browser.run("document.querySelector('[data-camera=right]').focus()")
        browser.keys(1, "Delete", 46)
        assert not browser.run("twistcapPoints.clicks.right?.p0")
        browser.run("document.getElementById('skip').click()")
        assert browser.run(now) == ["right", "p1", {"p0": None}]
        browser.run("document.querySelector('[data-name=p0]').click()")
        browser.run("document.getElementById('remove').click()")
        assert "“p0” in right" in browser.run("document.getElementById('message').textContent")
        assert browser.problems == []
