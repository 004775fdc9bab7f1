"""Tracks that are cut off, go on, or are refused to: what was written is kept."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.commands import document, interrupted, refusal, replace_text, run
from support.results import estimate, two_links
from support.videos import corrupted
from twistcap.body import Pose
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig
from twistcap.io.lock import WriteLock
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.result_schema import COLUMNS
from twistcap.report.words import result_in_words


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
        return state, [replace(e, pose=Pose(e.pose.root, e.pose.q + 0.1)) for e in last]

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


def test_resume_refuses_other_cameras(session: Path, tracked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace_text(session, 'unit = "m"', 'unit = "m"\nuse = ["cam02"]')
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
    replace_text(session, "videos/cam02.mp4", "copy.mp4")
    sentence = refusal(capsys, "track", session, "--out", tracked, "--resume")
    assert "(video of cam02, time of change differs); if the videos show the same, add --videos-changed" in sentence
    assert run("track", session, "--out", shutil.copytree(tracked, tmp_path / "o"), "--resume", "--videos-changed") == 0
    shutil.copyfile(session.parent / "videos" / "cam01.mp4", session.parent / "copy.mp4")
    sentence = refusal(capsys, "track", session, "--out", tracked, "--resume")
    assert "video of cam02, bytes was" in sentence and "video of cam02, first picture differs" in sentence
    replace_text(session, "copy.mp4", "videos/cam02.mp4")
    calib = session.parent / "Calib.toml"
    line = next(line for line in calib.read_text().splitlines() if line.startswith("distortions"))
    replace_text(calib, line, "distortions = [0.001, 0.0, 0.0, 0.0]")
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
    whole = read_result(tmp_path / "result.h5")
    assert list(whole.indices) == list(range(8)) and not whole.unfinished and not whole.within(0, 3).unfinished


def frames_in(path: Path) -> int:
    """Frames that another process has written so far; 0 while it is just writing."""
    try:
        return len(read_result(path))
    except (InputError, OSError, RuntimeError, KeyError):
        return 0


def test_corrupt_frame_loses_nothing(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = session.parent / "videos" / "cam02.mp4"
    corrupted(good, session.parent / "videos" / "bad.mp4", 0.9)
    replace_text(session, "cam02.mp4", "bad.mp4")
    sentence = refusal(capsys, "track", session, "--out", tmp_path / "out")
    assert "bad.mp4: frame " in sentence and "is corrupt" in sentence and "--resume" in sentence
    kept = len(read_result(tmp_path / "out" / "result.h5"))
    assert kept >= 1 and f"the {kept} frames before it are kept" in sentence
    replace_text(session, "bad.mp4", "cam02.mp4")
    again = ("--resume", "--videos-changed", "--set", "output.overlay=false")
    assert run("track", session, "--out", tmp_path / "out", *again) == 0
    assert len(read_result(tmp_path / "out" / "result.h5")) == 8


@pytest.mark.parametrize("in_a_kernel", [False, True])
def test_interrupt_keeps_the_result(
    in_a_kernel: bool, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba makes another error of it, which may be the reason of one more."""
    from twistcap.track import Tracker

    step = Tracker.step

    def impatient(self: Tracker, frame: Any) -> Any:
        if frame.index == 3 and in_a_kernel:
            try:
                raise SystemError("kernel returned a result with an exception set") from KeyboardInterrupt()
            except SystemError as error:
                raise SystemError("another kernel") from error
        if frame.index == 3:
            raise KeyboardInterrupt
        return step(self, frame)

    monkeypatch.setattr(Tracker, "step", impatient)
    assert run("track", made / "session.toml", "--out", tmp_path) == 130
    assert "the first 3 frames are kept" in " ".join(capsys.readouterr().err.split())
    assert len(read_result(tmp_path / "result.h5")) == 3
    assert run("export", tmp_path, "--to", "csv") == 0 and "holds 3 of 8 frames" in capsys.readouterr().err
    assert run("export", tmp_path, "--to", "csv", "--frames", "1:9") == 0
    assert "has frames 0 to 2 alone, not all of 1:9" in capsys.readouterr().err
    assert "the track holds 3 of 8 frames" in result_in_words(read_result(tmp_path / "result.h5"))


def test_what_replaces_a_result_leaves_no_file_of_it(
    made: Path, tracked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where it is stopped at once; what others wrote there stays. What goes on from there begins anew."""
    out = Path(shutil.copytree(tracked, tmp_path / "o"))
    others = {"motion.glb", "gait.csv", "mine.trc"}
    for name in others:
        (out / name).write_text(name)
    monkeypatch.setattr("twistcap.track.Tracker.step", interrupted)
    track = ("track", made / "session.toml", "--out", out, "--overwrite", "--set", "output.exports=['mot']")
    refused = run(*track, "--set", "videos.cam01='none.mp4'")
    assert refused == 2 and {"report.html", "joints.trc", "angles.csv"} <= {path.name for path in out.iterdir()}
    assert run(*track) == 130
    assert {path.name for path in out.iterdir()} == {"result.h5", *others}
    assert "nothing to resume" not in (told := capsys.readouterr().err)
    assert "interrupted: no frame was tracked yet; begin anew" in told and "frames are kept" not in told
    for folder in (out, tmp_path / "new"):
        assert run("track", made / "session.toml", "--out", folder, "--resume") == 130
        said = f"{folder / 'result.h5'} holds no tracked frame: there is nothing to resume, and tracking begins anew"
        assert said in capsys.readouterr().err


def test_bad_input_keeps_an_older_result(session: Path, tracked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (tracked / "result.h5").read_bytes()
    replace_text(session, "cam02.mp4", "none.mp4")
    refusal(capsys, "track", session, "--out", tracked)
    assert (tracked / "result.h5").read_bytes() == before
