"""What is said of a first pose, and which file is blamed where it cannot be true."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.cameras import ring
from twistcap import se3
from twistcap.adjust.first_pose import fit_keypoints, pose_at
from twistcap.body import Pose, Posed
from twistcap.body.gltf import save_glb
from twistcap.body.humanoid import humanoid
from twistcap.camera import Rig
from twistcap.commands.start import show_start, sizes_in_words, start_document
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.calibration import write_rig
from twistcap.io.cameras.axes import with_z_up
from twistcap.io.recording import body_of, open_recording, rig_of
from twistcap.io.session import Session, load_session
from twistcap.io.start_report import StartReport, start_report


@pytest.fixture(scope="module")
def person() -> Posed:
    body = humanoid("full", stature=1.75)
    root = np.eye(4)
    root[2, 3] = 0.93
    wanted: Mapping[str, float] = {"arm_add_r": -0.6, "arm_add_l": -0.4, "elbow_flex_r": 0.7, "knee_angle_l": 0.3}
    return Posed(body, Pose(root, np.array([wanted.get(n, 0.0) for n in body.coordinate_names])))


def keypoints(person: Posed, rig: Rig, noise: float = 1.0) -> Keypoints:
    """Of the person as the cameras truly stand."""
    rng = np.random.default_rng(0)
    pixels = np.stack([camera.project(person.landmarks)[0] for camera in rig])
    return Keypoints(
        person.body.landmarks.names, pixels + noise * rng.standard_normal(pixels.shape), np.ones(pixels.shape[:2])
    )


def session(folder: Path, rig: Rig, more: str = "", body: str = "stature = 1.75") -> Session:
    write_rig(rig, folder / "Calib.toml")
    videos = "\n".join(f'{name} = "{name}.mp4"' for name in rig.names)
    text = f'[cameras]\ncalibration = "Calib.toml"\n{more}\n[videos]\n{videos}\n[body]\n{body}\n'
    (folder / "s.toml").write_text(text + '[first_pose]\nclicks = "clicks.csv"\n')
    return load_session(folder / "s.toml")


def report(told: Session, points: Keypoints) -> StartReport:
    rig, generic = rig_of(told), body_of(told)
    return start_report(told, rig, generic, points, fit_keypoints(generic, rig, points, fit_lengths=told.fits_lengths))


def larger(rig: Rig, by: float) -> Rig:
    """The rig as if its board had larger squares."""
    motions = [camera.T_cam_world.copy() for camera in rig]
    for T in motions:
        T[:3, 3] *= by
    return Rig(tuple(replace(camera, T_cam_world=T) for camera, T in zip(rig, motions, strict=True)))


def test_a_good_start_is_shown_and_not_doubted(
    tmp_path: Path, person: Posed, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = ring()
    found = report(session(tmp_path, rig), keypoints(person, rig))
    assert found.warnings == () and found.stature == pytest.approx(1.75, abs=0.04)
    assert np.all(found.medians < 3) and np.isfinite(found.residual_px).all()
    worst = found.worst()
    assert [float(px.max()) for _, px in worst] == sorted([float(px.max()) for _, px in worst], reverse=True)
    assert float(worst[0][1].max()) == pytest.approx(float(found.residual_px.max()))
    show_start(found)
    told = capsys.readouterr().err
    assert all(name in told for name in (*rig.names, worst[0][0], "median of 26", "stated 1.75 m"))
    document: Any = start_document(found)
    assert json.dumps(document["warnings"]) == "[]" and set(document["median_px"]) == set(rig.names)
    assert start_document(None) is None


def test_a_calibration_that_is_too_large_is_blamed(tmp_path: Path, person: Posed) -> None:
    rig = ring()
    told = session(tmp_path, larger(rig, 1.25))
    (sentence,) = report(told, keypoints(person, rig)).warnings
    assert "Calib.toml" in sentence and "stature is 1.75 m" in sentence and "squares" in sentence
    assert 1.18 < float(sentence.split(" times too large")[0].split()[-1]) < 1.28


@pytest.mark.parametrize("stature", ["stature = 1.75", ""])
def test_nobody_is_two_metres_and_sixty(tmp_path: Path, person: Posed, stature: str) -> None:
    rig = ring()
    told = session(tmp_path, larger(rig, 1.5), body=stature)
    with pytest.raises(InputError, match=r"Calib\.toml.* times too large.*2\.[56]\d m tall"):
        report(told, keypoints(person, rig))


def test_legs_alone_are_of_a_person_of_the_usual_height(tmp_path: Path, person: Posed) -> None:
    rig = ring()
    legs = session(tmp_path, rig, body='variant = "legs"')
    found = report(legs, keypoints(person, rig))
    assert (
        found.warnings == () and found.stated == pytest.approx(1.75) and found.stature == pytest.approx(1.75, abs=0.1)
    )
    small = session(tmp_path, rig, body='variant = "legs"\nstature = 1.2')
    (sentence,) = report(small, keypoints(person, rig)).warnings
    assert "person is 1.7" in sentence and "stature is 1.20 m" in sentence


def test_an_exact_glb_keeps_its_lengths_and_still_tells_the_scale(tmp_path: Path, person: Posed) -> None:
    rig = ring()
    save_glb(person.body, tmp_path / "anna.glb")
    told = session(tmp_path, larger(rig, 1.25), body='kind = "glb"\npath = "anna.glb"')
    found = report(told, keypoints(person, rig))
    assert set(found.lengths.values()) == {1.0} and found.stature == pytest.approx(found.stated)
    assert "Lengths: those of the body." in sizes_in_words(found)
    assert "Calib.toml" in found.warnings[0] and "times too large" in found.warnings[0]
    right = session(tmp_path, rig, body='kind = "glb"\npath = "anna.glb"')
    assert report(right, keypoints(person, rig)).warnings == ()
    asked = load_session(tmp_path / "s.toml", {"first_pose.fit_lengths": True})
    assert asked.fits_lengths and set(report(asked, keypoints(person, rig)).lengths.values()) != {1.0}


def test_one_camera_that_is_off_is_named(tmp_path: Path, person: Posed) -> None:
    rig = ring()
    points = keypoints(person, rig)
    points.pixels[2, :, 0] += 60.0
    (sentence,) = report(session(tmp_path, rig), points).warnings
    assert sentence.startswith(f"camera {rig.names[2]}:") and "clicks.csv" in sentence and "Calib.toml" in sentence


def test_views_that_contradict_each_other_and_a_wrong_format_are_told_apart(tmp_path: Path, person: Posed) -> None:
    rig = ring()
    told, points = session(tmp_path, rig), keypoints(person, rig)
    shaken = 40.0 * np.random.default_rng(3).standard_normal(points.pixels.shape)
    other = replace(points, pixels=points.pixels + shaken)
    assert "contradict each other" in report(told, other).warnings[-1]
    names = list(points.names)
    mixed = replace(points, names=tuple(names[3:] + names[:3]))
    assert "their format is another one" in report(told, mixed).warnings[-1]


def test_keypoints_of_another_size_of_image_are_no_matter_of_the_board(tmp_path: Path, person: Posed) -> None:
    """Lengths that are wrong as a whole leave keypoints on the body, halved pixels do not."""
    rig = ring()
    points = keypoints(person, rig)
    with pytest.raises(InputError, match=r"contradict each other.*sizes of image"):
        report(session(tmp_path, rig), replace(points, pixels=0.5 * points.pixels))


def test_ten_pixels_are_too_many_in_a_small_image(tmp_path: Path, person: Posed) -> None:
    """The person is some 230 px high there; in a large image, as of `balance_4view`, ten are usual."""
    rig = ring()
    points = keypoints(person, rig, noise=0.0)
    angles = np.random.default_rng(5).uniform(0, 2 * np.pi, points.pixels.shape[:2])
    points.pixels[...] += 12.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    found = report(session(tmp_path, rig), points)
    assert 8 < np.median(found.medians) < 13
    (sentence,) = found.warnings
    assert "clicks.csv are" in sentence and "px from the fitted body" in sentence


def test_a_good_start_of_a_real_recording_is_not_doubted(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWISTCAP_DATA", str(shared_data))
    told = load_session(Path(__file__).parents[2] / "examples" / "balance_4view.toml")
    found = open_recording(told).report
    assert found is not None and found.warnings == () and abs(found.stature - 1.74) < 0.08
    assert np.all((found.medians > 5) & (found.medians < 16))  # px, of a person 1000 px high


@pytest.mark.parametrize("axis", ["y", "-y", "x", "-z"])
def test_another_axis_that_is_up_is_told_and_turned(tmp_path: Path, person: Posed, axis: Any) -> None:
    upright = ring()
    turn = with_z_up(upright, axis)[0].T_cam_world.copy()  # z of the world here is `axis` of the file
    back = se3.inverse(turn) @ upright[0].T_cam_world
    file = Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ back) for c in upright))
    told = session(tmp_path, file)
    with pytest.raises(
        InputError, match=rf'Calib\.toml: by the images {axis} is up, not z; set \[cameras\] up = "{axis}"'
    ):
        rig_of(told)
    rig = rig_of(session(tmp_path, file, f'up = "{axis}"'))
    heights = [camera.centre[2] for camera in rig]
    np.testing.assert_allclose(heights, [camera.centre[2] for camera in upright], atol=1e-9)
    assert rig_of(session(tmp_path, file, "floor = false")).names == upright.names  # as it is


def test_a_glb_that_was_exported_z_up_is_blamed(tmp_path: Path, person: Posed) -> None:
    """glTF is y up; a file whose numbers are z up lies down when it is read as one."""
    body, rig = person.body, ring()
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    lying = replace(
        body,
        vertices=body.vertices @ turn.T,
        landmarks=replace(body.landmarks, points=body.landmarks.points @ turn.T),
    )
    told = session(tmp_path, rig, body='kind = "glb"\npath = "anna.glb"')
    save_glb(body, tmp_path / "anna.glb")
    assert body_of(told).segment_names == body.segment_names
    told = session(tmp_path, rig, body='kind = "glb"\npath = "anna.glb"')
    save_glb(lying, tmp_path / "anna.glb")
    with pytest.raises(InputError, match=r"anna\.glb: in its rest pose the head is not above the feet.*\+Y up"):
        body_of(told)


def test_a_fast_wrist_is_not_blurred_by_several_frames(person: Posed) -> None:
    """A swing of the elbow has a corner that no line follows; slow coordinates are averaged as before."""
    body, start = person.body, person.pose
    elbow, knee = body.coordinate("elbow_flex_r"), body.coordinate("knee_angle_l")
    rng, sigma = np.random.default_rng(1), np.full(body.dof, 0.01)
    times = np.arange(-3.0, 4.0)
    poses = list[Pose]()
    for t in times:
        q = start.q + 0.01 * rng.standard_normal(len(start.q))
        q[elbow] = start.q[elbow] + 0.5 * abs(t)  # at the turn in frame 0
        q[knee] = start.q[knee] + 0.02 * t
        poses.append(Pose(start.root, q))
    blurred, found = pose_at(poses, times, 0.0), pose_at(poses, times, 0.0, [sigma] * len(times))
    assert abs(blurred.q[elbow] - start.q[elbow]) > 0.5
    assert abs(found.q[elbow] - start.q[elbow]) < 0.01
    others = np.delete(np.arange(len(start.q)), elbow)
    np.testing.assert_allclose(found.q[others], blurred.q[others], atol=1e-12)
