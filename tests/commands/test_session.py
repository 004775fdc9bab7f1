"""`twistcap session`: a session checked, and the settings listed as they are in code and docs."""

from __future__ import annotations

import shutil
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path

import pytest
from pygltflib import GLTF2

from support.commands import document, interrupted, refusal, run
from support.videos import corrupted, write
from twistcap.body import gltf
from twistcap.differential.settings import DifferentialConfig
from twistcap.io import exports
from twistcap.io.provenance import made_of
from twistcap.io.recording import body_in_words, open_recording
from twistcap.io.session import load_session
from twistcap.io.session_check import check_session
from twistcap.settings import Settings

FILE = 'file = "first_pose.npz"\nframe = 0\nrefine = false'
PAGE = Path(__file__).parents[2] / "docs" / "formats" / "settings.md"


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("studio") / "walk"
    assert run("studio", folder, "--size", "96x70", "--views", "2", "--frames", "2") == 0
    return folder


def test_every_setting_is_listed_with_its_default(capsys: pytest.CaptureFixture[str]) -> None:
    listed = {row["key"]: row for row in document(capsys, "session", "--explain")["settings"]}
    page = " ".join(PAGE.read_text(encoding="utf-8").split())
    assert len(listed) <= 45
    names = {f"tracker.{item.name}" for item in fields(Settings) if item.name != "differential"}
    assert names | {f"tracker.differential.{item.name}" for item in fields(DifferentialConfig)} == set(listed)
    for key, row in listed.items():
        name = key.rpartition(".")[2]
        assert len(row["meaning"]) > 20
        assert f"**`{name}`** (`{row['default']}`):" in page, f"docs/formats/settings.md lacks {name}"


def test_the_list_is_readable(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("session", "--explain") == 0
    assert "tracker.surface_sigma" in capsys.readouterr().out


def test_a_session_is_checked(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no file is named" in refusal(capsys, "session")
    found = document(capsys, "session", walk / "session.toml")
    assert len(found["cameras"]) == 2
    assert run("session", walk / "session.toml") == 0


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("fps = 60.0", "frames = [50, 20]", "frames: [50, 20] is no range; write [first, last]"),
        ("fps = 60.0", "frames = [0, 20]", "has only 2 frames (0 to 1); set frames = [0, 1]"),
        ("body.glb", "nope.glb", "[body] path: {}/nope.glb does not exist"),
        ("first_pose.npz", "x.json", "[first_pose] file: {}/x.json does not exist"),
        ("cam02.mp4", "none.mp4", "none.mp4 does not exist; check its path in [videos]"),
        ("cam02.mp4", "../videos/cam01.mp4", "cam01.mp4 to 'cam01' and to 'cam02'; give each camera its own"),
        (FILE, 'detector = "rtmo.onnx"', "model {}/rtmo.onnx does not exist; check the path"),
        (FILE, 'detector = "nobodys"', "detector 'nobodys' is not installed"),
        (FILE, 'keypoints = { folders = { cam01 = "k" } }', "keypoint folders of cam01: {}/k does not exist"),
        ("[first_pose]", '[prior]\npath = "p.npz"\n[first_pose]', "[prior] path: {}/p.npz does not exist"),
    ],
)
def test_what_a_track_would_refuse_is_refused(
    walk: Path, tmp_path: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(shutil.copytree(walk, tmp_path / "walk")) / "session.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    sentence = refusal(capsys, "session", path)
    assert told.format(path.parent) in sentence and str(path.parent) in sentence


def test_a_video_that_was_cut_off_is_refused(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(shutil.copytree(walk, tmp_path / "walk"))
    whole = write(path / "videos" / "cam01.mp4", size=(96, 70))
    corrupted(whole, path / "videos" / "cam02.mp4")
    sentence = refusal(capsys, "session", path / "session.toml")
    assert "cam02.mp4" in sentence and "corrupt" in sentence


def test_a_frame_rate_that_replaces_the_videos_is_said(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(shutil.copytree(walk, tmp_path / "walk")) / "session.toml"
    assert run("session", path) == 0 and "is believed" not in capsys.readouterr().err
    path.write_text(path.read_text().replace("fps = 60.0", "fps = 25.0"))
    assert run("session", path) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "fps = 25 of the session is believed, not the 60 of video" in said


def test_a_first_pose_of_another_frame_is_said(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the first frame is tracked."""
    path = walk / "session.toml"
    monkeypatch.setattr("twistcap.track.Tracker.step", interrupted)
    for frames, said in (("0:1", False), ("1:1", True)):
        assert run("track", path, "--out", tmp_path, "--frames", frames) == 130
        told = " ".join(capsys.readouterr().err.split())
        assert said == ("the first pose is of frame 0, and tracking begins at frame 1: the person may be lost" in told)
        assert said == ("give a first pose of frame 1, or begin at frame 0." in told)


def test_a_glb_is_parsed_once(walk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed, loaded = list[Path](), gltf._loaded  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(gltf, "_loaded", lambda path, rig: (parsed.append(path), loaded(path, rig))[1])
    session = load_session(walk / "session.toml")
    check_session(session)
    assert body_in_words(session) == "" and made_of(session, open_recording(session).views)["body"]
    assert len(parsed) == 1


@pytest.mark.parametrize("q", ["{}", '{"lumbar_extension": 0.1}'])
def test_a_glb_of_which_no_rig_is_known_is_said(
    walk: Path, tmp_path: Path, q: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The studio's body as if another program had written it: its bones have nobody's names."""
    folder = Path(shutil.copytree(walk, tmp_path / "w"))
    file = GLTF2().load(str(folder / "body.glb"))
    assert file is not None
    file.asset.extras = file.skins[0].extras = {}
    file.save(str(folder / "body.glb"))
    root = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]"
    (folder / "first_pose.json").write_text(f'{{"root": {root}, "q": {q}}}')
    path = folder / "session.toml"
    path.write_text(path.read_text().replace(FILE, 'file = "first_pose.json"'))
    if q != "{}":
        sentence = refusal(capsys, "session", path)
        assert "extension'; check [body]; a GLB of no known rig needs a rig file (" in sentence
        assert run("track", path, "--out", tmp_path / "out") == 2
        told = " ".join(capsys.readouterr().err.split())
        assert 0 < told.find("its rig is not known (") < told.find("twistcap: ")
    else:
        sentence = document(capsys, "session", path)["body"]
        assert "its rig is not known (" in sentence
        assert "of its 18 bones are found by name" in sentence
    assert sentence.rstrip(".").endswith("rig file (docs/formats/body-files.md)")


@pytest.mark.parametrize(("kind", "module"), [("c3d", "ezc3d"), ("usd", "pxr")])
def test_an_export_that_lacks_its_package_is_refused_before_the_work(
    kind: str, module: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(exports, "find_spec", lambda name: None if name == module else find_spec(name))
    said = refusal(capsys, "track", session, "--out", tmp_path / "out", "--set", f'output.exports=["trc", "{kind}"]')
    assert f"pip install 'twistcap[{kind}]'" in said and not (tmp_path / "out" / "result.h5").exists()
