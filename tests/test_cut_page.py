"""Silhouettes cut out by hand: the cut itself, the questions, and the page from the first stroke to the saved mask."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from browser import Browser
from pages_shared import has_colour, needs_browser, picture, run, served
from twistcap.camera import Camera, Rig, look_at
from twistcap.commands.body import cutting_of
from twistcap.errors import InputError
from twistcap.io.calibration import write_rig
from twistcap.keyviews.cutout import Hints, Stroke, cut_out
from twistcap.pages.assemble import page
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


def test_a_large_image_is_cut_small_and_enlarged() -> None:
    image, true = (cv2.resize(a, None, fx=3, fy=3) for a in (scene(), person().astype(np.uint8)))
    found = cut_out(image, Hints((150, 60, 450, 735)), largest=260)
    assert found is not None and found.shape == true.shape and iou(found, true > 0) > 0.9


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ({"view": "behind"}, "front, side"),
        ({"view": "front"}, "rectangle around"),
        ({"view": "front", "rectangle": [1, 2, 3]}, "two corners"),
        ({"view": "front", "rectangle": [5, 5, 5, 90]}, "larger than two"),
        ({"view": "front", "rectangle": [1, 2, float("nan"), 9]}, "finite"),
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
        assert answer["outline"] and 0.1 < answer["share"] < 0.5
    saved = cutting.save({})
    assert [Path(path).name for path in saved["saved"]] == ["anna_front_mask.png", "side_mask.png"]
    assert saved["note"] == 'Put mask = "anna_front_mask.png" into [views.front].'
    for path in saved["saved"]:
        assert iou(cv2.imread(path, cv2.IMREAD_GRAYSCALE) > 127, person()) > 0.9
    again = cutting_of(keyviews)  # opened anew: the masks are there to be mended
    assert all(view["outline"] for view in again.document()["views"])
    assert again.cut({"view": "side"})["outline"]


def test_a_file_without_pictures_is_told(keyviews: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keyviews.write_text('calibration = "c.toml"\n[views.front]\ncamera = "a"\nmask = "m.png"\n')
    assert run("body", "silhouettes", keyviews) == 2
    assert "no view names an `image`" in capsys.readouterr().err


@needs_browser
def test_drawing_cuts_and_saves(keyviews: Path, tmp_path: Path) -> None:
    cutting = cutting_of(keyviews)
    with served(page("cut", "test", cutting.document()), cutting.answers) as port, Browser() as browser:

        def on_screen(x: float, y: float) -> tuple[float, float]:
            matrix = "document.querySelector('#stage svg').getScreenCTM()"
            at = browser.run(f"(p => [p.x, p.y])(new DOMPoint({x} + 0.5, {y} + 0.5).matrixTransform({matrix}))")
            return at[0], at[1]

        def drawn(start: tuple[float, float], end: tuple[float, float]) -> list[float]:
            before = int(browser.run("document.body.dataset.cuts ?? 0"))
            browser.drag(on_screen(*start), on_screen(*end))
            browser.wait(f"+document.body.dataset.cuts > {before} && document.body.dataset.busy === 'no'")
            return browser.run("twistcapCut.view('front').outline[0]")

        browser.open(f"http://127.0.0.1:{port}/")
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
        browser.drag(on_screen(50, 20), on_screen(150, 245))
        browser.wait("twistcapCut.view('side').cut && document.body.dataset.busy === 'no'")
        browser.run("document.getElementById('save').click()")
        browser.wait("document.body.dataset.saved")
        picture(browser, tmp_path / "saved.png")
        assert browser.problems == []
    for name in ("anna_front_mask.png", "side_mask.png"):
        mask = cv2.imread(str(keyviews.parent / name), cv2.IMREAD_GRAYSCALE) > 127
        assert iou(mask, person()) > 0.9
