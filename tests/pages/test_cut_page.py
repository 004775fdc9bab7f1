"""Silhouettes cut out by hand: the cut itself, the questions, and the page from the first stroke to the saved mask."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.browser import Browser
from support.pages_shared import has_colour, needs_browser, picture, run, served
from twistcap.acquire import cutout
from twistcap.acquire.cutout import Hints, Stroke, cut_out
from twistcap.camera import Camera, Rig, look_at
from twistcap.commands.body import cutting_of
from twistcap.errors import InputError
from twistcap.io.calibration import write_rig
from twistcap.pages.assemble import page
from twistcap.pages.cutting import outline
from twistcap.region.compare import iou

SIZE = (200, 260)  # width, height


def person() -> np.ndarray:
    """(H, W) a figure with a head, a trunk and two legs."""
    mask = np.zeros(SIZE[::-1], np.uint8)
    cv2.circle(mask, (100, 55), 22, 1, -1)
    cv2.ellipse(mask, (100, 125), (34, 55), 0, 0, 360, 1, -1)
    for x in (85, 115):
        cv2.line(mask, (x, 160), (x, 230), 1, 22)
    return mask > 0


def scene(seed: int = 0) -> np.ndarray:
    """(H, W, 3) RGB: the person in red and a green jacket before a blue, uneven room."""
    rng = np.random.default_rng(seed)
    room = cv2.GaussianBlur(rng.uniform(0, 255, (*SIZE[::-1], 3)).astype(np.float32), (0, 0), 6)
    image = 0.3 * room + np.array([40, 60, 130])
    inside = person()
    image[inside] = 0.2 * room[inside] + np.array([150, 60, 50])
    jacket = inside & (np.arange(SIZE[1])[:, None] > 90) & (np.arange(SIZE[1])[:, None] < 150)
    image[jacket] = 0.2 * room[jacket] + np.array([60, 130, 60])
    return np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)


@pytest.fixture
def keyviews(tmp_path: Path) -> Path:
    """A file of two views: one with an image alone, one whose mask is named but is not there yet."""
    K = np.array([[300.0, 0, 99.5], [0, 300.0, 129.5], [0, 0, 1]])
    cameras = [
        Camera(name, K, look_at(eye, [0, 0, 1.0], (0, 0, 1)), SIZE)
        for name, eye in (("a", [4, 0, 1]), ("b", [0, 4, 1]))
    ]
    write_rig(Rig(tuple(cameras)), tmp_path / "c.toml")
    for seed, name in enumerate(("front", "side")):
        cv2.imwrite(str(tmp_path / f"{name}.png"), scene(seed)[..., ::-1])
    path = tmp_path / "anna.toml"
    path.write_text(
        'calibration = "c.toml"\n[views.front]\ncamera = "a"\nimage = "front.png"\n'
        '[views.side]\ncamera = "b"\nimage = "side.png"\nmask = "side_mask.png"\n'
    )
    return path


def line(inside: bool, *points: float) -> Stroke:
    return Stroke(inside, np.reshape(points, (-1, 2)).astype(float), 6.0)


def test_a_rectangle_and_a_stroke_cut_the_person_out() -> None:
    image, true = scene(), person()
    assert cut_out(image, Hints()) is None
    rough = cut_out(image, Hints((50, 20, 150, 245)))
    assert rough is not None and iou(rough, true) > 0.9
    mended = cut_out(image, Hints((50, 20, 150, 245), (line(True, 100, 50, 100, 150), line(False, 62, 30, 62, 200))))
    assert mended is not None and iou(mended, true) > 0.95
    again = cut_out(image, Hints((150, 245, 50, 20)))  # corners in any order, and always the same answer
    assert again is not None and np.array_equal(again, rough)


def test_strokes_rule() -> None:
    image = scene()
    without_head = cut_out(
        image, Hints((50, 20, 150, 245), (line(False, 85, 40, 115, 40), line(False, 85, 55, 115, 55)))
    )
    assert without_head is not None and not without_head[50:60, 95:105].any()
    everything = cut_out(image, Hints((50, 20, 150, 245), (line(True, 180, 100, 130, 120),)))
    assert everything is not None and everything[100:104, 170:180].any()


def test_an_earlier_silhouette_is_mended_along_its_edge() -> None:
    image, true = scene(), person()
    kernel = np.ones((7, 7), np.uint8)
    known = cv2.dilate(true.astype(np.uint8), kernel) > 0
    found = cut_out(image, Hints(), known)
    assert found is not None and iou(found, true) > max(0.95, iou(known, true))


def test_a_large_image_is_cut_small_and_enlarged(monkeypatch: pytest.MonkeyPatch) -> None:
    image, true = (cv2.resize(a, None, fx=3, fy=3) for a in (scene(), person().astype(np.uint8)))
    monkeypatch.setattr(cutout, "_LARGEST", 260)
    found = cut_out(image, Hints((150, 60, 450, 735)))
    assert found is not None and found.shape == true.shape and iou(found, true > 0) > 0.9


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ({"view": "behind"}, "front, side"),
        ({"view": []}, "front, side"),
        ({"view": "front", "strokes": [{"inside": True, "points": [9, 9]}]}, "rectangle around"),
        ({"view": "front", "rectangle": [1, 2, 3]}, "two corners"),
        ({"view": "front", "rectangle": [5, 5, 5, 90]}, "larger than two"),
        ({"view": "front", "rectangle": [1, 2, float("nan"), 9]}, "finite"),
        ({"view": "front", "rectangle": [1, 2, 10**20, 9]}, "finite"),
        ({"view": "front", "rectangle": [1, 2, 10**400, 9]}, "finite"),
        ({"view": "front", "rectangle": [9, 9, 99, 99], "strokes": [3]}, "object"),
        ({"view": "front", "rectangle": [9, 9, 99, 99], "strokes": [{"points": [1]}]}, "x, y, x, y"),
    ],
)
def test_poor_questions_are_told(keyviews: Path, question: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        cutting_of(keyviews).cut(question)


def test_masks_are_written_where_the_file_reads_them(keyviews: Path) -> None:
    cutting = cutting_of(keyviews)
    with pytest.raises(InputError, match="nothing to save"):
        cutting.save({})
    for role in ("front", "side"):
        answer = cutting.cut({"view": role, "rectangle": [50, 20, 150, 245], "strokes": []})
        assert answer["outline"] and 0.1 < answer["fraction"] < 0.5
    saved = cutting.save({})
    assert [Path(path).name for path in saved["saved"]] == ["anna_front_mask.png", "side_mask.png"]
    assert saved["note"] == 'Put mask = "anna_front_mask.png" into [views.front].'
    for path in saved["saved"]:
        assert iou(cv2.imread(path, cv2.IMREAD_GRAYSCALE) > 127, person()) > 0.9
    again = cutting_of(keyviews)  # opened anew: the masks are there to be mended
    assert all(view["outline"] for view in again.document()["views"])
    assert again.cut({"view": "side"})["outline"]


def test_what_is_cleared_is_not_saved(keyviews: Path) -> None:
    cutting, rectangle = cutting_of(keyviews), [50, 20, 150, 245]
    assert cutting.cut({"view": "front", "rectangle": rectangle})["cut"]
    cleared = cutting.cut({"view": "front", "rectangle": None, "strokes": []})
    assert cleared == {"view": "front", "outline": [], "fraction": 0.0, "cut": False}
    with pytest.raises(InputError, match="nothing to save"):
        cutting.save({})
    cutting.cut({"view": "side", "rectangle": rectangle})
    cutting.save({})
    again = cutting_of(keyviews)  # what there was before is shown again, and not written
    before = again.document()["views"][1]["outline"]
    stroke = {"inside": False, "points": [62, 30, 62, 200], "width": 6}
    assert again.cut({"view": "side", "strokes": [stroke]})["cut"]
    assert again.cut({"view": "side"})["outline"] == before
    with pytest.raises(InputError, match="nothing to save"):
        again.save({})


def test_what_is_shown_is_saved_and_never_nothing(keyviews: Path) -> None:
    big = cv2.resize(scene()[..., ::-1], None, fx=4, fy=4)
    cv2.imwrite(str(keyviews.parent / "front.png"), big)
    K = np.array([[1200.0, 0, 399.5], [0, 1200.0, 519.5], [0, 0, 1]])
    views = [Camera(n, K, look_at(eye, [0, 0, 1.0], (0, 0, 1)), (800, 1040)) for n, eye in (("a", [4, 0, 1]),)]
    write_rig(Rig(tuple(views)), keyviews.parent / "c.toml")
    keyviews.write_text('calibration = "c.toml"\n[views.front]\ncamera = "a"\nimage = "front.png"\n')
    cutting = cutting_of(keyviews)
    shown = cutting.cut({"view": "front", "rectangle": [200, 80, 600, 980]})
    (path,) = cutting.save({})["saved"]
    mask = cv2.imread(path, cv2.IMREAD_GRAYSCALE) > 127
    assert outline(mask) == shown["outline"]
    assert iou(mask, cv2.resize(person().astype(np.uint8), (800, 1040)) > 0) > 0.9
    over = {"inside": False, "points": [400, 80, 400, 980], "width": 500}
    with pytest.raises(InputError, match="nothing of the person is left"):
        cutting.cut({"view": "front", "rectangle": [200, 80, 600, 980], "strokes": [over]})
    with pytest.raises(InputError, match="nothing to save"):
        cutting.save({})


def test_a_mask_that_cannot_be_written_is_told_plainly(keyviews: Path) -> None:
    cutting = cutting_of(keyviews)
    cutting.cut({"view": "side", "rectangle": [50, 20, 150, 245]})
    (keyviews.parent / "side_mask.png").mkdir()
    with pytest.raises(InputError, match=r"side_mask.png cannot be written: [^\[\]]+\.$"):
        cutting.save({})


@pytest.mark.parametrize("mask", ["front.png", "./side.png", "anna_front_mask.png"])
def test_a_mask_must_not_lie_where_another_picture_does(keyviews: Path, mask: str) -> None:
    keyviews.write_text(keyviews.read_text().replace("side_mask.png", mask))
    with pytest.raises(InputError, match=r"anna.toml: \[views\.\w+\]: `mask` .* is another picture too"):
        cutting_of(keyviews)


def test_a_file_without_pictures_is_told(keyviews: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keyviews.write_text('calibration = "c.toml"\n[views.front]\ncamera = "a"\nmask = "m.png"\n')
    assert run("body", "silhouettes", keyviews) == 2
    assert "no view names an `image`" in capsys.readouterr().err


def on_screen(browser: Browser, x: float, y: float) -> tuple[float, float]:
    matrix = "document.querySelector('#stage svg').getScreenCTM()"
    at = browser.run(f"(p => [p.x, p.y])(new DOMPoint({x} + 0.5, {y} + 0.5).matrixTransform({matrix}))")
    return at[0], at[1]


@needs_browser
def test_drawing_cuts_and_saves(keyviews: Path, tmp_path: Path) -> None:
    cutting = cutting_of(keyviews)
    with served(page("cut", "test", cutting.document()), cutting.answers) as url, Browser() as browser:

        def drawn(start: tuple[float, float], end: tuple[float, float]) -> list[float]:
            before = int(browser.run("document.body.dataset.cuts ?? 0"))
            browser.drag(on_screen(browser, *start), on_screen(browser, *end))
            browser.wait(f"+document.body.dataset.cuts > {before} && document.body.dataset.busy === 'no'")
            return browser.run("twistcapCut.view('front').outline[0]")

        browser.open(url)
        first = drawn((50, 20), (150, 245))
        assert len(first) > 20
        box = browser.run("twistcapCut.view('front').rectangle")
        np.testing.assert_allclose(box, (50, 20, 150, 245), atol=1.0)
        assert has_colour(picture(browser, tmp_path / "cut.png"), (41, 211, 255), 30)
        browser.run("document.querySelector('[data-tool=outside]').click()")
        headless = drawn((80, 42), (120, 42))  # the head painted away, and given back
        assert min(headless[1::2]) > min(first[1::2]) + 10
        browser.run("document.getElementById('undo').click()")
        browser.wait("twistcapCut.view('front').strokes.length === 0 && document.body.dataset.busy === 'no'")
        np.testing.assert_allclose(browser.run("twistcapCut.view('front').outline[0]"), first)
        browser.run("document.querySelector('[data-view=side]').click()")
        browser.drag(on_screen(browser, 50, 20), on_screen(browser, 150, 245))
        browser.wait("twistcapCut.view('side').cut && document.body.dataset.busy === 'no'")
        browser.run("document.getElementById('save').click()")
        browser.wait("document.body.dataset.saved")
        picture(browser, tmp_path / "saved.png")
        assert browser.problems == []
    for name in ("anna_front_mask.png", "side_mask.png"):
        mask = cv2.imread(str(keyviews.parent / name), cv2.IMREAD_GRAYSCALE) > 127
        assert iou(mask, person()) > 0.9


@needs_browser
def test_questions_wait_for_their_turn(keyviews: Path) -> None:
    cutting, gate = cutting_of(keyviews), threading.Event()
    asked: list[tuple[str, int]] = []  # view and number of strokes; of a save "", 0

    def cut(question: Any) -> Any:
        gate.wait(20)
        asked.append((question["view"], len(question["strokes"])))
        return cutting.cut(question)

    def save(question: Any) -> Any:
        asked.append(("", 0))
        return cutting.save(question)

    with served(page("cut", "test", cutting.document()), {"/cut": cut, "/save": save}) as url, Browser() as browser:

        def drag(*ends: float) -> None:
            browser.drag(on_screen(browser, *ends[:2]), on_screen(browser, *ends[2:]))

        browser.open(url)
        drag(50, 20, 150, 245)  # asked at once, and answered when the gate opens
        drag(100, 50, 100, 150)
        drag(100, 60, 100, 160)  # in place of the stroke before
        browser.run("document.querySelector('[data-view=side]').click()")
        drag(50, 20, 150, 245)
        for _ in range(2):
            browser.run("document.getElementById('save').click()")
        drag(100, 50, 100, 150)  # after the save, not in place of what it waits for
        gate.set()
        browser.wait("document.body.dataset.busy === 'no'")
        assert asked == [("front", 0), ("front", 2), ("side", 0), ("", 0), ("side", 1)]
        browser.run("document.getElementById('clear').click()")
        browser.wait("document.body.dataset.busy === 'no'")
        assert browser.run("twistcapCut.view('side').cut === false && twistcapCut.view('side').outline.length === 0")
        assert list(cutting.masks) == ["front"]
        assert browser.problems == []
