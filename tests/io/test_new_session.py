"""``twistcap new``: a session that loads, and sentences for what does not fit or is still missing."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from support.commands import refusal
from support.videos import corrupted
from twistcap.camera import Camera, Rig, look_at
from twistcap.cli import main
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig, write_rig
from twistcap.io.cameras.units import scaled
from twistcap.io.new_session import matched
from twistcap.io.recording import rig_of, views_of
from twistcap.io.session import load_session
from twistcap.io.videowriter import VideoWriter

SIZE = (96, 64)


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as done:
        main([str(a) for a in arguments])
    return int(done.value.code or 0)


def video(path: Path, frames: int = 5, fps: float = 30, size: tuple[int, int] = SIZE) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with VideoWriter(path, fps) as writer:
        for k in range(frames):
            writer.write(np.full((size[1], size[0], 3), 20 * k, np.uint8))
    return path


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Two cameras' videos and the calibration of three."""
    K = np.array([[90.0, 0, 47.5], [0, 90.0, 31.5], [0, 0, 1]])
    eyes = {"cam1": (3, 0, 1.2), "cam2": (0, 3, 1.2), "cam10": (-3, 0, 1.2)}
    rig = Rig(tuple(Camera(name, K, look_at(eye, (0, 0, 1)), SIZE) for name, eye in eyes.items()))
    write_rig(rig, tmp_path / "Calib.toml")
    video(tmp_path / "videos" / "cam1.mp4")
    video(tmp_path / "videos" / "trial_cam10.mp4")
    return tmp_path


def new(folder: Path, *videos: object, extra: tuple[object, ...] = ()) -> int:
    said = [part for path in videos for part in ("--videos", path)]
    return run("new", folder / "mine", "--calibration", folder / "Calib.toml", *said, *extra)


def test_the_session_loads_and_says_what_is_missing(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert new(recorded, recorded / "videos", extra=("--json",)) == 0
    output: dict[str, Any] = json.loads(capsys.readouterr().out)
    session = load_session(output["session"])
    views = views_of(session, rig_of(session))
    assert (views.rig.names, len(views), views.fps) == (("cam1", "cam10"), 5, 30.0)
    found, missing = " ".join(output["found"]), " ".join(output["missing"])
    assert "2 cameras" in found and "5 frames" in found and "without a video: cam2" in found
    assert "stature" in missing and "twistcap init" in missing and "Keypoints" in missing
    text = (recorded / "mine" / "session.toml").read_text()
    assert text.count("#") > 8  # comments that tell what else could be set
    assert str(recorded) not in text  # paths are relative: the folder may move


def test_what_is_refused_late_leaves_the_folder_as_it_was(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, wrong = recorded / "mine" / "session.toml", ("--up", "-z")  # all cameras would stand underground
    assert new(recorded, recorded / "videos", extra=wrong) == 2
    assert "underground" in capsys.readouterr().err and not path.parent.exists()
    path.parent.mkdir()
    path.write_text("mine")
    assert new(recorded, recorded / "videos", extra=(*wrong, "--force")) == 2
    assert path.read_text() == "mine"


def test_one_camera_is_not_enough(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert new(recorded, recorded / "videos" / "cam1.mp4") == 0
    told = capsys.readouterr().err
    assert told.startswith("1 camera (cam1), ") and "Next, film with a second camera" in told
    assert "a first pose is found neither in its images nor by keypoints or clicks. Else give the pose" in told
    assert "twistcap init" not in told and "Keypoints: none" not in told
    assert '# file = "other/result.h5"' in (recorded / "mine" / "session.toml").read_text()
    session, why = recorded / "mine" / "session.toml", "camera cam1 alone gives no first pose, not in its images, by"
    for command in ("track", "init"):
        assert run(command, session) == 2
        assert f"{why} keypoints or by clicks, as one view does not show depth; add a second" in capsys.readouterr().err
    (recorded / "mine" / "first_pose.json").write_text("{}")
    assert new(recorded, recorded / "videos" / "cam1.mp4", extra=("--force",)) == 0
    assert "Next, track:" in capsys.readouterr().err


def test_what_is_there_is_not_missing(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (recorded / "mine").mkdir()
    (recorded / "mine" / "first_pose.json").write_text("{}")
    assert new(recorded, recorded / "videos", extra=("--stature", "1.82")) == 0
    assert "Nothing is missing." in capsys.readouterr().err
    assert load_session(recorded / "mine" / "session.toml").body.stature == 1.82


def test_a_shell_may_spell_out_the_videos(recorded: Path) -> None:
    files = sorted((recorded / "videos").iterdir())
    assert run("new", recorded / "mine", "--calibration", recorded / "Calib.toml", "--videos", *files) == 0
    assert set(load_session(recorded / "mine" / "session.toml").videos) == {"cam1", "cam10"}


@pytest.mark.parametrize("videos", ["trial [1]", "trial [1]/*.mp4", "trial [1]/cam1 [b].mp4"])
def test_brackets_in_names_that_exist_are_no_pattern(recorded: Path, videos: str) -> None:
    (recorded / "videos" / "cam1.mp4").rename(recorded / "videos" / "cam1 [b].mp4")
    (recorded / "videos").rename(recorded / "trial [1]")
    assert new(recorded, recorded / videos) == 0
    assert "cam1" in load_session(recorded / "mine" / "session.toml").videos


def test_images_leave_the_frame_rate_open(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import cv2

    for name in ("cam1", "cam2"):
        (recorded / "stills" / name).mkdir(parents=True)
        for k in range(3):
            cv2.imwrite(str(recorded / "stills" / name / f"{k:03d}.png"), np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    assert new(recorded, recorded / "stills") == 0
    assert "fps" in capsys.readouterr().err
    session = load_session(recorded / "mine" / "session.toml")
    assert len(views_of(session, rig_of(session))) == 3


def test_unequal_lengths_set_the_frames(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    video(recorded / "videos" / "cam2.mp4", frames=8)
    assert new(recorded, recorded / "videos") == 0
    told = capsys.readouterr().err
    assert "differ in length (5 to 8 frames)" in told
    assert "Next, if the cameras were not started together, find their clocks:  twistcap sync " in told
    assert told.rstrip().splitlines()[-1].startswith("Then, track:  ")
    assert load_session(recorded / "mine" / "session.toml").frames == (0, 4)


def test_names_are_matched_as_whole_as_can_be() -> None:
    cameras = ("cam1", "cam10", "left")
    found = matched([(None, "a/CAM1.mp4"), (None, "b/trial_cam10.mov"), ("left", "c/x.avi")], cameras)
    assert found == {"cam1": "a/CAM1.mp4", "cam10": "b/trial_cam10.mov", "left": "c/x.avi"}
    assert matched([(None, "cam10/%04d.png")], cameras) == {"cam10": "cam10/%04d.png"}
    for videos, words in (
        ([(None, "x.mp4")], "no camera"),
        ([(None, "left_and_cam1.mp4")], "more than one"),
        ([("right", "x.mp4")], "no calibration"),
        ([("left", "x.mp4"), ("left", "y.mp4")], "two videos"),
        ([], "no video"),
    ):
        with pytest.raises(InputError, match=words):
            matched(videos, cameras)


def test_what_does_not_fit_is_one_sentence(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = video(recorded / "small" / "cam2.mp4", size=(80, 64))
    good = recorded / "videos" / "cam1.mp4"
    (recorded / "empty").mkdir()
    for videos, extra, words in (
        ((good, small), (), "80×64"),
        ((recorded / "none.mp4",), (), "none.mp4 does not exist; check --videos"),
        ((f"cam2={recorded / 'none.mp4'}",), (), "none.mp4 does not exist; check --videos"),
        ((recorded / "none" / "%04d.png",), (), "%04d.png does not exist; check --videos"),
        ((recorded / "empty",), (), "neither videos nor images"),
        ((recorded / "*.avi",), (), "no file matches"),
        ((good,), ("--unit", "km"), "--unit"),
        ((good,), ("--stature", "182"), "--stature"),
    ):
        assert new(recorded, *videos, extra=extra) == 2
        output = capsys.readouterr().err.strip()
        assert words in output and output.startswith("twistcap:") and "\n" not in output
        assert not (recorded / "mine" / "session.toml").exists()
    assert new(recorded, good) == 0
    capsys.readouterr()
    assert new(recorded, good) == 2
    assert "--force" in capsys.readouterr().err
    assert new(recorded, good, extra=("--force",)) == 0


@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\xff\xfe", None])
def test_a_calibration_that_is_none_is_named_with_its_option(
    recorded: Path, content: bytes | None, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded / "Calib.toml"
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    assert new(recorded, recorded / "videos") == 2
    told = capsys.readouterr().err
    assert str(path) in told and "check --calibration." in told and "[cameras]" not in told
    assert run("convert", path, recorded / "other.toml") == 2
    assert "[cameras]" not in capsys.readouterr().err


def test_unlike_rates_are_told_and_paired_by_time(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow = video(recorded / "slow" / "cam10.mp4", fps=25)
    assert new(recorded, recorded / "videos" / "cam1.mp4", slow) == 0
    told = capsys.readouterr().err
    assert "paired by time" in told and "Next, find the clocks of the cameras:  twistcap sync" in told
    assert "Then, track:  twistcap track" in told


def test_folders_of_videos_name_the_cameras(recorded: Path) -> None:
    """Each camera's folder holds a file of the same name, as action cameras write it."""
    for name in ("cam1", "cam10"):
        video(recorded / "takes" / name / "GOPR0001.mp4")
    assert new(recorded, recorded / "takes") == 0
    found = load_session(recorded / "mine" / "session.toml").videos
    assert {name: Path(path).parent.name for name, path in found.items()} == {"cam1": "cam1", "cam10": "cam10"}


def test_a_camera_is_known_by_its_folder() -> None:
    assert matched([(None, "x/cam1/GOPR01.mp4"), (None, "x/cam10/GOPR01.mp4")], ("cam1", "cam10")) == {
        "cam1": "x/cam1/GOPR01.mp4",
        "cam10": "x/cam10/GOPR01.mp4",
    }


def test_commands_may_be_copied_where_a_path_has_blanks(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibration, videos = recorded / "Calib.toml", recorded / "videos"
    assert run("new", recorded / "a walk", "--calibration", calibration, "--videos", videos) == 0
    told, path = capsys.readouterr().err, recorded / "a walk" / "session.toml"
    assert f"twistcap init '{path}'" in told and f"twistcap track '{path}'" in told


def test_a_folder_that_cannot_be_made_is_said(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = ("--calibration", recorded / "Calib.toml", "--videos", recorded / "videos")
    assert run("new", "/proc/mine", *said) == 2
    assert "folder /proc/mine cannot be made" in (told := capsys.readouterr().err)
    assert "choose another folder." in told and "--out" not in told


@pytest.mark.parametrize("codec", ["mpeg4", "libx264"])
def test_an_old_avi_with_b_frames_is_taken_as_decoded_and_said(
    recorded: Path, codec: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("cam1", "cam10"):
        avi(recorded / "old" / f"{name}.avi", codec)
    assert new(recorded, recorded / "old") == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "cam1.avi: its time stamps make no sense; frames are taken as they are decoded" in told
    session = load_session(recorded / "mine" / "session.toml")
    views = views_of(session, rig_of(session))
    levels = [float(next(iter(views.sources[0].read([k]))).mean()) for k in range(len(views))]
    assert len(views) == 12 and levels == sorted(levels) and levels[-1] > levels[0] + 180


def avi(path: Path, codec: str) -> None:
    """Grows brighter from frame to frame."""
    path.parent.mkdir(exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(30))
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.codec_context.max_b_frames = 2
        for k in range(12):
            image = np.full((SIZE[1], SIZE[0], 3), 20 + 18 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))


def test_a_video_with_a_broken_end_is_refused(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = recorded / "videos" / "cam1.mp4"
    for fraction in (0.2, 0.8):  # near the beginning, and in the last frames
        corrupted(good, recorded / "cam1.mp4", fraction)
        assert new(recorded, recorded / "cam1.mp4") == 2
        assert "corrupt" in capsys.readouterr().err


def test_a_world_that_is_not_z_up_is_turned_as_said(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = read_rig(recorded / "Calib.toml")
    turn = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # of the world: y is up
    write_rig(Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ turn) for c in rig)), recorded / "Calib.toml")
    assert new(recorded, recorded / "videos") == 2
    told = capsys.readouterr().err
    assert "y is up, not z; say --up y (or --up z if the cameras lie" in told and "[cameras]" not in told
    assert new(recorded, recorded / "videos", extra=("--up", "y")) == 0
    assert "by the images" not in capsys.readouterr().err
    heights = [camera.centre[2] for camera in rig_of(load_session(recorded / "mine" / "session.toml"))]
    np.testing.assert_allclose(heights, 1.2, atol=1e-6)
    assert new(recorded, recorded / "videos", extra=("--up", "z", "--force")) == 0  # as said, whatever the images say
    assert "Up is z, as said with --up; by the images it is y, so look at it." in capsys.readouterr().err
    assert load_session(recorded / "mine" / "session.toml").cameras.up == "z"


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("mm", 1000.0), (None, 15.0)])
def test_a_calibration_that_says_no_unit_is_told_or_asked_for(
    recorded: Path, unit: str | None, factor: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """By how far the cameras are apart; in squares of a board nothing is taken in silence."""
    path, rig = recorded / "Calib.toml", read_rig(recorded / "Calib.toml")
    write_rig(scaled(rig, factor), path)
    path.write_text(path.read_text().replace('unit = "m"\n', ""))
    assert new(recorded, recorded / "videos") == (2 if unit is None else 0)
    told = capsys.readouterr().err
    assert ("fits neither metres nor millimetres" in told and "--unit" in told) is (unit is None)
    if unit is not None:
        assert f"taken to be in {'milli' if unit == 'mm' else ''}metres: cameras are" in told
        session = load_session(recorded / "mine" / "session.toml")
        assert session.cameras.unit == unit
        np.testing.assert_allclose([c.centre for c in rig_of(session)], [rig[0].centre, rig[2].centre], atol=1e-9)


def test_a_calibration_in_centimetres_is_to_be_converted(
    recorded: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(recorded)
    write_rig(scaled(read_rig("Calib.toml"), 15.0), "cm.toml")
    Path("cm.toml").write_text(Path("cm.toml").read_text().replace('unit = "m"\n', ""))
    mend = "or convert it with the length of its unit in m:  twistcap convert {} metres.toml --unit 0.01."
    told = refusal(capsys, "new", "mine", "--calibration", "cm.toml", "--videos", "videos")
    assert mend.format("cm.toml") in told
    Path("Calib.toml").unlink()
    Path("calibration").mkdir()
    Path("cm.toml").rename("calibration/cm.toml")
    assert mend.format("calibration/cm.toml") in refusal(capsys, "new", "mine", "--project", ".")


@pytest.mark.parametrize("known", [True, False])
def test_a_calibration_without_a_floor_needs_no_edit(
    recorded: Path, known: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rig(read_rig(recorded / "Calib.toml"), recorded / "Calib.toml", floor=known)
    assert new(recorded, recorded / "videos") == 0
    assert ("does not know the floor" in capsys.readouterr().err) is not known
    assert (load_session(recorded / "mine" / "session.toml").cameras.floor is False) is not known


@pytest.mark.parametrize("option", ["--project", "--trial"])
def test_options_of_projects_do_not_go_with_videos(
    recorded: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(recorded, recorded / "videos", extra=(option, recorded)) == 2
    assert f"{option} is for the folder of another program" in capsys.readouterr().err
