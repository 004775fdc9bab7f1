"""What people type by mistake: each ends with one sentence that names the option and the mend, before any work."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, cast

import pytest

from support.cameras import ring
from support.commands import refusal, replace_text, run
from support.results import estimate, two_links
from twistcap.body.humanoid import humanoid
from twistcap.commands import terminal
from twistcap.io.calibration import write_rig
from twistcap.io.result import ResultWriter
from twistcap.io.synthetic import write_session
from twistcap.studio import StudioConfig, capture


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with a calibration, a result of three frames, a text and an empty folder."""
    monkeypatch.chdir(tmp_path)
    write_rig(ring(), Path("Calib.toml"))
    body = two_links()
    with ResultWriter("result.h5", body, ring(), {}) as writer:
        for k in range(3):
            writer.append(estimate(k))
    Path("notes.txt").write_text("a text")
    Path("empty").mkdir()
    Path("seen.npz").write_text("a file that is read")
    Path("kept.trc").write_text("a text")
    Path("kept.trc").chmod(0o444)
    return tmp_path


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("motions build notes.txt result.h5", "OUT is notes.txt; name a file that ends in .npz."),
        ("view result.h5 --json", "view: --json goes with --save; a page that is served has no document."),
        ("prior train walk1.mot result.h5", "OUT is walk1.mot; name a file that ends in .npz."),
        ("convert Calib.toml x.mp4", "OUT is x.mp4; name a file that ends in .toml."),
        ("convert Calib.toml c.txt --to qualisys", "OUT is c.txt; name a file that ends in .qca.txt."),
        ("convert Calib.toml Calib.toml", "Calib.toml is not replaced: it is one of the files that this command reads"),
        ("prior train seen.npz result.h5 seen.npz", "seen.npz is not replaced: it is one of the files that this"),
        ("motions build seen.npz notes.txt seen.npz", "seen.npz is not replaced: it is one of the files that this"),
        ("export result.h5 --to trc --out kept.trc", "kept.trc is not replaced: it is read-only; choose another place"),
        ("convert Calib.toml notes.txt --to opencv", "folder notes.txt cannot be made: File exists; choose"),
        ("convert Calib.toml x.toml --unit km", "--unit is 'km'; write m, cm, mm, or the length of one unit in m"),
        ("convert Calib.toml x.toml --size 0x0", "--size is '0x0'; write WIDTHxHEIGHT"),
        ("studio new --drop foo", "--drop is 'foo'; write FIRST:LAST"),
        ("studio new --fps nan", "--fps: it is nan; give a number above 0."),
        ("studio new --speed 0", "--speed: it is 0; give a number above 0."),
        ("studio notes.txt", "folder notes.txt cannot be made: File exists; choose another folder."),
        ("export result.h5 --to trc --frames 100:200", "no frame in 100:200; it has 0 to 2, see --frames."),
        ("export result.h5 --to trc --frames 2:1", "--frames is '2:1', a range that is reversed; write 1:2."),
        ("studio new --frames 20 --drop 15:20", "--drop: it ends at 20, but the last frame is 19."),
        ("studio new --drop 12:9", "--drop is '12:9', a range that is reversed; write 9:12."),
        ("gait result.h5 --norms none.json", "none.json cannot be read: No such file or directory; check its path."),
        ("motions show empty", "twistcap: empty cannot be read: it is no file; check its path."),
        ("evaluate result.h5 --reference none.trc --axes up", "--axes is 'up'; it must be one of opensim"),
    ],
)
def test_one_sentence_names_the_mend(place: Path, line: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert told in refusal(capsys, *line.split())
    assert Path("notes.txt").read_text() == Path("kept.trc").read_text() == "a text" and not Path("walk1.mot").exists()
    assert Path("seen.npz").read_text() == "a file that is read"


@pytest.mark.parametrize(
    "options",
    ["--out hero.glb --into hero.glb", "--out body.glb", "--out link.glb", "--out cam.glb", ""],
)
def test_an_export_replaces_nothing_that_is_read(place: Path, options: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither what the command names nor what the session does: not by a link, nor by a format's usual name."""
    named = ["hero.glb", "body.glb", "cam.glb", "motion.glb"]
    for name in named:
        Path(name).write_text(name)
    Path("link.glb").symlink_to("body.glb")
    config = {"body": {"path": "body.glb"}, "videos": {"a": "cam.glb"}, "first_pose": {"lengths_from": ["motion.glb"]}}
    with ResultWriter("result.h5", two_links(), ring(), config) as writer:
        writer.append(estimate(0))
    told = refusal(capsys, "export", "result.h5", "--to", "glb", *options.split())
    assert "is not replaced: it is one of the files that this command reads, or that its session names; choose" in told
    assert [Path(name).read_text() for name in named] == named and Path("link.glb").is_symlink()


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    write_session(capture(StudioConfig(views=2, frames=3, size=(64, 48))), folder, masks=False)
    return folder


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--videos", ""), "--videos is ''; give a path, or CAMERA=PATH."),
        (("--videos", "cam01="), "--videos is 'cam01='; give a path, or CAMERA=PATH."),
        (("--videos", "cam01=videos"), "folder videos holds no images; give camera 'cam01' one video, or a folder"),
        (("--videos", "videos", "--detector", "none.onnx"), "model none.onnx does not exist; check the path"),
        (("--videos", "videos", "--detector", "nobody"), "detector 'nobody' is not installed"),
    ],
)
def test_new_writes_nothing_of_what_is_not_there(
    walk: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(walk)
    assert told in refusal(capsys, "new", "mine", "--calibration", "Calib.toml", *options)
    assert not Path("mine").exists()


def test_a_place_that_cannot_be_written_is_told_before_the_work(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(walk)
    for line in (
        "calibrate Calib.toml --board charuco:5x7:36:27:4X4_50 --videos videos",
        "init session.toml --out Calib.toml/pose.json",
    ):
        assert "folder Calib.toml cannot be made" in refusal(capsys, *line.split())


@pytest.mark.parametrize(
    "line",
    [
        "body fit session.toml --out .",
        "init session.toml --out body.json",
        "track session.toml --out . --set output.exports=['glb']",
    ],
)
def test_what_the_session_names_is_not_replaced(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is told before the work."""
    monkeypatch.chdir(shutil.copytree(walk, tmp_path / "walk"))
    name = {"init": "body.json", "track": "motion.glb"}.get(line.split()[0], "body.glb")
    Path("body.glb").rename(name)
    replace_text(Path("session.toml"), "body.glb", name)
    if name == "body.json":
        monkeypatch.setattr("twistcap.io.recording.body_of", lambda _: humanoid())
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    assert f"{name} is not replaced: it is one of the files that this" in refusal(capsys, *line.split())
    assert before == {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def test_a_file_that_may_not_be_written_is_told_with_a_mend(capsys: pytest.CaptureFixture[str]) -> None:
    def app(**_: object) -> None:
        raise PermissionError(13, "Permission denied", "x.toml")

    with pytest.raises(SystemExit, match="2"):
        terminal.run_command(cast(Any, app), "twistcap", [])
    told = "twistcap: x.toml cannot be used: Permission denied; choose another place, or see who may write there.\n"
    assert capsys.readouterr().err == told


def test_videos_changed_goes_with_resume(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = refusal(capsys, "track", walk / "session.toml", "--out", tmp_path / "out", "--videos-changed")
    assert "--videos-changed is for --resume; give both." in told


def test_a_calibration_makes_its_folder(place: Path) -> None:
    assert run("convert", "Calib.toml", "new/deep/Calib.toml") == 0
    assert Path("new/deep/Calib.toml").is_file()


def test_paths_are_printed_as_they_are(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Brackets are no markup, and a long path is not broken into lines."""
    monkeypatch.setattr(terminal.words, "_width", 40)
    session = Path(shutil.copytree(walk, tmp_path / "a [red] walk ü")) / "session.toml"
    assert run("session", session) == 0
    assert f"{session} is a session with 2 videos" in capsys.readouterr().err


def test_a_bad_number_of_the_studio_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for option, value in (("--noise", "5"), ("--rectangles", "-4"), ("--occluders", "-1"), ("--blur", "0")):
        assert run("studio", tmp_path / "s", option, value) == 2
        assert option in capsys.readouterr().err
    assert not (tmp_path / "s").exists()
