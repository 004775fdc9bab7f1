"""`evaluate` on a body of one hinge, where every error can be worked out by hand."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.box import hinged_box
from twistcap import se3
from twistcap.arrays import AnyArray
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError
from twistcap.evaluate import evaluate
from twistcap.evaluate.load import interpolated, landmark_name, parsed_exclusion
from twistcap.evaluate.metrics import silhouette
from twistcap.io.keypoints import LAYOUTS
from twistcap.io.markers import write_trc
from twistcap.io.motion_files import write_mot


@dataclass
class Tracked:
    body: Body
    rig: Rig
    times: AnyArray
    indices: AnyArray
    poses: list[Pose]
    lost: AnyArray
    covariances: AnyArray = field(default_factory=lambda: np.zeros(0))
    sources: AnyArray = field(default_factory=lambda: np.zeros((10, 1), np.int32))

    @property
    def known(self) -> AnyArray:
        return ~self.lost

    @property
    def q(self) -> AnyArray:
        return np.array([pose.q for pose in self.poses])

    @property
    def landmarks(self) -> AnyArray:
        return np.array([Posed(self.body, pose).landmarks for pose in self.poses])


def camera(dist: tuple[float, ...] = (0.0,) * 5) -> Camera:
    K = np.array([[200.0, 0, 80], [0, 200.0, 100], [0, 0, 1]])
    return Camera("cam01", K, look_at((1.8, 0.4, 0.3), (0, 0, 0)), (161, 201), np.array(dist))


@pytest.fixture
def tracked() -> Tracked:
    """Ten frames from frame 20 on, 60 a second; the knee bends by 1° a frame; σ of the angle claimed as 1°."""
    poses = [Pose(se3.transform(np.eye(3), (0.01 * k, 0, 0)), np.radians([float(k)])) for k in range(10)]
    indices = np.arange(20, 30)
    covariances = np.tile(np.diag([1e-6] * 6 + [np.radians(1.0) ** 2]), (10, 1, 1))
    return Tracked(hinged_box(), Rig((camera(),)), indices / 60, indices, poses, np.zeros(10, bool), covariances)


def rows_of(evaluation: object) -> dict[str, float]:
    return {line["metric"]: line["value"] for line in evaluation.rows}  # type: ignore[attr-defined]


def write_truth(path: Path, tracked: Tracked, angle_error_deg: float = 0.0, shift: float = 0.0) -> None:
    """Studio truth from frame 0 on that the tracked poses overestimate by the given errors; 20 frames come before."""
    q = np.concatenate([np.zeros((20, 1)), [p.q - np.radians(angle_error_deg) for p in tracked.poses]])
    marks = np.stack([Posed(tracked.body, p).landmarks - [shift, 0, 0] for p in tracked.poses])
    marks = np.concatenate([np.zeros((20, *marks.shape[1:])), marks])
    roots = np.tile(np.eye(4), (30, 1, 1))
    names = {"names": tracked.body.landmarks.names, "coordinate_names": tracked.body.coordinate_names}
    np.savez(path, root=roots, q=q, landmarks=marks, fps=60.0, **names)


def test_studio_truth_with_constant_errors(tracked: Tracked, tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.npz", tracked, angle_error_deg=2.0, shift=0.012)
    evaluation = evaluate(tracked, tmp_path)
    rows = rows_of(evaluation)
    assert rows["KHE"] == pytest.approx(2.0)
    assert rows["KHE, offset removed"] == pytest.approx(0.0, abs=1e-9)
    assert rows["joints, mean"] == pytest.approx(12.0)
    assert rows["joints, p95, offset removed"] == pytest.approx(0.0, abs=1e-9)
    assert rows["lost frames, by the reference"] == 0
    assert rows["lost sequence"] == 0
    assert rows["angle errors over claimed σ, rms (1 is honest)"] == pytest.approx(2.0)
    assert evaluation.joints is not None
    assert evaluation.joints.names == ("hip_r", "ankle_r")  # a toe is no joint
    json.dumps(evaluation.as_dict(), allow_nan=False)


def test_lost_frames_carry_the_recordings_numbers(tracked: Tracked, tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.npz", tracked)
    tracked.poses[3] = tracked.poses[3].retract(np.array([0, 0, 0, 0, 0.16, 0, 0.0]))
    evaluation = evaluate(tracked, tmp_path / "truth.npz")
    assert evaluation.lost_frames == [23]
    assert rows_of(evaluation)["joints, mean"] == pytest.approx(16.0)


def test_frames_that_the_tracker_does_not_believe_count_and_are_said(tracked: Tracked, tmp_path: Path) -> None:
    """As far as the reference has them; where it has masks too."""
    write_truth(tmp_path / "truth.npz", tracked, angle_error_deg=2.0)
    believed = evaluate(tracked, tmp_path / "truth.npz")
    assert believed.notes == () and believed.as_dict()["unknown_frames"] == []
    tracked.lost[[3, 9]] = True
    found = evaluate(tracked, tmp_path / "truth.npz", exclude=["hip_r:29-29", "ankle_r:29-29", "knee_angle_r:29-29"])
    assert found.as_dict()["unknown_frames"] == [23] and found.as_dict()["compared_frames"] == 9
    assert (
        found.notes[-1] == "1 of 9 compared frames are lost or unseen, as the tracker says; they count like all others"
    )
    assert rows_of(found)["KHE"] == pytest.approx(rows_of(believed)["KHE"])
    (tmp_path / "masks" / "cam01").mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "masks" / "cam01" / "frame_0023.png"), np.zeros((201, 161), np.uint8))
    assert evaluate(tracked, tmp_path / "masks").unknown_frames == [23]


def test_keypoints_with_time_offset_are_interpolated(tracked: Tracked, tmp_path: Path) -> None:
    """Keypoint row j belongs to video frame j + 1.5, and hip and ankle move evenly: interpolation is exact."""
    X = np.full((40, 25, 3), np.nan)
    frame = np.arange(40) + 1.5
    X[:, 12] = np.stack([0.01 * (frame - 20), 0 * frame, 0 * frame], axis=1)  # RHip of BODY_25B
    np.savez(tmp_path / "keypoints.npz", X=X)
    at_offset = rows_of(evaluate(tracked, tmp_path / "keypoints.npz", time_offset=1.5 / 60))
    without = rows_of(evaluate(tracked, tmp_path / "keypoints.npz"))
    assert at_offset["joints, mean"] == pytest.approx(0.0, abs=1e-6)
    assert without["joints, mean"] == pytest.approx(15.0)
    assert without["joints, mean, offset removed"] == pytest.approx(0.0, abs=1e-6)


def test_excluded_rows_do_not_count(tracked: Tracked, tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.npz", tracked)
    with np.load(tmp_path / "truth.npz") as archive:
        data = dict(archive)
    data["landmarks"][25:27, 1] += 1.0
    np.savez(tmp_path / "flawed.npz", **data)
    assert evaluate(tracked, tmp_path / "flawed.npz").lost_frames == [25, 26]
    assert evaluate(tracked, tmp_path / "flawed.npz", exclude=["ankle_r:25-26"]).lost_frames == []
    with pytest.raises(InputError, match="no point or coordinate 'ankel_r'"):
        evaluate(tracked, tmp_path / "flawed.npz", exclude=["ankel_r:25-26"])


@pytest.mark.parametrize("dist", [(0.0,) * 5, (-0.4, 0.05, 0.002, -0.001, 0.0)])
def test_masks_of_distorting_cameras_are_rectified(tracked: Tracked, tmp_path: Path, dist: tuple[float, ...]) -> None:
    """A mask drawn with distortion, densely sampled, overlaps the rectified silhouette but for its rim."""
    cam = camera(dist)
    tracked.rig = Rig((cam,))
    folder = tmp_path / "masks" / "cam01"
    folder.mkdir(parents=True)
    for k in (0, 5):
        vertices = Posed(tracked.body, tracked.poses[k]).vertices
        fine = cam.pinhole()
        mask = silhouette(fine.P, vertices, tracked.body.faces, fine.size)
        y, x = np.mgrid[: cam.size[1], : cam.size[0]]
        xy = cam.normalised(np.stack([x, y], axis=-1)) @ cam.K[:2, :2].T + cam.K[:2, 2]
        inside = cv2.remap(mask.astype(np.uint8) * 255, *np.moveaxis(xy.astype(np.float32), -1, 0), cv2.INTER_NEAREST)
        cv2.imwrite(str(folder / f"frame_{20 + k:04d}.png"), inside)
    cv2.imwrite(str(folder / "frame_0099.png"), inside)  # not tracked: left out
    evaluation = evaluate(tracked, tmp_path / "masks")
    assert [overlap.frame for overlap in evaluation.overlaps] == [20, 25]
    assert rows_of(evaluation)["IoU, mean"] > 0.985
    if any(dist):
        tracked.rig = Rig((camera(),))  # distortion forgotten: clearly worse
        assert rows_of(evaluate(tracked, tmp_path / "masks"))["IoU, mean"] < 0.96


def test_masks_of_swapped_cameras_are_those_of_the_camera_that_took_them(tracked: Tracked, tmp_path: Path) -> None:
    cams = camera(), replace(camera(), name="cam02", T_cam_world=look_at((-2.5, -2.0, 1.0), (0.0, 0.0, 0.0)))
    tracked.rig = Rig(cams)
    tracked.sources = np.tile(np.arange(2), (len(tracked.poses), 1))
    tracked.sources[5] = (1, 0)
    for k, order in ((0, (0, 1)), (5, (1, 0))):
        for cam, given in zip(cams, order, strict=True):
            folder = tmp_path / "masks" / cams[given].name
            folder.mkdir(parents=True, exist_ok=True)
            mask = silhouette(cam.P, Posed(tracked.body, tracked.poses[k]).vertices, tracked.body.faces, cam.size)
            cv2.imwrite(str(folder / f"frame_{20 + k:04d}.png"), mask.astype(np.uint8) * 255)
    assert rows_of(evaluate(tracked, tmp_path / "masks"))["IoU, least"] == 1.0
    tracked.sources[5] = (0, 1)
    assert rows_of(evaluate(tracked, tmp_path / "masks"))["IoU, least"] < 0.9


def test_masks_in_another_shape_or_folder_are_refused(tracked: Tracked, tmp_path: Path) -> None:
    folder = tmp_path / "cam01"
    folder.mkdir()
    cv2.imwrite(str(folder / "frame_0020.png"), np.zeros((100, 100), np.uint8))
    with pytest.raises(InputError, match="161×201"):
        evaluate(tracked, tmp_path)
    folder.rename(tmp_path / "cam07")
    with pytest.raises(InputError, match="cam07"):
        evaluate(tracked, tmp_path)


@pytest.mark.parametrize("given", [{"align": True}, {"register": True}, {"exclude": ["hip_r"]}, {"time_offset": 0.1}])
def test_masks_take_no_options_of_points(tracked: Tracked, tmp_path: Path, given: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"leave {next(iter(given)).replace('_', ' ')} out"):
        evaluate(tracked, tmp_path, **given)


@pytest.mark.parametrize("offset", [float("nan"), float("inf"), 1e300])
def test_a_time_offset_is_seconds(tracked: Tracked, tmp_path: Path, offset: float) -> None:
    write_truth(tmp_path / "truth.npz", tracked)
    with pytest.raises(InputError, match=r"the time offset is .*; give seconds"):
        evaluate(tracked, tmp_path / "truth.npz", time_offset=offset)


def test_references_with_nothing_in_common_are_refused(tracked: Tracked, tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.npz", tracked)
    with pytest.raises(InputError, match="no frame in common"):
        evaluate(tracked, tmp_path / "truth.npz", time_offset=10.0)
    np.savez(tmp_path / "unknown.npz", X=np.full((40, 1, 3), np.nan), names=["hip_r"], fps=30.0)
    with pytest.raises(InputError, match="says nothing in the frames of the result"):
        evaluate(tracked, tmp_path / "unknown.npz")
    np.savez(tmp_path / "other.npz", X=np.zeros((40, 1, 3)), names=["tail"])
    with pytest.raises(InputError, match="no point or coordinate name in common"):
        evaluate(tracked, tmp_path / "other.npz")
    with pytest.raises(InputError, match="does not exist"):
        evaluate(tracked, tmp_path / "absent.npz")
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(InputError, match="unknown ending"):
        evaluate(tracked, tmp_path / "notes.txt")
    (tmp_path / "bad.npz").write_text("x")
    with pytest.raises(InputError, match="cannot be read"):
        evaluate(tracked, tmp_path / "bad.npz")


def test_interpolation_spreads_the_unknown_no_farther_than_needed() -> None:
    times, values = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 10.0, np.nan, 30.0])
    np.testing.assert_array_equal(
        interpolated(times, values, np.array([-0.1, 0.0, 0.25, 1.0, 1.5, 2.0, 3.0, 3.1])),
        [np.nan, 0.0, 2.5, 10.0, np.nan, np.nan, 30.0, np.nan],
    )


def test_marker_files(tracked: Tracked, tmp_path: Path) -> None:
    hips_and_ankles = np.stack([Posed(tracked.body, pose).landmarks[:2] for pose in tracked.poses])
    points = hips_and_ankles + np.array([0.0, 0.0, 0.003])
    write_trc(tmp_path / "walk.trc", tracked.times, ("RHip", "RAnkle"), points, axes="opensim")
    rows = rows_of(evaluate(tracked, tmp_path / "walk.trc", axes="opensim"))
    assert rows["joints, mean"] == pytest.approx(3.0, abs=0.01)
    assert rows["joints, mean, offset removed"] == pytest.approx(0.0, abs=0.01)
    # The world turned by 90°: feet stay, the walk does not.
    turned = rows_of(evaluate(tracked, tmp_path / "walk.trc", axes="pose2sim"))
    assert turned["joints, mean, offset removed"] > 10


def test_a_note_names_the_axes_with_which_points_would_be_near(tracked: Tracked, tmp_path: Path) -> None:
    tracked.poses = [Pose(pose.root @ se3.transform(np.eye(3), (0.4, 0.9, 0.3)), pose.q) for pose in tracked.poses]
    points = np.stack([Posed(tracked.body, pose).landmarks[:2] for pose in tracked.poses]) + np.array([0, 0, 0.031])
    write_trc(tmp_path / "walk.trc", tracked.times, ("RHip", "RAnkle"), points, axes="z_up")
    [note] = evaluate(tracked, tmp_path / "walk.trc").notes
    assert note.endswith(" mm off; with --axes z_up they would be 31 mm off")
    off = rows_of(evaluate(tracked, tmp_path / "walk.trc"))["joints, median"]
    assert note.startswith(f"the points are {off:.0f} mm off")
    assert evaluate(tracked, tmp_path / "walk.trc", axes="z_up").notes == ()
    turned = evaluate(tracked, tmp_path / "walk.trc", register=True)
    assert not any("--axes" in note for note in turned.notes)
    # Nowhere near: no axes are named.
    write_trc(tmp_path / "far.trc", tracked.times, ("RHip", "RAnkle"), points + np.array([5, 7, 9]), axes="z_up")
    assert evaluate(tracked, tmp_path / "far.trc").notes == ()


def test_motion_files_whatever_their_knee_sign(tracked: Tracked, tmp_path: Path) -> None:
    tracked.poses = [Pose(pose.root, pose.q + np.radians(30.0)) for pose in tracked.poses]
    write_mot(tmp_path / "walk.mot", tracked.body, tracked.times, [Pose(p.root, p.q + 0.01) for p in tracked.poses])
    assert rows_of(evaluate(tracked, tmp_path / "walk.mot"))["KHE"] == pytest.approx(np.degrees(0.01), abs=1e-4)
    write_mot(tmp_path / "old.mot", tracked.body, tracked.times, [Pose(p.root, -p.q) for p in tracked.poses])
    evaluation = evaluate(tracked, tmp_path / "old.mot")
    assert rows_of(evaluation)["KHE"] == pytest.approx(0.0, abs=1e-4)
    assert "its sign changed" in evaluation.notes[0]


def test_shoulders_are_compared_in_our_order(tmp_path: Path) -> None:
    """What OpenSim's order of shoulder angles hides must come back as our own angles."""
    body = humanoid("full")
    names = [f"arm_{part}_l" for part in ("add", "flex", "rot")]
    q = np.zeros(len(body.coordinate_names))
    q[[body.coordinate(name) for name in names]] = np.radians([-40.0, 50.0, 20.0])
    times, poses = np.arange(3) / 60, [Pose(np.eye(4), q)] * 3
    write_mot(tmp_path / "arm.mot", body, times, poses)
    covariances = np.zeros((3, body.dof, body.dof))
    result = Tracked(body, Rig((camera(),)), times, np.arange(3), poses, np.zeros(3, bool), covariances)
    evaluation = evaluate(result, tmp_path / "arm.mot")
    assert evaluation.angles is not None
    assert set(names) <= set(evaluation.angles.names)
    np.testing.assert_allclose(evaluation.angles.raw, 0.0, atol=1e-4)


def test_the_real_keypoints_agree_with_themselves(shared_data: Path, tracked: Tracked) -> None:
    """A hip that rides on the real reference is exact at the 1.3-frame offset and off without it."""
    path = shared_data / "balance_4view" / "reference" / "keypoints3d_world.npz"
    with np.load(path) as archive:
        hip = archive["X"][:, LAYOUTS["body_25b"].index("hip_r")]
    video = np.stack([np.interp(tracked.indices, np.arange(100) + 1.3, hip[:, k]) for k in range(3)], axis=1)
    tracked.poses = [Pose(se3.transform(np.eye(3), place), np.zeros(1)) for place in video]
    at_offset = evaluate(tracked, path, time_offset=1.3 / 60)
    assert at_offset.joints is not None
    k = at_offset.joints.names.index("hip_r")
    np.testing.assert_allclose(at_offset.joints.raw[:, k], 0.0, atol=1e-6)
    without = evaluate(tracked, path)
    assert without.joints is not None
    assert without.joints.raw[:, k].max() > 1.0


def test_names_of_markers_and_exclusions() -> None:
    assert [landmark_name(n) for n in ("RHip", "LBigToe", "Neck", "R.Shoulder", "knee_l")] == [
        "hip_r", "toe_l", "neck", "R.Shoulder", "knee_l",
    ]  # fmt: skip
    assert parsed_exclusion("wrist_r:76-79", 100) == ("wrist_r", slice(76, 80))
    assert parsed_exclusion("wrist_r:76", 100) == ("wrist_r", slice(76, 77))
    assert parsed_exclusion("wrist_r", 100) == ("wrist_r", slice(0, 100))
    with pytest.raises(InputError, match="NAME:FIRST-LAST"):
        parsed_exclusion("wrist_r:a-b", 100)
    for empty in ("wrist_r:9-3", "wrist_r:90-100", "wrist_r:100"):
        with pytest.raises(InputError, match="rows 0 to 99"):
            parsed_exclusion(empty, 100)


def test_frames_that_a_motion_file_leaves_out_are_not_known(tracked: Tracked, tmp_path: Path) -> None:
    known = np.arange(len(tracked.times)) != 3
    write_mot(tmp_path / "walk.mot", tracked.body, tracked.times, tracked.poses, known=known)
    angles = evaluate(tracked, tmp_path / "walk.mot").angles
    assert angles is not None
    assert np.isnan(angles.raw).any(axis=1).tolist() == (~known).tolist()
    np.testing.assert_allclose(angles.raw[known], 0.0, atol=1e-5)
    between = evaluate(tracked, tmp_path / "walk.mot", time_offset=0.5 / 60).angles
    assert between is not None
    assert np.flatnonzero(np.isnan(between.raw).any(axis=1)).tolist() == [0, 3, 4]  # no line across the gap


def test_rows_of_a_motion_file_that_are_nan_are_not_known(tracked: Tracked, tmp_path: Path) -> None:
    write_mot(tmp_path / "walk.mot", tracked.body, tracked.times, tracked.poses)
    lines = (tmp_path / "walk.mot").read_text().splitlines()
    lines[-2] = "\t".join([lines[-2].split("\t")[0], *["nan"] * len(lines[-2].split("\t")[1:])])
    (tmp_path / "walk.mot").write_text("\n".join(lines))
    angles = evaluate(tracked, tmp_path / "walk.mot").angles
    assert angles is not None
    assert np.flatnonzero(np.isnan(angles.raw).any(axis=1)).tolist() == [len(tracked.times) - 2]


def test_angles_of_the_isb_are_compared_with_those_of_the_isb(tmp_path: Path) -> None:
    """Our own export, its clock moved: nothing is left; a knee that bends 2° more is seen as that."""
    body, rng = humanoid("full"), np.random.default_rng(4)
    times, turns = np.arange(40) / 60, rng.normal(scale=0.2, size=(2, len(body.coordinate_names)))
    poses = [Pose(np.eye(4), turns[0] + np.sin(9 * t) * turns[1]) for t in times]
    covariances = np.tile(np.eye(body.dof) * 1e-4, (len(times), 1, 1))
    result = Tracked(body, Rig((camera(),)), times, np.arange(40), poses, np.zeros(40, bool), covariances)
    write_mot(tmp_path / "isb.mot", body, times + 0.1, poses, angles="isb")
    found = evaluate(result, tmp_path / "isb.mot", align=True)
    assert found.angles is not None and len(found.angles.names) == len(found.agreements) > 20
    assert all(name.startswith("isb_") for name in found.angles.names)
    assert np.nanmax(np.abs(found.angles.raw)) < 0.01
    assert np.isfinite(rows_of(found)["angle errors over claimed σ, rms (1 is honest)"])
    bent = np.eye(len(body.coordinate_names))[body.coordinate("knee_angle_r")] * np.radians(2.0)
    write_mot(tmp_path / "isb.mot", body, times, [Pose(p.root, p.q + bent) for p in poses], angles="isb")
    [knee] = [a for a in evaluate(result, tmp_path / "isb.mot").agreements if a.name == "isb_knee_flexion_r"]
    assert knee.bias == pytest.approx(-2.0, abs=1e-4)
