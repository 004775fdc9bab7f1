"""``twistcap new`` in project folders of other programs, each made up after its documented layout."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.cameras import ring
from support.commands import document, refusal, run
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig, write_rig
from twistcap.io.cameras import write_cameras
from twistcap.io.cameras.axes import with_z_up
from twistcap.io.cameras.units import scaled
from twistcap.io.keypoints import LAYOUTS
from twistcap.io.projects import found_project, paired
from twistcap.io.recording import rig_of, views_of
from twistcap.io.session import Session, load_session
from twistcap.io.videowriter import VideoWriter

RIG = ring()


def video(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    width, height = RIG[0].size
    with VideoWriter(path, 30) as writer:
        for k in range(4):
            writer.write(np.full((height, width, 3), 20 * k, np.uint8))


def keypoints(layout: str) -> list[list[list[float]]]:
    """Rows x, y, confidence by camera."""
    body = humanoid("full")
    root = np.eye(4)
    root[2, 3] = 0.93
    posed = Posed(body, Pose(root, np.zeros(len(body.coordinate_names))))
    marks = dict(zip(body.landmarks.names, posed.landmarks, strict=True))
    unseen = [0.0, 0.0, 0.0]
    return [
        [[*camera.project(marks[n][None])[0][0].tolist(), 0.9] if n in marks else unseen for n in LAYOUTS[layout]]
        for camera in RIG
    ]


def poses(folder: Path, layout: str, names: list[str], easymocap: bool = False) -> None:
    for name, rows in zip(names, keypoints(layout), strict=True):
        (folder / name).mkdir(parents=True)
        flat = [number for row in rows for number in row]
        content: Any = {"annots": [{"keypoints": rows}]} if easymocap else {"people": [{"pose_keypoints_2d": flat}]}
        (folder / name / "000000.json").write_text(json.dumps(content))


def other_up(rig: Rig, to: Any) -> Rig:
    """The rig in a world in which `to` is up."""
    turn = np.linalg.inv(with_z_up(rig, to)[0].T_cam_world) @ rig[0].T_cam_world  # world of the file to ours
    return Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ turn) for c in rig))


def made(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[Session, dict[str, Any]]:
    told = document(capsys, "new", *arguments)
    session = load_session(told["session"])
    rig = rig_of(session)
    assert len(views_of(session, rig)) == 4
    heights = [camera.centre[2] for camera in rig]
    np.testing.assert_allclose(heights, [camera.centre[2] for camera in RIG], atol=1e-6)
    return session, told


def test_pose2sim(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "calibration").mkdir()
    write_rig(RIG, tmp_path / "calibration" / "Calib_scene.toml")
    (tmp_path / "Config.toml").write_text("[pose]\npose_model = 'Body_with_feet'\n")
    for trial in ("Trial_1", "Trial_2"):
        for name in RIG.names:
            video(tmp_path / trial / "videos" / f"{name}.mp4")
    poses(tmp_path / "Trial_1" / "pose", "halpe_26", [f"{n}_json" for n in RIG.names])
    with pytest.raises(InputError, match=r"has no trial 'T9'; it has Trial_1, Trial_2\."):
        found_project(tmp_path, "T9")
    assert "Trial_1, Trial_2; choose one with --trial" in refusal(capsys, "new", tmp_path / "s", "--project", tmp_path)
    session, told = made(capsys, tmp_path / "s", "--project", tmp_path, "--trial", "Trial_1", "--stature", 1.75)
    table = session.first_pose.keypoints
    assert table is not None and table.format == "halpe_26" and set(table.folders) == set(RIG.names)
    assert told["missing"] == [] and max(told["first_pose"]["median_px"].values()) < 3
    assert told["next"] == [f"Next, track:  twistcap track {tmp_path / 's' / 'session.toml'}"]
    assert told["first_pose"]["stature_m"] == pytest.approx(1.75, abs=0.05)
    session, told = made(capsys, tmp_path / "Trial_2")  # in the trial's own folder
    assert session.first_pose.unaided and "Project of Pose2Sim" in " ".join(told["found"])
    assert session.cameras.floor == 0.0
    write_rig(RIG, tmp_path / "calibration" / "Calib_scene.toml", floor=False)
    assert made(capsys, tmp_path / "Trial_2", "--force")[0].cameras.floor is False


@pytest.mark.parametrize(("layout", "other"), [("body_25", "body_25b"), ("body_25b", "body_25")])
def test_25_points_have_the_format_in_which_they_fit_a_body(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], layout: str, other: str
) -> None:
    """Config.toml names a model of another number of points: it is said, and the keypoints themselves decide."""
    _project_of(tmp_path, layout)
    (tmp_path / "Config.toml").write_text("[pose]\npose_model = 'Body_with_feet'\n")
    session, told = made(capsys, tmp_path, "--stature", 1.75)
    found = " ".join(told["found"])
    assert session.first_pose.keypoints is not None and session.first_pose.keypoints.format == layout
    assert "Config.toml names body_with_feet, which has another number of points." in found
    assert f"; {layout} is taken: as {layout} they are" in found and f"as {other}" in found
    assert told["missing"] == [] and max(told["first_pose"]["median_px"].values()) < 3


def test_25_points_that_fit_no_body_are_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _project_of(tmp_path, "body_25")
    shuffled = np.random.default_rng(0).permutation(25)
    for path in (tmp_path / "pose").glob("*/*.json"):
        given = np.reshape(json.loads(path.read_text())["people"][0]["pose_keypoints_2d"], (25, 3))[shuffled]
        path.write_text(json.dumps({"people": [{"pose_keypoints_2d": given.ravel().tolist()}]}))
    session, told = made(capsys, tmp_path, "--stature", 1.75)
    assert session.first_pose.unaided and told["first_pose"] is None
    assert "The number of keypoints fits body_25 and body_25b; none is clear: as" in " ".join(told["found"])
    assert "The first pose: track looks for it in the images." in told["missing"][0]
    assert "Config.toml" not in " ".join(told["found"])


def test_a_model_that_config_names_is_believed(tmp_path: Path) -> None:
    _project_of(tmp_path, "body_25b")
    assert found_project(tmp_path).layouts == ("body_25", "body_25b")
    for name in ("BODY_25", "BODY_25B"):
        (tmp_path / "Config.toml").write_text(f"[pose]\npose_model = '{name}'\n")
        assert found_project(tmp_path).layouts == (name.lower(),)


def _project_of(folder: Path, layout: str) -> None:
    (folder / "calibration").mkdir()
    write_rig(RIG, folder / "calibration" / "Calib.toml")
    for name in RIG.names:
        video(folder / "videos" / f"{name}.mp4")
    poses(folder / "pose", layout, [f"{n}_json" for n in RIG.names])


def test_keypoints_that_give_no_pose_lead_to_clicks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Millimetres taken for metres would be refused; here the board's squares were half as large as said."""
    far = {c.name: c.T_cam_world.copy() for c in RIG}
    for T in far.values():
        T[:3, 3] *= 2.0
    (tmp_path / "calibration").mkdir()
    larger = Rig(tuple(replace(c, T_cam_world=far[c.name]) for c in RIG))
    write_rig(larger, tmp_path / "calibration" / "Calib.toml")
    for name in RIG.names:
        video(tmp_path / "videos" / f"{name}.mp4")
    poses(tmp_path / "pose", "halpe_26", [f"{n}_json" for n in RIG.names])
    told = document(capsys, "new", tmp_path, "--stature", 1.75)
    (sentence,) = told["missing"]
    assert "Calib.toml" in sentence and "times too large" in sentence and told["first_pose"] is None
    path = tmp_path / "session.toml"
    assert told["next"] == [
        f"Next, click the first pose:  twistcap init {path}",
        f"Then, track:  twistcap track {path}",
    ]


def test_a_calibration_of_wrong_scale_is_scaled_by_the_stature(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The board's squares were said 1.25 times too large: `new` tells, the person's height mends it."""
    (tmp_path / "calibration").mkdir()
    write_rig(scaled(RIG, 1.25), tmp_path / "calibration" / "Calib.toml")
    for name in RIG.names:
        video(tmp_path / "videos" / f"{name}.mp4")
    poses(tmp_path / "pose", "halpe_26", [f"{n}_json" for n in RIG.names])
    told = document(capsys, "new", tmp_path, "--stature", 1.75)
    fitted = told["first_pose"]["stature_m"]
    assert fitted == pytest.approx(1.25 * 1.75, abs=0.06) and "times too large" in told["first_pose"]["warnings"][0]
    session, out = tmp_path / "session.toml", tmp_path / "out"
    track = ("track", session, "--out", out, "--set", "output.overlay=false", "--set", "output.exports=[]")
    document(capsys, *track)
    assert "goes without" in refusal(capsys, "refine", out / "result.h5", "--stature", 1.75, "--cameras")
    assert "height in metres" in refusal(capsys, "refine", out / "result.h5", "--stature", 175)
    told = document(capsys, "refine", out / "result.h5", "--stature", 1.75)
    assert told["factor"] == pytest.approx(1.75 / fitted, rel=1e-3) and told["to_set"] == []
    new, old = read_rig(told["calibration"]), read_rig(tmp_path / "calibration" / "Calib.toml")
    np.testing.assert_allclose([c.centre for c in new], [told["factor"] * c.centre for c in old], atol=1e-9)
    np.testing.assert_allclose([c.centre for c in new], [c.centre for c in RIG], rtol=0.03)
    again = document(
        capsys, *track[:-6], "--out", tmp_path / "b", "--set", f"cameras.calibration={told['calibration']}"
    )
    other = "refine", again["result"], "--session", session, "--stature", 1.75
    assert "not tracked with calibration" in refusal(capsys, *other)


def test_a_stature_that_was_not_fitted_scales_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("studio", tmp_path / "walk", "--size", "192x140", "--views", "2", "--frames", "3") == 0
    out = tmp_path / "out"
    assert run("track", tmp_path / "walk" / "session.toml", "--out", out, "--set", "output.overlay=false") == 0
    capsys.readouterr()
    assert "as images did not fit it; twistcap refine it" in refusal(
        capsys, "refine", out / "result.h5", "--stature", 2
    )


def test_opencap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    named = Rig(tuple(replace(c, name=f"Cam{k}") for k, c in enumerate(RIG)))
    write_cameras(other_up(named, "-y"), tmp_path / "Videos", "opencap")
    for name in named.names:
        for trial in ("calibration", "neutral", "walk"):
            video(tmp_path / "Videos" / name / "InputMedia" / trial / f"{trial}_sync.mp4")
    (tmp_path / "sessionMetadata.yaml").write_text("mass_kg: 70.0\nheight_m: 1.82\n")
    session, told = made(capsys, tmp_path)
    found = " ".join(told["found"])
    assert "OpenCap" in found and "Up is -y" in found and "converted" in found and "floor = false" in found
    assert "by their order" not in found
    assert session.cameras.floor is False and session.body.stature == 1.82
    assert all(path.endswith("walk_sync.mp4") for path in session.videos.values())


def test_easymocap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_cameras(RIG, tmp_path, "easymocap")
    for name in RIG.names:
        video(tmp_path / "videos" / f"{name}.mp4")
    poses(tmp_path / "annots", "body_25", list(RIG.names), easymocap=True)
    session, told = made(capsys, tmp_path, "--stature", 1.75)
    assert session.cameras.calibration.endswith("Calib.toml") and "first pose" in " ".join(told["found"])
    assert told["missing"] == [] and max(told["first_pose"]["median_px"].values()) < 3


def test_a_calibration_that_is_there_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Unless it is the same, or --force is given and nothing is refused later: here sizes are."""
    project, folder = tmp_path / "project", tmp_path / "s"
    write_cameras(RIG, project, "easymocap")
    for name in RIG.names:
        video(project / "videos" / f"{name}.mp4")
    asked = ("new", folder, "--project", project)
    assert run(*asked) == 0
    written = (folder / "Calib.toml").read_text()
    (folder / "session.toml").unlink()
    assert run(*asked) == 0
    (folder / "session.toml").unlink()
    (folder / "Calib.toml").write_text("mine")
    told = refusal(capsys, *asked)
    assert "Calib.toml exists, and is not the project's calibration" in told and "--force" in told
    write_cameras(Rig(tuple(replace(c, size=(c.size[0] + 2, c.size[1])) for c in RIG)), project, "easymocap")
    assert "size" in refusal(capsys, *asked, "--force")
    assert (folder / "Calib.toml").read_text() == "mine" and len([*folder.iterdir()]) == 1
    assert "size" in refusal(capsys, "new", tmp_path / "fresh", "--project", project)
    assert not (tmp_path / "fresh").exists()
    write_cameras(RIG, project, "easymocap")
    assert run(*asked, "--force") == 0 and (folder / "Calib.toml").read_text() == written


def test_keypoints_that_are_not_read_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "calibration").mkdir()
    write_rig(RIG, tmp_path / "calibration" / "Calib.toml")
    for name in RIG.names:
        video(tmp_path / "videos" / f"{name}.mp4")
    poses(tmp_path / "pose", "halpe_26", ["a_json", "b_json", "c_json", "d_json"])
    (tmp_path / "pose" / "e_json").mkdir()
    (tmp_path / "pose" / "e_json" / "0.json").write_text('{"people": []}')
    session, told = made(capsys, tmp_path / "s", "--project", tmp_path)
    assert session.first_pose.unaided
    assert "Its keypoints (a, b, c, d, e) are not read: they fit no cameras." in " ".join(told["found"])
    for path in (tmp_path / "pose").glob("*/*.json"):
        path.write_text(json.dumps({"people": [{"pose_keypoints_2d": [1.0] * 57}]}))
    session, told = made(capsys, tmp_path / "t", "--project", tmp_path)
    assert "are not read: their points fit no format that is known." in " ".join(told["found"])


def test_keypoints_are_paired_with_the_cameras_that_have_a_video(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "calibration").mkdir()
    write_rig(RIG, tmp_path / "calibration" / "Calib.toml")
    for name in RIG.names[:-1]:
        video(tmp_path / "videos" / f"{name}.mp4")
    *folders, last = [f"{letter}_json" for letter in "abcdefgh"[: len(RIG)]]
    poses(tmp_path / "pose", "halpe_26", [*folders, last])
    shutil.rmtree(tmp_path / "pose" / last)
    told = document(capsys, "new", tmp_path / "s", "--project", tmp_path)
    pairs = ", ".join(f"{folder[0]} = {name}" for folder, name in zip(folders, RIG.names[:-1], strict=True))
    assert f"so they are paired by their order: {pairs}. Check it." in " ".join(told["found"])


def test_freemocap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Millimetres, the world of the first camera's axes, videos named otherwise than the cameras."""
    T = {c.name: c.T_cam_world.copy() for c in other_up(RIG, "-y")}
    for motion in T.values():
        motion[:3, 3] *= 1000
    mm = Rig(tuple(replace(c, T_cam_world=T[c.name]) for c in RIG))
    write_rig(mm, tmp_path / "take_camera_calibration.toml")
    path = tmp_path / "take_camera_calibration.toml"
    path.write_text(path.read_text().replace('unit = "m"\n', ""))
    for k in range(len(RIG)):
        video(tmp_path / "synchronized_videos" / f"Camera_{k:03d}_synchronized.mp4")
    session, told = made(capsys, tmp_path)
    assert session.cameras.unit == "mm" and session.cameras.up == "-y" and session.cameras.floor is False
    pairs = ", ".join(f"Camera_{k:03d}_synchronized = {name}" for k, name in enumerate(RIG.names))
    assert f"The names of its videos do not tell the cameras, so they are paired by their order: {pairs}." in " ".join(
        told["found"]
    )
    assert "FreeMoCap" in told["found"][1] or "FreeMoCap" in " ".join(told["found"])


def test_what_is_no_project_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no project of Pose2Sim" in refusal(capsys, "new", tmp_path)
    assert "both --calibration and --videos" in refusal(capsys, "new", tmp_path, "--calibration", tmp_path / "c.toml")
    assert "is no folder" in refusal(capsys, "new", tmp_path / "s", "--project", tmp_path / "none")
    (tmp_path / "synchronized_videos").mkdir()
    assert "camera_calibration.toml" in refusal(capsys, "new", tmp_path)


@pytest.mark.parametrize("program", ["Pose2Sim", "EasyMocap", "FreeMoCap"])
def test_a_trial_that_is_not_there_is_told(program: str, tmp_path: Path) -> None:
    write_cameras(
        RIG,
        tmp_path if program == "EasyMocap" else tmp_path / "calibration.toml",
        {"EasyMocap": "easymocap"}.get(program, "toml"),
    )
    (tmp_path / {"FreeMoCap": "synchronized_videos"}.get(program, "videos")).mkdir()
    assert found_project(tmp_path).program == program
    with pytest.raises(InputError, match=r"has no trial 'T9'; leave --trial away\."):
        found_project(tmp_path, "T9")


def test_names_are_paired_by_what_they_hold_or_by_their_order() -> None:
    assert paired(["x_cam10", "x_cam1"], ["cam1", "cam10"]) == {"x_cam10": "cam10", "x_cam1": "cam1"}
    assert paired(["v10", "v9"], ["int_cam2_img", "int_cam10_img"]) == {"v9": "int_cam2_img", "v10": "int_cam10_img"}
    assert paired(["a", "b"], ["c1"]) is None
