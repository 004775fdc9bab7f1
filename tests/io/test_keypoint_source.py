"""Keypoints of all frames in a session: where a body is looked for, and as a cue."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.commands import refusal, run
from support.elsewhere import BACK, GAP, greatest_error, keypoints, scene
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io import detectors
from twistcap.io.calibration import write_rig
from twistcap.io.keypoint_source import KeypointSource
from twistcap.io.keypoints import LAYOUTS
from twistcap.io.recording import rig_of, views_of
from twistcap.io.result import read_result
from twistcap.io.session import load_session

LAYOUT = LAYOUTS["halpe_26"]
FOLDERS = 'keypoints = { format = "halpe_26", folders = { %s } }'


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Calibration, pictures and keypoint files of someone who is elsewhere after a gap."""
    folder, (made, frames) = tmp_path_factory.mktemp("filmed"), scene()
    write_rig(made.rig, folder / "Calib.toml")
    for c, name in enumerate(made.rig.names):
        for kind in ("videos", "keypoints"):
            (folder / kind / name).mkdir(parents=True)
        for frame in frames:
            if (image := frame.images[c]) is not None:
                cv2.imwrite(str(folder / "videos" / name / f"{frame.index:03d}.png"), image[..., ::-1])
            (folder / "keypoints" / name / f"{frame.index:03d}.json").write_text(_people(c, frame.index))
    return folder


def _people(camera: int, index: int) -> str:
    """Of one camera's picture; nobody in the gap."""
    found, rows = keypoints(index), np.zeros((len(LAYOUT), 3))
    for k, name in enumerate(LAYOUT):
        if name in found.names:
            rows[k] = *found.pixels[camera, found.names.index(name)], 0.9
    people = [] if index in GAP else [{"pose_keypoints_2d": rows.ravel().tolist()}]
    return json.dumps({"people": people})


def session(folder: Path, first_pose: str = FOLDERS, more: str = "") -> Path:
    names = scene()[0].rig.names
    videos = "\n".join(f'{name} = "videos/{name}/%03d.png"' for name in names)
    folders = ", ".join(f'{name} = "keypoints/{name}"' for name in names)
    path = folder / "session.toml"
    path.write_text(
        f'fps = 30\n{more}\n[cameras]\ncalibration = "Calib.toml"\n[videos]\n{videos}\n[body]\nstature = 1.75\n'
        f"[first_pose]\nfit_lengths = false\n{first_pose % folders if '%s' in first_pose else first_pose}\n"
        "[output]\noverlay = false\nreport = false\n"
    )
    return path


@pytest.mark.parametrize("use", ["start", "search", "cue"])
def test_a_session_says_what_its_keypoints_are_for(use: str, filmed: Path, tmp_path: Path) -> None:
    given = () if use == "search" else ("--set", f"keypoints={use}", "--frames", f"0:{BACK + 2}")  # it is the default
    assert run("track", session(filmed), "--out", tmp_path / use, *given) == 0
    result = read_result(tmp_path / use / "result.h5")
    found = [greatest_error(e.index, e.pose) < 0.05 for e in result.estimates[BACK:]]
    assert all(found) if use != "start" else not any(found)
    assert ("keypoints" in result.energies) == (use == "cue")
    assert all(result.estimates[k].status == "no_images" for k in GAP)
    if use == "cue":
        assert np.flatnonzero(np.isnan(result.energies["keypoints"])).tolist() == list(GAP)


def test_files_are_those_of_the_frame(filmed: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(filmed, tmp_path / "filmed"))
    loaded = load_session(session(folder))
    views, table = views_of(loaded, rig_of(loaded)), loaded.first_pose.keypoints
    assert table is not None
    late = table.model_copy(update={"offset": 1.3, "person": 0})
    source = KeypointSource(late, views)
    found, truth = source(6), keypoints(5)
    assert found is not None
    knee = (slice(None), found.names.index("knee_r"))
    agreeing = np.isfinite(found.pixels[knee]).all(axis=1)  # a view that the others contradict gives none
    assert agreeing.sum() >= 3
    assert np.allclose(found.pixels[knee][agreeing], truth.pixels[agreeing, truth.names.index("knee_r")])
    assert source(0) is None  # file -1
    assert source(GAP[4]) is None  # nobody
    camera = views.rig.names[0]
    sorted((folder / "keypoints" / camera).glob("*.json"))[-1].unlink()
    assert KeypointSource(table, views)(views.indices[-1]) is None
    (folder / "keypoints" / camera / "003.json").write_text("{")
    with pytest.raises(InputError, match=r"003\.json"):
        KeypointSource(table, views)(3)


def test_a_detector_is_asked_only_where_the_body_is_looked_for(
    filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, frames = scene()
    asked = list[int]()

    def detect(images: list[np.ndarray], rig: Rig) -> Keypoints:
        """Knows the frame by its picture."""
        index = next(f.index for f in frames if f.images[0] is not None and np.array_equal(images[0], f.images[0]))
        asked.append(index)
        return keypoints(index)

    monkeypatch.setattr(detectors, "detector", lambda name: detect)
    assert run("track", session(filmed, 'detector = "mine"'), "--out", tmp_path / "out") == 0
    result = read_result(tmp_path / "out" / "result.h5")
    assert asked == [0, BACK, BACK + 1]  # the first pose, and twice after the gap
    assert greatest_error(BACK, result.estimates[BACK].pose) < 0.05


def test_a_cue_needs_keypoints(filmed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cue = 'keypoints = "cue"'
    said = refusal(capsys, "track", session(filmed, "auto = true", cue), "--out", filmed / "out")
    assert "names neither keypoints nor a detector" in said
    said = refusal(capsys, "track", session(filmed, more=cue), "--out", filmed / "out", "--method", "differential")
    assert "brightness alone" in said
    said = refusal(capsys, "track", session(filmed, more='keypoints = "always"'), "--out", filmed / "out")
    assert "keypoints" in said
