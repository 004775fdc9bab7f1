"""The command line from end to end on a small studio session, and one clear sentence for every bad input."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.commands import document, refusal, run
from support.results import estimate, two_links
from support.videos import corrupted, write
from twistcap.body import Pose
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig
from twistcap.io.lock import WriteLock
from twistcap.io.motion_files import write_mot
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.result_schema import COLUMNS
from twistcap.io.video import VideoSource
from twistcap.studio.motion import gait

SMALL = ["--size", "192x140", "--views", "2", "--frames", "8"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A studio session, rendered once."""
    folder = tmp_path_factory.mktemp("studio") / "walk"
    assert run("studio", folder, *SMALL) == 0
    return folder


@pytest.fixture
def session(made: Path, tmp_path: Path) -> Path:
    """A copy of the session that a test may spoil."""
    return Path(shutil.copytree(made, tmp_path / "walk")) / "session.toml"


@pytest.fixture(scope="module")
def tracked(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The output folder of a whole track."""
    out = tmp_path_factory.mktemp("out")
    assert run("track", made / "session.toml", "--out", out) == 0
    return out


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text, text
    path.write_text(text.replace(old, new, 1))


def test_track_writes_everything(tracked: Path, made: Path) -> None:
    names = {path.name for path in tracked.iterdir()}
    assert {"result.h5", "overlay.mp4", "angles.png", "joints.trc", "angles.csv", "report.html"} <= names
    result = read_result(tracked / "result.h5")
    assert len(result) == 8 and list(result.indices) == list(range(8))
    assert result.config["tracker"] == {} and "numpy" in result.versions
    truth = np.load(made / "truth.npz")
    assert np.linalg.norm(result.roots[-1, :3, 3] - truth["root"][-1, :3, 3]) < 0.1
    assert len(VideoSource(tracked / "overlay.mp4")) == 8


def test_evaluate(tracked: Path, made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = tracked / "result.h5"
    found = document(capsys, "evaluate", result, "--reference", made / "truth.npz")
    assert {"case", "metric", "value", "unit", "target", "holds", "seeds", "lost"} == set(found["rows"][0])
    by_metric = {row["metric"]: row["value"] for row in found["rows"]}
    assert 0.0 < by_metric["joints, mean"] < 100.0
    masks = document(capsys, "evaluate", result, "--reference", made / "masks")
    assert len(masks["masks"]) == 16 and all(mask["iou"] > 0.5 for mask in masks["masks"])
    assert "does not exist" in refusal(capsys, "evaluate", result, "--reference", made / "none.npz")


@pytest.mark.parametrize("kind", ["trc", "mot", "bvh", "csv", "glb", "opensim"])
def test_export(kind: str, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = document(capsys, "export", tracked / "result.h5", "--to", kind, "--out", tmp_path / f"walk.{kind}")
    assert Path(written["file"]).stat().st_size > 200


def test_export_options(tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both sides of each: another world, other angles, a part of the frames, frames without evidence."""
    result = tracked / "result.h5"

    def rows(*options: object) -> list[dict[str, str]]:
        document(capsys, "export", result, "--to", "csv", "--out", tmp_path / "a.csv", *options)
        with (tmp_path / "a.csv").open() as file:
            return list(csv.DictReader(file))

    plain, up = rows("--fill")[0], rows("--fill", "--axes", "z_up")[0]
    assert float(up["pelvis_tz_m"]) == pytest.approx(float(plain["pelvis_ty_m"]), abs=1e-6)
    assert "knee_angle_r_deg" in plain and "isb_knee_flexion_r_deg" in rows("--angles", "isb")[0]
    assert [int(row["frame"]) for row in rows("--frames", "2:4")] == [2, 3, 4]
    for option, value in (("--axes", "sideways"), ("--angles", "euler")):
        said = refusal(capsys, "export", result, "--to", "csv", option, value)
        assert f"{option} is {value!r}; it must be one of opensim" in said
    assert "no frame" in refusal(capsys, "export", result, "--to", "csv", "--frames", "100:200")


def test_export_refuses(tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "choose one of trc, mot, bvh, csv, glb" in refusal(capsys, "export", tracked / "result.h5", "--to", "fbx")
    assert "does not exist" in refusal(capsys, "export", tmp_path / "none.h5", "--to", "trc")
    assert "no HDF5 file" in refusal(capsys, "export", tracked / "angles.csv", "--to", "trc")
    told = refusal(capsys, "export", tracked / "result.h5", "--to", "trc", "--out", tmp_path / "foo.csv")
    assert f"--out is {tmp_path / 'foo.csv'}; name a file that ends in .trc." in told
    told = refusal(capsys, "view", tracked / "result.h5", "--save", tmp_path / "x.txt")
    assert f"--save is {tmp_path / 'x.txt'}; name a file that ends in .html." in told
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["export", "view"])
def test_a_run_is_named_by_its_folder(
    command: str, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    options = ("--to", "trc") if command == "export" else ("--save", tmp_path / "a.html")
    for name in ("refined.h5", "result.h5"):  # as `refine` and `track` write them
        shutil.copy(tracked / "result.h5", folder / name)
        assert run(command, folder, *options) == 0
    told = refusal(capsys, command, tmp_path, *options)
    assert f"folder {tmp_path} holds no result.h5; name the folder that `twistcap track` wrote, or the file." in told


def test_folders_of_files_are_made(tracked: Path, tmp_path: Path) -> None:
    made = tmp_path / "new" / "folder"
    assert run("export", tracked / "result.h5", "--to", "trc", "--out", made / "a.trc") == 0
    assert run("export", tracked / "result.h5", "--to", "opensim", "--out", made / "model") == 0
    assert run("view", tracked / "result.h5", "--save", made / "deep" / "a.html") == 0
    assert (made / "a.trc").is_file() and (made / "model").is_dir() and (made / "deep" / "a.html").is_file()


@pytest.mark.parametrize("method", ["direct", "differential"])
def test_resume_goes_on(method: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is resumed is the undisturbed run, to the last bit."""
    session, quick = made / "session.toml", ("--method", method, "--set", "output.overlay=false")
    assert run("track", session, "--out", tmp_path / "whole", *quick) == 0
    assert run("track", session, "--out", tmp_path / "cut", "--frames", "0:3", *quick) == 0
    found = document(capsys, "track", session, "--out", tmp_path / "cut", "--resume", *quick)
    whole, cut = (read_result(tmp_path / name / "result.h5") for name in ("whole", "cut"))
    assert found["frames"] == 8 and list(cut.indices) == list(range(8))
    np.testing.assert_array_equal(cut.roots, whole.roots)
    np.testing.assert_array_equal(cut.covariances, whole.covariances)


def test_a_finished_track_is_not_tracked_again(
    made: Path, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its file stays as it is, to the last byte; the other files are written anew."""
    out = Path(shutil.copytree(tracked, tmp_path / "o"))
    (out / "angles.csv").unlink()
    quick = ("--resume", "--set", "output.overlay=false")
    assert run("track", made / "session.toml", "--out", out, *quick) == 0
    said = capsys.readouterr()
    assert "all 8 frames are tracked: there is nothing to do" in said.err + said.out
    assert (out / "result.h5").read_bytes() == (tracked / "result.h5").read_bytes()
    assert (out / "angles.csv").read_bytes() == (tracked / "angles.csv").read_bytes()


@pytest.mark.parametrize("frames", ["0:6", "0:7"])
def test_a_correction_that_was_cut_off_is_ended(
    frames: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After one of three frames, in the last frame of all or the last but one."""

    def found(rule: Any, model: Any, before: Any, state: Any, passed: Any) -> tuple[Any, list[Any]]:
        last = [one.estimate for one in list(passed)[-3:]] if len(passed) == 6 else []
        return state, [replaced(e, pose=Pose(e.pose.root, e.pose.q + 0.1)) for e in last]

    def cut(writer: ResultWriter, estimates: Any) -> None:
        writer._put_row(len(writer) - 1 - len(estimates), estimates[0])
        raise KeyboardInterrupt

    quick = ("--frames", frames, "--set", "output.overlay=false", "--set", "output.report=false")
    track = ("track", made / "session.toml", *quick, "--out")
    monkeypatch.setattr("twistcap.hindsight.looked_back", found)
    assert document(capsys, *track, tmp_path / "whole")["corrected"] == [3, 4, 5]
    with monkeypatch.context() as patch:
        patch.setattr(ResultWriter, "correct", cut)
        assert run(*track, tmp_path / "cut") == 130
    assert document(capsys, *track, tmp_path / "cut", "--resume")["frames"] == int(frames[-1]) + 1
    whole, ended = (read_result(tmp_path / name / "result.h5") for name in ("whole", "cut"))
    for name in (column.of_result for column in COLUMNS.values()):
        np.testing.assert_array_equal(getattr(ended, name), getattr(whole, name))


def test_motions_carry_the_track_over_missing_images(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The library has another rate than the recording; --resume goes on with it."""
    body = humanoid()
    write_mot(tmp_path / "walk.mot", body, np.arange(120) / 60.0, gait(body, fps=60.0, frames=120, speed=1.2))
    made = document(capsys, "motions", "build", tmp_path / "walk.npz", tmp_path / "walk.mot", "--fps", "30")
    assert document(capsys, "motions", "show", tmp_path / "walk.npz") == made
    assert made["rate"] == 30.0 and made["clips"][0]["poses"] == 60
    replace(session, "[first_pose]", f'[motions]\npath = "{tmp_path / "walk.npz"}"\nkind = "scaled"\n[first_pose]')
    for camera in ("cam01", "cam02"):
        folder = session.parent / camera
        folder.mkdir()
        video = cv2.VideoCapture(str(session.parent / "videos" / f"{camera}.mp4"))
        for k in range(8):
            if (image := video.read()[1]) is not None and k != 6:
                cv2.imwrite(str(folder / f"{k:04d}.png"), image)
        replace(session, f"videos/{camera}.mp4", f"{camera}/%04d.png")
    quick = ("--set", "output.overlay=false", "--set", "output.report=false")
    assert run("track", session, "--out", tmp_path / "out", "--frames", "0:6", *quick) == 0
    assert run("track", session, "--out", tmp_path / "out", "--resume", *quick) == 0
    result = read_result(tmp_path / "out" / "result.h5")
    told_by = [estimate.predicted for estimate in result.estimates]
    assert len(result) == 8 and told_by[6:] == ["motion"] * 2
    assert [estimate.status == "no_images" for estimate in result.estimates] == [k == 6 for k in range(8)]
    assert "but tracker.predictor is 'hold'" in refusal(capsys, "track", session, "--set", "tracker.predictor=hold")


def test_an_amc_is_built_on_the_skeleton_that_is_named(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cmu = shared_data / "motions" / "cmu"
    build = ("motions", "build", tmp_path / "walk.npz", cmu / "08_04.amc")
    assert "there are several (01.asf, 11.asf); name it (--skeleton" in refusal(capsys, *build)
    assert document(capsys, *build, "--skeleton", cmu / "01.asf", "--fps", "30")["clips"][0]["name"] == "08_04"
    assert "'leg' is unknown" in refusal(capsys, *build, "--variant", "leg")


def test_resume_refuses_other_cameras(session: Path, tracked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace(session, 'unit = "m"', 'unit = "m"\nuse = ["cam02"]')
    assert "was tracked with cameras cam01, cam02" in refusal(capsys, "track", session, "--out", tracked, "--resume")


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (("--set", "step=2"), "step was 1, is 2"),
        (("--set", "fps=30"), "rate was 60.0, is 30.0"),
        (("--method", "levelset"), "tracker.method was direct, is levelset"),
        (("--scale", "0.5"), "scale was 1.0, is 0.5"),
        (("--frames", "2:7"), "first frame was 0, is 2"),
        (("--set", "body.girths.torso=1.2"), "body differs"),
    ],
)
def test_resume_names_what_differs(
    changed: tuple[str, ...], named: str, made: Path, tracked: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (tracked / "result.h5").read_bytes()
    sentence = refusal(capsys, "track", made / "session.toml", "--out", tracked, "--resume", *changed)
    assert f"result.h5 was tracked otherwise ({named}); resume with what it was begun with" in sentence
    assert (tracked / "result.h5").read_bytes() == before


def test_resume_knows_calibration_and_videos(
    session: Path, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A copied file has another time; another recording has another first picture; a moved camera is another."""
    copied = session.parent / "videos" / "cam02.mp4"
    shutil.copyfile(copied, session.parent / "copy.mp4")
    replace(session, "videos/cam02.mp4", "copy.mp4")
    sentence = refusal(capsys, "track", session, "--out", tracked, "--resume")
    assert "(video of cam02, time of change differs); if the videos show the same, add --videos-changed" in sentence
    assert run("track", session, "--out", shutil.copytree(tracked, tmp_path / "o"), "--resume", "--videos-changed") == 0
    shutil.copyfile(session.parent / "videos" / "cam01.mp4", session.parent / "copy.mp4")
    sentence = refusal(capsys, "track", session, "--out", tracked, "--resume")
    assert "video of cam02, bytes was" in sentence and "video of cam02, first picture differs" in sentence
    replace(session, "copy.mp4", "videos/cam02.mp4")
    calib = session.parent / "Calib.toml"
    line = next(line for line in calib.read_text().splitlines() if line.startswith("distortions"))
    replace(calib, line, "distortions = [0.001, 0.0, 0.0, 0.0]")
    assert "(calibration of cam01 differs)" in refusal(capsys, "track", session, "--out", tracked, "--resume")


def test_frames_are_not_overwritten_unasked(
    made: Path, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, before = Path(shutil.copytree(tracked, tmp_path / "o")), (tracked / "result.h5").read_bytes()
    sentence = refusal(capsys, "track", made / "session.toml", "--out", out)
    assert "holds 8 tracked frames; go on with --resume, replace them with --overwrite, or choose" in sentence
    assert "exclude each other" in refusal(
        capsys, "track", made / "session.toml", "--out", out, "--resume", "--overwrite"
    )
    assert "holds 8 tracked frames; choose another folder" in refusal(capsys, "demo", "--out", out)
    assert (out / "result.h5").read_bytes() == before
    assert run("track", made / "session.toml", "--out", out, "--overwrite", "--frames", "0:1") == 0
    assert len(read_result(out / "result.h5")) == 2
    (out / "result.h5").write_text("something else")
    assert "no HDF5 file; replace it with --overwrite" in refusal(capsys, "track", made / "session.toml", "--out", out)


def test_a_second_track_is_refused(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with WriteLock(tmp_path / "result.h5"):
        for more in ((), ("--resume",), ("--overwrite",)):
            sentence = refusal(capsys, "track", made / "session.toml", "--out", tmp_path, *more)
            assert "result.h5 is being written by another process" in sentence
        assert "is being written" in refusal(capsys, "demo", "--out", tmp_path)


def test_a_result_of_no_session_is_not_resumed(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = read_rig(made / "Calib.toml", "m")
    with ResultWriter(tmp_path / "result.h5", two_links(), rig, {}) as writer:
        writer.append(estimate(0))
    assert "was not tracked from a session" in refusal(
        capsys, "track", made / "session.toml", "--out", tmp_path, "--resume"
    )


def test_full_disk(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full from some frame on; what was written is kept, and the track goes on when there is room."""
    original, calls = os.pwrite, list[int]()

    def pwrite(*arguments: Any) -> int:
        calls.append(1)
        if len(calls) > 100:
            raise OSError(28, "No space left on device")
        return original(*arguments)

    quick = ("--set", "output.overlay=false", "--set", "output.report=false")
    with monkeypatch.context() as full:
        full.setattr(os, "pwrite", pwrite)
        sentence = refusal(capsys, "track", made / "session.toml", "--out", tmp_path, *quick)
    kept = len(read_result(tmp_path / "result.h5"))
    assert kept >= 3 and "cannot be written: No space left on device; make room" in sentence
    assert f"the {kept} frames before it are kept" in sentence
    assert run("track", made / "session.toml", "--out", tmp_path, "--resume", *quick) == 0
    assert len(read_result(tmp_path / "result.h5")) == 8


def test_read_only_folder(made: Path, tmp_path: Path) -> None:
    """Not even root may write there."""
    mount = ["unshare", "-rm", "sh", "-c", 'mount -t tmpfs -o ro none "$0" && exec "$@"']
    tried = subprocess.run([*mount, tmp_path, "true"], capture_output=True, check=False)
    if tried.returncode:
        pytest.skip("a read-only file system cannot be mounted here")
    command = [sys.executable, "-m", "twistcap.cli", "track", made / "session.toml", "--out", tmp_path]
    done = subprocess.run([*mount, tmp_path, *command], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "result.h5 cannot be written: Read-only file system; choose another folder." in done.stderr


def test_killed_run_keeps_its_frames_and_goes_on(made: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "twistcap.cli", "track", str(made / "session.toml"), "--out", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
        while child.poll() is None and not frames_in(tmp_path / "result.h5"):
            time.sleep(0.02)
        child.send_signal(signal.SIGKILL)
    kept = frames_in(tmp_path / "result.h5")
    assert kept >= 1
    assert run("track", made / "session.toml", "--out", tmp_path, "--resume", "--set", "output.overlay=false") == 0
    assert list(read_result(tmp_path / "result.h5").indices) == list(range(8))


def frames_in(path: Path) -> int:
    """Frames that another process has written so far; 0 while it is just writing."""
    try:
        return len(read_result(path))
    except (InputError, OSError, RuntimeError, KeyError):
        return 0


def test_corrupt_frame_loses_nothing(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = session.parent / "videos" / "cam02.mp4"
    corrupted(good, session.parent / "videos" / "bad.mp4", 0.9)
    replace(session, "cam02.mp4", "bad.mp4")
    sentence = refusal(capsys, "track", session, "--out", tmp_path / "out")
    assert "bad.mp4: frame " in sentence and "is corrupt" in sentence and "--resume" in sentence
    kept = len(read_result(tmp_path / "out" / "result.h5"))
    assert kept >= 1 and f"the {kept} frames before it are kept" in sentence
    replace(session, "bad.mp4", "cam02.mp4")
    again = ("--resume", "--videos-changed", "--set", "output.overlay=false")
    assert run("track", session, "--out", tmp_path / "out", *again) == 0
    assert len(read_result(tmp_path / "out" / "result.h5")) == 8


def test_interrupt_keeps_the_result(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from twistcap.track import Tracker

    step = Tracker.step

    def impatient(self: Tracker, frame: Any) -> Any:
        if frame.index == 3:
            raise KeyboardInterrupt
        return step(self, frame)

    monkeypatch.setattr(Tracker, "step", impatient)
    assert run("track", made / "session.toml", "--out", tmp_path) == 130
    assert "the first 3 frames are kept" in " ".join(capsys.readouterr().err.split())
    assert len(read_result(tmp_path / "result.h5")) == 3


def test_a_result_without_a_frame_is_named(
    tracked: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, empty = read_result(tracked / "result.h5"), tmp_path / "empty.h5"
    with ResultWriter(empty, kept.body, kept.rig, {}):
        pass
    compared = ("evaluate", empty, "--reference", made / "truth.npz")
    for command in (("export", empty, "--to", "csv"), ("gait", empty), ("view", empty), compared):
        assert f"{empty} has no frame" in refusal(capsys, *command)


def test_bad_sessions(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every line of the issue's list of bad input that shows before the first frame."""
    whole = {path: path.read_text() for path in (session, session.parent / "Calib.toml")}
    calib = session.parent / "Calib.toml"
    short = write(session.parent / "videos" / "short.mp4", 5, (192, 140)).name
    translations = [line for line in whole[calib].splitlines() if line.startswith("translation")]
    rotations = [line for line in whole[calib].splitlines() if line.startswith("rotation")]
    cases = [
        (session, "cam02.mp4", "none.mp4", "none.mp4 does not exist"),
        (session, "cam02 =", "cam09 =", "[videos] names the camera 'cam09', which has no calibration"),
        (session, "cam02 =", "# cam02 =", "the camera 'cam02' is calibrated but has no entry in [videos]"),
        (session, "[first_pose]", "[clocks.cam09]\n[first_pose]", "[clocks] names the camera 'cam09'"),
        (session, "cam02.mp4", short, f"unequal length: {session.parent / 'videos' / short} has 5 frames"),
        (session, "body.glb", "nope.glb", f"[body] path: {session.parent / 'nope.glb'} does not exist"),
        (session, "fps =", "fsp =", "unknown key 'fsp' at the top; did you mean 'fps'?"),
        (session, "frame = 0", "frame = 3", "has no frame 3"),
        (calib, translations[0], "translation = [nan, 0.0, 1.0]", "'cam01.translation.0' is nan"),
        (calib, rotations[0], "rotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "mirrored"),
        (calib, f"{rotations[1]}\n{translations[1]}", f"{rotations[0]}\n{translations[0]}", "stand inside each other"),
    ]
    for file, old, new, sentence in cases:
        replace(file, old, new)
        told = refusal(capsys, "track", session, "--out", tmp_path / "out")
        assert sentence in told and (str(session) in told or not sentence.startswith("[")), sentence
        for path, text in whole.items():
            path.write_text(text)
    assert "unknown key 'metod' in [tracker]" in refusal(capsys, "track", session, "--set", "tracker.metod=direct")
    assert "write FIRST:LAST" in refusal(capsys, "track", session, "--frames", "3")
    assert "cannot be read" in refusal(capsys, "track", tmp_path / "none.toml")
    assert not (tmp_path / "out" / "result.h5").exists()


def test_person_underground(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The calibration's floor lies 0.8 m above the world's: heels underground."""
    replace(session, 'unit = "m"', 'unit = "m"\nfloor = 0.8')
    assert "underground" in refusal(capsys, "track", session, "--out", tmp_path / "out")


def test_bad_input_keeps_an_older_result(session: Path, tracked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (tracked / "result.h5").read_bytes()
    replace(session, "cam02.mp4", "none.mp4")
    refusal(capsys, "track", session, "--out", tracked)
    assert (tracked / "result.h5").read_bytes() == before


def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, "demo", "--out", tmp_path, "--frames", "6", "--views", "2")
    assert found["id"] == "demo" and found["ms_per_frame"] > 0 and found["rows"]
    assert all(Path(path).is_file() for path in found["files"])
    assert "src=" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("command", ["demo", "track", "studio", "evaluate", "gait", "export"])
def test_help_shows_examples(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "--help") == 0
    text = capsys.readouterr().out
    assert "Examples:" in text and f"twistcap {command}" in text and "--json" in text
