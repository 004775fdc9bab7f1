"""Overlays, plots and the report page: they show what they are given, where it is."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from support.box import BOX, hinged_box
from twistcap import se3
from twistcap.arrays import AnyArray
from twistcap.body import Pose, Posed
from twistcap.body.model import split_side
from twistcap.camera import Camera, Rig, look_at
from twistcap.estimate import Estimate, Frame
from twistcap.evaluate.metrics import row
from twistcap.report import plots
from twistcap.report.overlay import (
    LOST,
    _label,
    bones_of,
    draw_overlay,
    mosaic_for,
    overlay_video,
    part_colours,
    visible_projection,
)
from twistcap.report.page import Figure, Statement, headline_rows, number, write_report
from twistcap.report.plots import AngleSeries, angle_plot, cycle_plot, envelope, joint_error_plot, spans

CHROMIUM = Path("/usr/bin/chromium")


NO_BONES = (np.zeros(0, np.int32), np.zeros((0, 2, 3)))


def camera(name: str = "cam01", dist: tuple[float, ...] = (0.0,) * 5, angle: float = 0.2) -> Camera:
    K = np.array([[150.0, 0, 80], [0, 150.0, 60], [0, 0, 1]])
    eye = (2.5 * np.cos(angle), 2.5 * np.sin(angle), 0.4)
    return Camera(name, K, look_at(eye, (0, 0, 0)), (161, 121), np.array(dist))


def plain(camera_: Camera, value: int = 128) -> AnyArray:
    return np.full((camera_.size[1], camera_.size[0], 3), value, np.uint8)


@pytest.mark.parametrize("dist", [(0.0,) * 5, (-0.3, 0.0, 0.0, 0.0, 0.0)])
def test_overlay_lies_where_the_camera_sees_the_body(dist: tuple[float, ...]) -> None:
    body, cam = hinged_box(), camera(dist=dist)
    image = plain(cam)
    out = draw_overlay(image, cam, Posed(body, Pose.rest(body)), bones=NO_BONES)
    changed = np.argwhere((out != image).any(axis=-1))[:, ::-1]
    corners, _ = cam.project(BOX)
    reach = 4.0  # the dark rim outside the silhouette
    np.testing.assert_allclose(changed.min(axis=0), corners.min(axis=0), atol=reach)
    np.testing.assert_allclose(changed.max(axis=0), corners.max(axis=0), atol=reach)
    assert (image == 128).all()  # the input is left alone


def test_a_lost_body_is_red_and_a_dropped_frame_is_dark() -> None:
    body, cam = hinged_box(), camera()
    posed = Posed(body, Pose.rest(body))
    centre = (round(cam.project([0, 0, 0.2])[0][1]), round(cam.project([0, 0, 0.2])[0][0]))
    fine = draw_overlay(plain(cam), cam, posed, opacity=1, bones=NO_BONES)[centre].astype(int)
    lost = draw_overlay(plain(cam), cam, posed, True, opacity=1, bones=NO_BONES)[centre].astype(int)
    assert np.ptp(fine) < 20  # the pelvis is neutral
    np.testing.assert_allclose(lost / lost[0], np.array(LOST) / LOST[0], atol=0.02)
    dropped = draw_overlay(None, cam, posed)
    assert dropped.shape == (121, 161, 3)
    assert (dropped[0, 0] == 40).all()


def test_a_body_behind_the_camera_draws_nothing() -> None:
    body, cam = hinged_box(), camera()
    behind = Pose(se3.transform(np.eye(3), (10.0, 2.0, 0.0)), np.zeros(1))
    np.testing.assert_array_equal(draw_overlay(plain(cam), cam, Posed(body, behind)), plain(cam))


def test_points_beyond_the_fold_of_the_distortion_are_unseen() -> None:
    cam = camera(dist=(-0.4, 0.0, 0.0, 0.0, 0.0))
    right = cam.T_cam_world[0, :3]
    points = np.array([[0.0, 0, 0], right * 1.0, right * 5.0])  # the last one is folded back to near the image
    assert (visible_projection(cam, points)[1] > 0).tolist() == [True, True, False]


def test_bones_join_the_joints_and_move_with_the_body() -> None:
    body = hinged_box()
    segments, ends = bones_of(body)
    knee = Posed(body, Pose(np.eye(4), np.array([np.pi / 2])))
    moved = se3.apply(knee.segment_transforms[segments], ends)
    tips = [end.round(6).tolist() for _, end in moved]
    assert [-0.6, 0.0, 0.0] in tips  # the toe, 0.6 m below the hinge, swings back
    assert len(part_colours(body)) == 2


def test_mosaics_use_the_page_well() -> None:
    wide = mosaic_for(Rig(tuple(Camera(f"c{i}", np.eye(3), np.eye(4), (384, 280)) for i in range(4))))
    tall = mosaic_for(Rig(tuple(Camera(f"c{i}", np.eye(3), np.eye(4), (1080, 1920)) for i in range(4))))
    assert (wide.columns, wide.rows) == (2, 2)
    assert (tall.columns, tall.rows) == (4, 1)
    assert all(length % 2 == 0 for length in (*wide.size, *tall.size))


def test_a_title_keeps_letters_with_accents() -> None:
    canvases = np.full((2, 60, 400, 3), 90, np.uint8)
    for canvas, text in zip(canvases, ("Sessiön à 90°", "Session a 90 deg"), strict=True):
        _label(canvas, text, (10, 40))
    assert np.ptp(canvases) > 100
    np.testing.assert_array_equal(canvases[0], canvases[1])


def test_overlay_video_plays_in_browsers(tmp_path: Path) -> None:
    body, rig = hinged_box(), Rig((camera("a"), camera("b", angle=1.5)))
    frames = [Frame(k, k / 30, (plain(rig[0]), None if k == 2 else plain(rig[1]))) for k in range(5)]
    estimates = [Estimate(k, k / 30, Pose.rest(body), np.eye(7), lost=k == 3) for k in range(4)]
    path = overlay_video(tmp_path / "overlay.mp4", frames, rig, estimates, body, 30, "test")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        images = [image.to_ndarray(format="rgb24").astype(float) for image in container.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
    assert len(images) == 5
    redness = [float((image[..., 0] - image[..., 2]).clip(0).mean()) for image in images]
    assert redness[3] > 3 * redness[0]  # the lost frame
    assert images[4].std() < images[0].std()  # the frame without a pose is bare


def test_spans_reach_half_way_to_the_neighbours() -> None:
    times = np.arange(6.0)
    assert spans(times, np.array([1, 0, 0, 1, 1, 0], bool)) == [(0.0, 0.5), (2.5, 4.5)]
    assert spans(times, np.zeros(6, bool)) == []
    assert spans(times, np.ones(6, bool)) == [(0.0, 5.0)]
    assert split_side("knee_angle_r") == ("knee_angle", "r")
    assert split_side("lumbar_extension") == ("lumbar_extension", "")


def _has_colour(image: AnyArray, rgb: tuple[int, int, int], tolerance: int = 40) -> bool:
    return bool((np.abs(image.astype(int) - rgb).max(axis=-1) < tolerance).sum() > 50)


def test_plots_show_both_sides_and_lost_frames(tmp_path: Path) -> None:
    times = np.arange(30) / 30
    angles = np.stack([np.sin(6 * times), np.cos(6 * times), 0 * times], axis=1)
    series = AngleSeries(times, ("knee_angle_r", "knee_angle_l", "lumbar_bending"), angles, np.full_like(angles, 0.1))
    lost = (times > 0.4) & (times < 0.6)
    picture = cv2.imread(str(angle_plot(tmp_path / "a.png", series, series, lost)))[..., ::-1]
    right, left, middle, red = (232, 121, 12), (23, 128, 214), (61, 143, 109), (249, 214, 215)
    assert all(_has_colour(picture, colour, 12) for colour in (right, left, middle, red))
    errors = np.abs(angles) * 10
    errors[3] = np.nan
    errors[4] = np.inf
    picture = cv2.imread(str(joint_error_plot(tmp_path / "c.png", times, ("knee_r", "knee_l", "hip_r"), errors)))
    assert _has_colour(picture[..., ::-1], right, 12)


@pytest.mark.filterwarnings("error")
def test_names_with_dollar_signs_are_no_formulas(tmp_path: Path) -> None:
    """Importers make names of joints such as `Hips_$AssimpFbx$_Rotation`."""
    names, times = (r"hips_$\x$_r", "$_$"), np.arange(5) / 5
    series = AngleSeries(times, names, np.zeros((5, 2)))
    angle_plot(tmp_path / "a.png", series, title="walk $_$")
    cycle_plot(tmp_path / "b.png", {name: (np.zeros(101), np.ones(101)) for name in names}, title="walk $_$")
    joint_error_plot(tmp_path / "c.png", times, names, np.ones((5, 2)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png", "c.png"]


def test_lost_frames_have_no_say_in_the_height_of_a_panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their band may be whole turns wide, and all curves would be flat."""
    times, saved = np.arange(30) / 30, list[Any]()
    angles, lost, dropped = np.radians(40 * np.sin(6 * times))[:, None], times > 0.8, times < 0.1
    series = AngleSeries(times, ("knee_angle_r",), angles, np.where(lost | dropped, 3.0, 0.01)[:, None])
    monkeypatch.setattr(plots, "_saved", lambda _, figure, *__: saved.append(figure))
    for flags in ((lost, dropped), (np.ones(30, np.bool_), None)):
        angle_plot(tmp_path / "a.png", series, None, *flags)
    low, high = saved[0].axes[0].get_ylim()
    assert -55 < low < -40 and 40 < high < 55
    low, high = saved[1].axes[0].get_ylim()
    assert -55 < low < -40 and 40 < high < 55  # all of it is lost: its curve is shown


def test_no_band_hides_that_frames_are_lost(tmp_path: Path) -> None:
    """The σ of a body that is predicted alone fills its panel."""
    times = np.arange(60) / 60
    lost = (times > 0.3) & (times < 0.7)
    series = AngleSeries(times, ("knee_angle_r",), np.zeros((60, 1)), np.where(lost, 3.0, 0.05)[:, None])
    picture = cv2.imread(str(angle_plot(tmp_path / "a.png", series, None, lost)))[..., ::-1].astype(int)
    red = np.all(np.abs(picture - (249, 214, 215)) < 6, axis=2)
    assert red.sum(axis=0).max() > 0.9 * red.any(axis=1).sum() and red.any(axis=0).sum() > 60


def test_envelopes_hold_every_frame_of_a_column() -> None:
    rng = np.random.default_rng(0)
    times, low = np.sort(rng.uniform(3, 9, 1000)), rng.normal(size=1000)
    low[200:300] = low[500] = np.nan
    starts, lowest, highest = envelope(times, low, low + 1, 50)
    column = np.searchsorted(starts, times, side="right") - 1
    assert 50 <= len(starts) <= 51 and np.isnan(lowest).sum() >= 3
    for k in range(len(starts)):
        own = low[(column == k) & np.isfinite(low)]
        expected = (own.min(), own.max() + 1) if own.size else (np.nan, np.nan)
        np.testing.assert_equal((lowest[k], highest[k]), expected)
    few = envelope(times[::100], low[::100], low[::100], 1000)
    np.testing.assert_array_equal(few, (times[::100], low[::100], low[::100]))  # a frame a column: as it is


def test_bands_of_long_recordings_are_bands(tmp_path: Path) -> None:
    """Of 6 000 frames every seventh has a large σ: all of the panel's width is under its band."""
    times, sigma = np.arange(6000) / 60, np.where(np.arange(6000) % 7 == 0, 0.2, 0.01)[:, None]
    series = AngleSeries(times, ("knee_angle_r",), np.zeros((6000, 1)), sigma)
    picture = cv2.imread(str(angle_plot(tmp_path / "a.png", series)))[..., ::-1].astype(int)
    tinted = (picture[..., 0] - picture[..., 2] > 40) & (picture[..., 2] > 120)  # pale orange: the band, not the curve
    rows = tinted.sum(axis=1)
    assert (rows > 0.9 * rows.max()).sum() > 40 and rows.max() > 200


class Links(HTMLParser):
    """Every src and href of a page, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for key, value in attrs if key in ("src", "href")]


def magenta(path: Path) -> Path:
    cv2.imwrite(str(path), np.full((300, 400, 3), (200, 0, 200), np.uint8))
    return path


def a_report(folder: Path) -> Path:
    rows = [row("walk <b>", "KHE", 0.5312, "deg", at_most=0.7), row("walk <b>", "IoU, mean", 0.8, "", at_least=0.83)]
    (folder / "over lay.mp4").write_bytes(b"x")
    return write_report(
        folder,
        "Walk <script>alert(1)</script>",
        rows,
        headlines=headline_rows(rows, {"KHE": "knee & hip", "absent": "nothing"}),
        figures=[Figure(magenta(folder / "angles.png"), 'a "caption"')],
        video=folder / "over lay.mp4",
        files={folder / "result.h5": "the <result>"},
        notes=["a note & more"],
    )


def test_report_is_escaped_and_stands_alone(tmp_path: Path) -> None:
    text = a_report(tmp_path).read_text(encoding="utf-8")
    page = Links()
    page.feed(text)
    assert "script" not in page.tags
    assert page.tags.count("b") == 1  # the one headline; the case's own <b> is text
    assert not re.search(r"(src|href)=.?https?:", text)
    assert [link for link in page.links if not link.startswith("data:")] == ["over%20lay.mp4"] * 2 + ["result.h5"]
    assert sum(link.startswith("data:image/png;base64,") for link in page.links) == 1
    assert "0.53" in text and "≤ 0.7" in text and "knee &amp; hip" in text


def test_the_verdict_comes_first_and_prints(tmp_path: Path) -> None:
    verdict = [Statement("All <b> frames.", True), Statement("Not the wrist.", False), Statement("Careful.")]
    text = write_report(tmp_path, "Walk", [], verdict=verdict, statements=["none lost"]).read_text()
    assert text.index("<h2>Verdict") < text.index("none lost")
    for kind, words in (("good", "All &lt;b&gt; frames."), ("bad", "Not the wrist."), ("amber", "Careful.")):
        assert f'<li class="{kind}">{words}</li>' in text
    assert "@media print" in text and "color-scheme: light dark" in text


def test_numbers_are_short() -> None:
    assert [number(v) for v in (None, 0.0, 3.0, 0.531, 10.53, 123.4, -2.345)] == [
        "–", "0", "3", "0.53", "10.5", "123", "-2.35",
    ]  # fmt: skip


@pytest.mark.skipif(not CHROMIUM.exists(), reason="no Chromium at /usr/bin/chromium to look at the page with")
def test_a_browser_shows_the_page_with_its_pictures(tmp_path: Path) -> None:
    page, shot, profile = a_report(tmp_path), tmp_path / "shot.png", tmp_path / "profile"
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    flags += " --disable-component-update --disable-sync --hide-scrollbars --window-size=1200,1600"
    command = [str(CHROMIUM), *flags.split(), f"--user-data-dir={profile}", f"--screenshot={shot}", page.as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    shutil.rmtree(profile, ignore_errors=True)
    picture = cv2.imread(str(shot))[..., ::-1]
    assert _has_colour(picture, (200, 0, 200), 4)  # the embedded plot
    assert _has_colour(picture, (26, 127, 75), 30)  # the headline's green
