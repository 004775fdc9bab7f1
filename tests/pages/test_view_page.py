"""The viewer's page, what both pages are made of, and the server that gives them."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from support.box import hinged_box
from support.browser import Browser
from support.pages_shared import (
    FRAMES,
    asked,
    has_colour,
    needs_browser,
    paper,
    picture,
    run,
    served,
    shows_a_body,
    studio_walk,
    unreachable,
)
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, look_at
from twistcap.errors import InputError
from twistcap.evaluate.load import load_reference
from twistcap.io.coordinates import coordinates_of
from twistcap.io.result import ResultWriter, read_result
from twistcap.pages.assemble import packed, page
from twistcap.pages.outlines import body_outlines
from twistcap.pages.server import page_server


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return studio_walk(tmp_path_factory.mktemp("studio") / "walk")


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


def test_the_server_answers_this_machine_alone() -> None:
    def answer(question: Any) -> Any:
        if "bad" in question:
            raise InputError("one clear sentence.")
        return {"twice": 2 * question["n"]}

    with served("<p>page", {"/double": answer}) as url:
        assert asked(url, "/") == (200, "<p>page")
        assert json.loads(asked(url, "/double", '{"n": 4}')[1]) == {"twice": 8}
        assert json.loads(asked(url, "/double", '{"bad": 1}')[1]) == {"error": "one clear sentence."}
        assert "error" in json.loads(asked(url, "/double", "[1")[1])
        assert asked(url, "/else")[0] == 404
        assert asked(url, "/double", "n=1", **{"Content-Type": "text/plain"})[0] == 404  # what a foreign form can send
        assert asked(url, "/", Host="evil.example")[0] == 404
        with pytest.raises(InputError, match="--port"):
            page_server("", port=urlsplit(url).port or 0)


# ---- viewer ----


@pytest.fixture(scope="module")
def saved(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("view") / "both.html"
    results = [made / name / "result.h5" for name in ("one", "two")]
    assert run("view", *results, "--reference", made / "truth.npz", "--save", out, "--images", 120) == 0
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
        assert browser.run("document.querySelectorAll('.plot').length") == len(result.body.coordinate_names)
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
def test_the_plots_show_the_angles_of_the_exports(made: Path, saved: Path) -> None:
    result = read_result(made / "one" / "result.h5")
    truth = load_reference(made / "truth.npz", result.body, lambda count: result.times[:count])
    table = coordinates_of(result.body, result.poses, result.covariances)
    own = [table.names.index(name) for name in result.body.coordinate_names]
    with Browser() as browser:
        browser.open(saved.as_uri())
        shown = [browser.run(f"Array.from(twistcapView.runs[0].{name})") for name in ("angles", "sigma")]
        reference = np.array(
            browser.run("JSON.parse(document.getElementById('data').textContent).reference.angles_deg"), float
        )
    for values, expected in zip(shown, table.in_degrees, strict=True):
        np.testing.assert_allclose(np.reshape(values, (len(result), -1)), expected[:, own], atol=1e-4)
    k = truth.coordinate_names.index("pro_sup_r")
    np.testing.assert_allclose(reference[:, k], np.degrees(truth.angles[:FRAMES, k]) + 90.0, atol=0.01)


@needs_browser
def test_the_viewer_tells_limbs_and_cameras(saved: Path) -> None:
    with Browser() as browser:
        browser.open(saved.as_uri())

        def seen(frame: int) -> tuple[str, list[str], int]:
            browser.run(f"twistcapView.seek({frame})")
            notes = browser.run("Array.from(document.querySelectorAll('.view b'), (note) => note.textContent)")
            text = browser.run("document.getElementById('frame-note').textContent")
            return text, notes, browser.run("document.querySelectorAll('.view.out').length")

        text, notes, out = seen(0)
        assert text.startswith("height: probability of loss") and out == 0
        assert seen(2) == ("one: lost: left arm (probability 0.90)", notes, 0)
        text, notes, out = seen(3)
        assert text == "one: lost: left arm (probability 0.90); camera cam02 is left out"
        assert ["left out" in note for note in notes] == [False, True, False] and out == 1
        told = browser.run("document.querySelector('details').textContent")
        assert "2 of 6 frames lost: 2–3 (left arm)" in told and "camera cam02 was left out in 1 frame: 3" in told
        x, y, w, h = browser.run("(({x, y, width, height}) => [x, y, width, height])(marks.getBoundingClientRect())")
        browser.mouse("mouseMoved", x + w - 8, y + h / 2)
        browser.drawn()
        title = browser.run("document.getElementById('marks').title")
        assert "frame 5" in title and "one: probability of loss 0.10 (left arm 0.10, head 0.05" in title
        browser.click(x + 8 + 0.4 * (w - 16), y + h / 2)
        assert browser.run("twistcapView.state.frame") == 2
        assert browser.problems == []


@needs_browser
def test_the_viewer_fits_a_phone(saved: Path) -> None:
    with Browser((390, 844)) as browser:
        browser.open(saved.as_uri())
        browser.run("twistcapView.seek(3)")
        assert browser.run("document.documentElement.scrollWidth") <= 390
        assert browser.run("document.getElementById('marks').clientWidth") > 300
        assert browser.run("document.getElementById('frame-note').getBoundingClientRect().bottom") <= 844


SIZES = ((390, 844), (1280, 800), (3840, 2160))


@needs_browser
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_control_of_the_viewer_is_reached(
    saved: Path, size: tuple[int, int], scheme: str, tmp_path: Path
) -> None:
    with Browser(size) as browser:
        browser.prefer(scheme)
        browser.open(saved.as_uri())
        assert unreachable(browser) == []
        assert browser.run("document.documentElement.scrollWidth") <= size[0]
        assert browser.run("slider.clientWidth") > 0.15 * size[0]
        tiles = browser.run("[...document.querySelectorAll('#views .view')].map(t => t.getBoundingClientRect().bottom)")
        assert max(tiles) <= browser.run("views.getBoundingClientRect().bottom") + 1  # none is cut off
        browser.run("scrollTo(0, 0)")
        assert (paper(browser, tmp_path / "page.png") < 60) == (scheme == "dark")
        browser.click(*browser.centre("#theme"))
        assert (paper(browser, tmp_path / "other.png") < 60) == (scheme == "light")
        bright = "parts.map(p => p.getStyle().match(/\\d+/g).slice(0, 3).reduce((a, b) => a + +b / 765, 0))"
        parts = "[twistcapView.scene.ground(), first.name.material.color, first.edges.material.color]"
        ground, *drawn = browser.run(f"(first => (parts => {bright})({parts}))(twistcapView.scene.frusta[0])")
        assert min(abs(one - ground) for one in drawn) > 0.3  # cameras stand out from the ground, dark or light
        assert browser.problems == []


@needs_browser
def test_keys_work_after_play_was_clicked(saved: Path) -> None:
    with Browser() as browser:
        browser.open(saved.as_uri())
        for _ in range(2):
            browser.click(*browser.centre("#play"))
        assert browser.run("document.activeElement.id") == "play" and not browser.run("twistcapView.state.playing")
        browser.run("twistcapView.seek(1)")
        for key, code, frame in (("ArrowRight", 39, 2), ("ArrowLeft", 37, 1), ("End", 35, FRAMES - 1), ("Home", 36, 0)):
            browser.key(key, code)
            assert browser.run("twistcapView.state.frame") == frame
        browser.key(" ", 32, " ")  # of the button: it plays, once
        assert browser.run("twistcapView.state.playing")
        browser.run("document.activeElement.blur()")
        browser.key(" ", 32, " ")
        assert not browser.run("twistcapView.state.playing")
        browser.run("twistcapView.seek(0); slider.focus()")
        browser.key("ArrowRight", 39)
        assert browser.run("twistcapView.state.frame") == 1  # once, not twice
        eye = "document.querySelector('#scene canvas').toDataURL()"
        browser.drawn()
        before = browser.run(eye)
        browser.run("document.querySelector('#scene canvas').focus()")
        browser.key("ArrowUp", 38)
        browser.drawn()
        assert browser.run(eye) != before and browser.run("twistcapView.state.frame") == 1
        assert browser.problems == []


@needs_browser
def test_plots_read_out_zoom_and_resize(made: Path, saved: Path) -> None:
    result = read_result(made / "one" / "result.h5")
    with Browser() as browser:
        browser.open(saved.as_uri())
        browser.run("twistcapView.seek(3)")
        plot = "[data-coordinate=lumbar_bending]"
        text = browser.run(f"document.querySelector('{plot} output').textContent")
        angle, sigma = (np.degrees(v[3, result.body.coordinate("lumbar_bending")]) for v in (result.q, result.sigmas))
        assert f"{angle:.1f}° ± {2 * sigma:.1f}°" in text and "reference" in text
        x, y = browser.centre(f"{plot} .u-over")
        browser.mouse("mouseMoved", x, y, "none")
        browser.drawn()
        assert " at 0.0" in browser.run(f"document.querySelector('{plot} output').textContent")
        browser.drag((x - 40, y), (x + 40, y))
        browser.drawn()
        low, high = browser.run("twistcapView.shown()")
        assert 0 < low < high < 5 / 60
        ranges = "p => [p.plot.scales.x.min, p.plot.scales.x.max]"
        shown = browser.run(f"twistcapView.plots.filter(p => p.plot).map({ranges})")
        np.testing.assert_allclose(shown, [[low, high]] * len(shown))  # all plots together
        browser.click(*browser.centre("#zoom-all"))
        browser.drawn()
        np.testing.assert_allclose(browser.run("twistcapView.shown()"), [0, 5 / 60], atol=1e-5)
        browser.click(*browser.centre("#zoom-in"))
        browser.drawn()
        assert np.ptp(browser.run("twistcapView.shown()")) < 4.5 / 60
        units = browser.run("twistcapView.plots[0].plot.axes.map(a => a._values[0])")
        assert units[0].endswith(" s") and units[1].endswith("°")
        wide = browser.run(f"document.querySelector('{plot} canvas').clientWidth")
        browser.resize(500, 900)
        browser.wait(f"Math.abs(document.querySelector('{plot} canvas').clientWidth - {wide}) > 60")
        assert browser.run("document.documentElement.scrollWidth") <= 500
        assert browser.problems == []


@needs_browser
def test_lost_frames_have_no_say_in_the_plots_of_others(made: Path, tmp_path: Path) -> None:
    """Their σ is that of a guess: with it all curves would be flat. An arm that turns there leaves no whole turn."""
    short = read_result(made / "one" / "result.h5")
    q, flex = short.q.copy(), short.body.coordinate("arm_flex_r")
    assert np.flatnonzero(~short.known).tolist() == [2, 3]
    q[2:4, flex] = np.radians([170.0, -20.0])
    wide = replace(short, q=q, covariances=np.where(~short.known[:, None, None], 1e4, 1.0) * short.covariances)
    with ResultWriter(tmp_path / "result.h5", short.body, short.rig, short.config) as writer:
        for own in wide.estimates:
            writer.append(own)
    assert run("view", tmp_path / "result.h5", "--save", tmp_path / "wide.html") == 0
    angles = coordinates_of(short.body, short.poses, short.covariances, known=short.known).in_degrees
    k = coordinates_of(short.body, short.poses).names.index("lumbar_bending")
    values, sigmas = (columns[short.known, k] for columns in angles)
    with Browser() as browser:
        browser.open((tmp_path / "wide.html").as_uri())
        one = "twistcapView.plots.find(p => p.name === 'lumbar_bending').plot"
        browser.wait(one)
        low, high = browser.run(f"(({{ min, max }}) => [min, max])({one}.scales.y)")
        lowest, highest = (values - 2 * sigmas).min(), (values + 2 * sigmas).max()
        assert low < lowest and highest < high < low + max(1.2 * (highest - lowest), 12.0)
        browser.run(f"{one}.setScale('x', {{ min: 1.9 / 60, max: 2.1 / 60 }})")  # a lost frame alone
        browser.drawn()
        np.testing.assert_allclose(browser.run(f"{one}.scales.y.max"), high)
        arm = browser.run("twistcapView.plots.find(p => p.name === 'arm_flex_r').curves.read.map(v => v(5)[1])")
        assert abs(float(arm[0].split("°")[0])) < 90
        assert browser.problems == []


@pytest.fixture(scope="module")
def long(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of 6 000 frames; every seventh is ten times as uncertain as the others."""
    folder = tmp_path_factory.mktemp("long")
    short, path = read_result(made / "one" / "result.h5"), folder / "result.h5"
    with ResultWriter(path, short.body, short.rig, short.config, room=6000) as writer:
        for k in range(6000):
            own = short.estimates[k % FRAMES]
            unsure = 100 * own.covariance if k % 7 == 0 else own.covariance
            writer.append(replace(own, index=k, time=k / 60, covariance=unsure))
    assert run("view", path, "--save", folder / "long.html", "--session", made / "session.toml") == 0
    return folder / "long.html"


@needs_browser
def test_a_long_recording_shows_the_body_and_draws_it_once_a_picture(long: Path) -> None:
    """However often frames are wanted: software takes 0.1 s or more to draw the body."""
    with Browser((1280, 800)) as browser:
        browser.first_picture(long.as_uri(), shows_a_body)
        browser.wait("document.body.dataset.ready === 'yes'")
        once = "new Promise((done) => requestAnimationFrame(() => setTimeout(done)))"
        seeks = "for (let k = 0; k < 5; k++) twistcapView.seek(1000 * k)"
        count = f"await {once}; const n = twistcapView.scene.drawn(); {seeks}; await {once}"
        assert browser.run(f"(async () => {{ {count}; return twistcapView.scene.drawn() - n; }})()") == 1
        assert browser.problems == []


@needs_browser
def test_bands_are_bands_at_any_length(long: Path) -> None:
    """Each column of pixels has the band of its most uncertain frame, not a spike beside an empty column."""
    with Browser((1280, 800)) as browser:
        browser.open(long.as_uri())
        browser.wait("twistcapView.plots[0].plot")
        row = """(({ plot }) => {
            const { left, width } = plot.bbox, angles = plot.data[3], sigma = (plot.data[1][0] - angles[0]) / 2;
            const y = Math.round(plot.valToPos(Math.max(...angles.slice(0, 12)) + sigma, "y", true));
            return [...plot.ctx.getImageData(left, y, width, 1).data];
        })(twistcapView.plots[0])"""
        pixels = np.reshape(browser.run(row), (-1, 4))
        assert ((pixels[:, 3] > 40) & (pixels[:, 2] - pixels[:, 0] > 60)).mean() > 0.95
        browser.run("twistcapView.seek(3000); for (let k = 0; k < 12; k++) document.getElementById('zoom-in').click()")
        assert browser.problems == []


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


def test_images_that_only_the_result_names_are_shown_when_asked_for(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stranger's result may name any file of this machine."""
    out = tmp_path / "a.html"
    assert run("view", made / "one" / "result.h5", "--save", out) == 0
    assert "image/jpeg" not in out.read_text() and "no images: the result names" in capsys.readouterr().err
    assert run("view", made / "one" / "result.h5", "--save", out, "--session", made / "session.toml") == 0
    assert "image/jpeg" in out.read_text() and "camera cam02: images of" in capsys.readouterr().err


def test_a_result_without_videos_is_shown_without_images(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, bare, empty = read_result(made / "one" / "result.h5"), tmp_path / "bare.h5", tmp_path / "empty.h5"
    for path, estimates in ((bare, result.estimates), (empty, ())):
        with ResultWriter(path, result.body, result.rig, {}) as writer:
            for estimate in estimates:
                writer.append(estimate)
    assert run("view", bare, empty, "--save", tmp_path / "bare.html", "--images", 9) == 0
    assert "cam02: its video  is not found" in capsys.readouterr().err
    found = re.search(r'id="data">(.*?)</script>', (tmp_path / "bare.html").read_text(), re.S)
    assert found is not None
    document = json.loads(found[1])
    assert document["shown"] == [] and document["cameras"][0]["images"] == []
    assert document["runs"][1]["rows"] == [-1] * FRAMES  # a run that was killed before its first frame
    run_of = document["runs"][0]
    assert run_of["lost"] == [0, 0, 1, 1, 0, 0] and run_of["probability"][2] == 0.9
    assert run_of["notes"][2] == "lost: left arm (probability 0.90)" and run_of["cameras"][3] == ["", "left out", ""]
    assert document["runs"][1]["statements"] == []


def test_a_view_says_what_is_wrong(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = made / "one" / "result.h5"
    empty = tmp_path / "empty.h5"
    with ResultWriter(empty, humanoid(), read_result(result).rig, {}):
        pass
    for arguments, words in (
        ((tmp_path / "none.h5",), "does not exist"),
        ((result, result), "twice"),
        ((result, "--reference", tmp_path / "none.trc"), "does not exist"),
        ((result, "--save", "/proc/no/page.html"), "folder /proc/no cannot be made"),
        ((result, "--session", tmp_path / "none.toml"), "cannot be read"),
        ((empty,), f"{empty} has no frame"),
    ):
        assert run("view", *arguments) == 2
        told = capsys.readouterr().err.strip().splitlines()[-1]
        assert words in told and told.startswith("twistcap:")
