"""The command line from end to end on a small studio session, and one clear sentence for every bad input."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.commands import document, refusal, replace_text, run
from support.videos import write
from twistcap.body.humanoid import humanoid
from twistcap.io.motion_files import write_mot
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.video import VideoSource
from twistcap.studio.motion import gait


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


def test_motions_carry_the_track_over_missing_images(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The library has another rate than the recording; --resume goes on with it."""
    body = humanoid()
    write_mot(tmp_path / "walk.mot", body, np.arange(120) / 60.0, gait(body, fps=60.0, frames=120, speed=1.2))
    made = document(capsys, "motions", "build", tmp_path / "walk.npz", tmp_path / "walk.mot", "--fps", "30")
    assert document(capsys, "motions", "show", tmp_path / "walk.npz") == made
    assert made["rate"] == 30.0 and made["clips"][0]["poses"] == 60
    replace_text(session, "[first_pose]", f'[motions]\npath = "{tmp_path / "walk.npz"}"\nkind = "scaled"\n[first_pose]')
    for camera in ("cam01", "cam02"):
        folder = session.parent / camera
        folder.mkdir()
        video = cv2.VideoCapture(str(session.parent / "videos" / f"{camera}.mp4"))
        for k in range(8):
            if (image := video.read()[1]) is not None and k != 6:
                cv2.imwrite(str(folder / f"{k:04d}.png"), image)
        replace_text(session, f"videos/{camera}.mp4", f"{camera}/%04d.png")
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
        replace_text(file, old, new)
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
    replace_text(session, 'unit = "m"', 'unit = "m"\nfloor = 0.8')
    assert "underground" in refusal(capsys, "track", session, "--out", tmp_path / "out")


@pytest.mark.usefixtures("drawn")
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
