"""Session files: strictness, precedence, paths, and what they become."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.cameras import ring
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.io.calibration import write_rig
from twistcap.io.motion_library import write_library
from twistcap.io.pose_file import read_pose, write_pose
from twistcap.io.recording import body_of, check_first_pose, keypoints_of, open_recording, rig_of
from twistcap.io.session import Session, load_session
from twistcap.io.start_report import other_frame_in_words
from twistcap.motion import MotionClip, MotionLibrary

SESSION = """
frames = [2, 9]
fps = 50.0
[cameras]
calibration = "Calib.toml"
[videos]
cam0 = "${VIDEOS:-videos}/cam0.mp4"
[body]
variant = "legs"
stature = 1.8
[first_pose]
file = "pose.json"
[tracker]
method = "direct"
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "s.toml").write_text(SESSION)
    write_rig(ring(), tmp_path / "Calib.toml")
    return tmp_path / "s.toml"


def changed(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize("table", ["", "[first_pose]", "[first_pose]\nauto = true", 'first_pose = "auto"'])
def test_where_no_first_pose_is_given_it_is_looked_for(path: Path, table: str) -> None:
    text = path.read_text().replace('[first_pose]\nfile = "pose.json"\n', "")
    path.write_text(f"{table}\n{text}" if "=" in table and "[" not in table else f"{text}\n{table}\n")
    assert load_session(path).first_pose.unaided
    assert load_session(path, {"first_pose.fit_lengths": False}).first_pose.fit_lengths is False
    (path.parent / "first_pose.json").write_text("{}")
    assert load_session(path).first_pose.unaided is ("auto" in table)


def test_values_defaults_and_paths(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = load_session(path)
    assert (session.frames, session.fps, session.step, session.scale) == ((2, 9), 50.0, 1, 1.0)
    assert session.cameras.calibration == str(path.parent / "Calib.toml")
    assert session.videos == {"cam0": str(path.parent / "videos" / "cam0.mp4")}
    monkeypatch.setenv("VIDEOS", "/elsewhere")
    assert load_session(path).videos == {"cam0": "/elsewhere/cam0.mp4"}
    changed(path, "fps", 'data = "sub"\nfps')
    assert load_session(path).cameras.calibration == str(path.parent / "sub" / "Calib.toml")


def test_command_line_over_session_over_defaults(path: Path) -> None:
    from twistcap.settings import Settings

    assert load_session(path).tracker_settings == Settings()
    session = load_session(path, {"tracker.method": "levelset", "scale": 0.5, "frames": (0, 3), "fps": None})
    assert session.tracker_settings.method == "levelset" and session.scale == 0.5
    assert (session.frames, session.fps) == ((0, 3), 50.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fps = 50.0", "fpz = 50.0", r"unknown key 'fpz' at the top; did you mean 'fps'\?"),
        ("stature", "statur", r"unknown key 'statur' in \[body\]; did you mean 'stature'\?"),
        ("method", "metod", r"unknown key 'metod' in \[tracker\]; did you mean 'method'\?"),
        ("[videos]", "[vidoes]", r"unknown key 'vidoes' at the top; did you mean 'videos'\?"),
        ('"direct"', '"dirct"', "'tracker.method' is 'dirct'; it must be 'direct', 'levelset' or 'differential'"),
        ("1.8", "'tall'", "'body.stature' is 'tall'; it must be a number"),
        ("1.8", "'1.8'", "'body.stature' is '1.8'; it must be a number"),
        ("1.8", "true", "'body.stature' is True; it must be a number"),
        ("1.8", "nan", "'body.stature' is nan"),
        ("[2, 9]", "[2]", "the list 'frames' has too few entries; it needs 2"),
        ("[2, 9]", "[-2, 9]", "'frames' holds -2; it must be greater than or equal to 0"),
        ("[2, 9]", "[9, 2]", r"frames: \[9, 2\] is no range; write \[first, last\]"),
        ("[2, 9]", "30", r"'frames' is 30; it must be a list, such as \[0, 30\]"),
        ("[2, 9]", "'2:9'", r"'frames' is '2:9'; it must be a list, such as \[2, 9\]"),
        ("[2, 9]", "[1, 2, 3]", r"'frames' is \[1, 2, 3\]; it must be a list of 2 or fewer"),
        ("[tracker]", '[output]\nexports = "trc"\n[tracker]', r"it must be a list, such as \['trc'\]"),
        ("[tracker]", '[output]\nexports = "[trc, csv]"\n[tracker]', r"it must be a list, such as \['trc', 'csv'\]"),
        ("[2, 9]", "'[2, 9'", r"'frames' is '\[2, 9'; it must be a list, such as \[2, 9\]"),
        ("[tracker]", '[output]\nexports = ["trcs"]\n[tracker]', "output.exports: there is no export format 'trcs'"),
        ("[tracker]", '[clocks]\ncam0.offset = "1"\n[tracker]', "'clocks.cam0.offset' is '1'; it must be a number"),
        ("[videos]", 'floor = "low"\n[videos]', "'cameras.floor' is 'low'; it must be a number or false"),
        ('"direct"', '"direct"\nsurface_sigma = -1', "toml: tracker: surface_sigma is -1.0; it must"),
        (
            'file = "pose.json"',
            'file = "pose.json"\nat = { cam0 = [1, 2] }',
            "at says whom to look for, but file gives",
        ),
        ('file = "pose.json"', "auto = false", "auto is false; give one of file, clicks, keypoints and detector"),
        (
            "[first_pose]",
            "[first_pose]\nauto = true",
            "first_pose: give one of auto, file, clicks, keypoints and detector, not auto and file",
        ),
        ('variant = "legs"', 'kind = "glb"', "the key 'body.path' is missing"),
        ('variant = "legs"', 'kind = "smpl"', "'body.kind' is 'smpl'; it must be 'humanoid', 'glb' or 'obj'"),
        ("${VIDEOS:-videos}", "${VIDEOS}", "environment variable VIDEOS is not set"),
        ("[cameras]", "[cameras", "not valid TOML"),
        (
            '"direct"',
            '"direct"\npredictor = "flow"\n[motions]\npath = "m.npz"',
            "tracker.predictor is 'flow'; remove one",
        ),
        ('"direct"', '"direct"\npredictor = "motion"', r"is 'motion', but no \[motions\] names a library"),
        ('"direct"', '"direct"\ndifferential = {levls = 9}', r"unknown key 'levls' in \[tracker.differential\]"),
        ('"direct"', '"direct"\nkeypoint_sigma = 0.0', "keypoint_sigma is 0.0; it must be a finite number above 0"),
        ('"direct"', '"direct"\n[motions]\npath = "m.npz"\nkind = "folowed"', "'motions.kind' is 'folowed'"),
        (
            '"direct"',
            '"differential"\n[prior]\npath = "p.npz"\n[motions]\npath = "m.npz"',
            r"uses brightness alone; remove \[prior\] and \[motions\]",
        ),
    ],
)
def test_what_is_wrong_is_refused_in_one_sentence(path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_session(changed(path, old, new))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("scale", -1, r"s\.toml, with scale, fps set over it: 'scale' is -1"),
        (
            "first_pose",
            "foo",
            r"with first_pose, fps set over it: 'first_pose' is 'foo'; it must be a table, or 'auto'",
        ),
        ("tracker.predictor", "motion", r"with tracker\.predictor, fps set over it: .* names a library"),
        ("videos.cam0.path", "a.mp4", r"videos\.cam0\.path = 'a\.mp4': 'cam0' holds no keys"),
    ],
)
def test_what_the_command_line_says_wrong_is_not_the_files_fault(
    path: Path, key: str, value: object, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        load_session(path, {key: value, "fps": 25.0})
    with pytest.raises(InputError, match=r"with scale, fps, step, … set over it: 'scale'"):
        load_session(path, {"scale": -1, "fps": 25.0, "step": 2, "time_offset": 0.1})
    with pytest.raises(InputError, match=r"s\.toml: unknown key 'fpz'"):  # the file's own goes first
        load_session(changed(path, "fps", "fpz"), {"scale": 0.5})


def test_motions_make_motion_the_predictor(path: Path) -> None:
    assert load_session(path).motion_library is None
    changed(path, "[tracker]", '[motions]\npath = "walk.npz"\n[tracker]')
    session = load_session(path, {"tracker.motion": "unscaled"})
    assert (session.tracker_settings.predictor, session.tracker_settings.motion) == ("motion", "unscaled")
    session = load_session(path, {"tracker.predictor": "motion"})
    assert (session.tracker_settings.predictor, session.tracker_settings.motion) == ("motion", "followed")
    for kind in ("scaled", "guarded"):
        assert load_session(path, {"motions.kind": kind}).tracker_settings.motion == kind
    with pytest.raises(InputError, match=r"walk\.npz does not exist"):
        _ = session.motion_library
    t = np.arange(90)[:, None] / 30.0
    clip = MotionClip("walk", ("knee_angle_r",), 30.0, np.tile(np.eye(4), (90, 1, 1)), np.sin(t))
    write_library(path.parent / "walk.npz", MotionLibrary.of([clip], 30.0))
    library = session.motion_library
    assert library is not None and (library.rate, library.names, len(library)) == (30.0, ("knee_angle_r",), 90)


def test_missing_session(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none.toml cannot be read: No such file"):
        load_session(tmp_path / "none.toml")


def test_body_and_first_pose(path: Path) -> None:
    session = load_session(path)
    body = body_of(session)
    assert "knee_angle_r" in body.coordinate_names and "elbow_flex_r" not in body.coordinate_names
    q = np.linspace(-0.1, 0.1, len(body.coordinate_names))
    root = np.eye(4)
    root[2, 3] = 0.95
    write_pose(path.parent / "pose.json", body, Pose(root, q))
    read = read_pose(path.parent / "pose.json", body)
    np.testing.assert_allclose(read.q, q)
    np.testing.assert_allclose(read.root, root)


@pytest.mark.parametrize(("frame", "said"), [(None, False), (2, False), (0, True), (True, False), ("0", False)])
def test_a_pose_that_says_its_frame_is_held_against_the_first_one(path: Path, frame: Any, said: bool) -> None:
    session = load_session(path)  # from frame 2
    body = body_of(session)
    write_pose(path.parent / "pose.json", body, Pose.rest(body), frame=frame)
    words = "is of frame 0, and tracking begins at frame 2"
    assert (words in other_frame_in_words(session)) == said == bool(other_frame_in_words(session))


def test_first_pose_must_be_possible(path: Path) -> None:
    session = load_session(changed(path, 'variant = "legs"', 'variant = "full"'))
    rig, body = rig_of(session), body_of(session)
    standing, buried, head_down = np.eye(4), np.eye(4), np.diag([1.0, -1, -1, 1])
    standing[2, 3], head_down[2, 3] = 0.95, 1.0
    q = np.zeros(len(body.coordinate_names))
    check_first_pose(session, rig, body, Pose(standing, q))
    with pytest.raises(InputError, match="underground"):
        check_first_pose(session, rig, body, Pose(buried, q))
    with pytest.raises(InputError, match="stands on the head"):
        check_first_pose(session, rig, body, Pose(head_down, q))
    allowed = load_session(changed(path, 'file = "pose.json"', 'file = "pose.json"\nupright = false'))
    check_first_pose(allowed, rig, body, Pose(head_down, q))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{}", "must be JSON"),
        ('{"root": [[1, 0], [0, 1]], "q": {}}', "4 ?× ?4"),
        ('{"root": [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "q": {}}', "4×4 rigid motion"),
        ('{"root": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "q": {"tail": 0}}', "no coordinate 'tail'"),
        ('{"root": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "q": {"knee_angle_r": NaN}}', "write a finite number"),
    ],
)
def test_bad_pose_files(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "p.json").write_text(content)
    with pytest.raises(InputError, match=message):
        read_pose(tmp_path / "p.json", humanoid("legs"))


def test_cameras_in_use(path: Path) -> None:
    changed(path, 'calibration = "Calib.toml"', 'calibration = "Calib.toml"\nuse = ["cam2", "cam0"]')
    assert rig_of(load_session(path)).names == ("cam2", "cam0")
    with pytest.raises(InputError, match=r"\[cameras\] use names 'cam9'.*it has cam0, cam1"):
        rig_of(load_session(changed(path, "cam2", "cam9")))


def example(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    monkeypatch.setenv("TWISTCAP_DATA", str(shared_data))
    fewer = {"first_pose.keypoints.frames": [0, 1], "first_pose.lengths_from": []}  # of the same, to be quick
    return load_session(Path(__file__).parents[2] / "examples" / "balance_4view.toml", fewer)


def test_real_first_pose_lies_on_the_reference(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keypoints 1.3 frames ahead of the video, some in another pixel grid."""
    session = example(shared_data, monkeypatch)
    rig = rig_of(session)
    assert session.first_pose.keypoints is not None
    found = keypoints_of(session.first_pose.keypoints, rig)
    X = np.load(shared_data / "balance_4view" / "reference" / "keypoints3d_world.npz")["X"]
    knee = found[0].names.index("knee_l")
    for camera, pixels in zip(rig, found[0].pixels[:, knee], strict=True):
        assert np.linalg.norm(camera.project(X[0, knee])[0] - pixels) < 15.0  # with the grid left out: 7 px more

    recording = open_recording(session)
    posed = Posed(recording.body, recording.first_pose)
    marks = dict(zip(posed.body.landmarks.names, posed.landmarks, strict=True))
    distances = [np.linalg.norm(marks[name] - X[0, i]) for i, name in enumerate(found[0].names) if name in marks]
    assert np.median(distances) < 0.04 and max(distances) < 0.12


def test_every_key_is_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "formats" / "session.md").read_text()
    from twistcap.io import session as module

    tables = [v for v in vars(module).values() if isinstance(v, type) and issubclass(v, module.Table)]
    for table in tables:
        for key in table.model_fields:
            assert re.search(rf"`{key}\b", page), f"docs/formats/session.md lacks {table.__name__}.{key}"


def test_a_session_over_another_one(path: Path) -> None:
    other = path.parent / "sub" / "other.toml"
    other.parent.mkdir()
    other.write_text('base = "../s.toml"\nfps = 30.0\n[tracker]\nchannels = "grey"\n')
    session = load_session(other, {"tracker.predictor": "flow"})
    assert (session.fps, session.frames) == (30.0, (2, 9))
    config = session.tracker_settings
    assert (config.method, config.channels, config.predictor) == ("direct", "grey", "flow")
    assert session.cameras.calibration == str(path.parent / "Calib.toml")  # as in the base, not beside the other one

    changed(path, "fps", 'base = "other.toml"\nfps')
    with pytest.raises(InputError, match="has a base itself"):
        load_session(other)
    changed(other, "../s.toml", "none.toml")
    with pytest.raises(InputError, match=r"none\.toml cannot be read"):
        load_session(other)


def test_a_session_toml_has_the_name_of_its_folder(tmp_path: Path) -> None:
    """`new` and `studio` call all of theirs so; headings and folders of two sessions must differ."""
    for name, title in (("session.toml", "walk"), ("run.toml", "run")):
        path = tmp_path / "walk" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text('[cameras]\ncalibration = "Calib.toml"\n[videos]\ncam01 = "a.mp4"\n')
        assert load_session(path).title == title


def test_what_a_result_keeps_of_a_session_is_a_session(tmp_path: Path) -> None:
    """`refine` and `view` read it again; a session that named no first pose was refused there."""
    path = tmp_path / "a.toml"
    path.write_text('[cameras]\ncalibration = "Calib.toml"\n[videos]\ncam01 = "a.mp4"\n')
    for first_pose in ("", "[first_pose]\nauto = true\n", '[first_pose]\nfile = "pose.json"\n'):
        path.write_text(path.read_text().partition("[first_pose]")[0] + first_pose)
        kept = load_session(path).model_dump(mode="json")
        assert Session.model_validate(kept, context={"folder": Path()}).model_dump(mode="json") == kept
