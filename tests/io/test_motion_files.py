"""Marker and motion files: round trips, independent readers, real files, bad files."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pybvh
import pytest
from scipy.spatial.transform import Rotation

from support.cameras import ring
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.shape import joint_origin
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.io.angles import decomposed, pelvis_point, product
from twistcap.io.bvh import write_bvh
from twistcap.io.exports import ExportOptions, export
from twistcap.io.markers import WorldAxes, read_keypoints3d, read_trc, write_trc
from twistcap.io.motion_files import poses_from_mot, read_mot, write_csv, write_mot
from twistcap.io.result import Result, ResultWriter, read_result

AXES: tuple[WorldAxes, ...] = ("opensim", "pose2sim", "z_up")


@pytest.fixture(scope="module")
def body() -> Body:
    return humanoid("full")


def some_poses(body: Body, count: int = 12) -> list[Pose]:
    """A smooth motion through wide poses, upright enough that no pelvis is at list ±90°."""
    rng = np.random.default_rng(3)
    lo, hi = 0.8 * body.limits.T
    t = np.linspace(0, 1, count)[:, None]
    q = lo + (hi - lo) * (0.5 + 0.5 * np.sin(2 * np.pi * (t + rng.uniform(size=len(lo)))))
    roots = se3.transform(se3.exp_rotation(t * [0.4, -0.3, 4.0]), np.hstack([t, 2 * t, 0.9 + 0 * t]))
    return [Pose(root, row) for root, row in zip(roots, q, strict=True)]


def test_angles_of_any_square_axes() -> None:
    rng = np.random.default_rng(0)
    for signs in ([1, 1, 1], [-1, 1, 1], [1, -1, -1]):
        axes = Rotation.random(random_state=1).as_matrix() * np.array(signs)[:, None]
        angles = np.cumsum(rng.normal(scale=0.05, size=(300, 3)), axis=0)  # wanders far past ±90°
        np.testing.assert_allclose(decomposed(product(angles, axes), axes, angles[0]), angles, atol=1e-9)


def test_angles_against_scipy() -> None:
    R = Rotation.random(50, random_state=0)
    ours = [decomposed(r[None], np.eye(3)[[2, 0, 1]], np.zeros(3))[0] for r in R.as_matrix()]
    np.testing.assert_allclose(Rotation.from_euler("ZXY", np.array(ours)).as_matrix(), R.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_angles_at_gimbal_lock(sign: int) -> None:
    angles = np.array([[0.3, sign * np.pi / 2, 0.2], [0.3, sign * 1.5, 0.2]])
    for axes in (np.eye(3), np.diag([-1.0, 1, 1])):
        again = decomposed(product(angles, axes), axes, np.array([0.3, 1.0, 0.0]))
        np.testing.assert_allclose(product(again, axes), product(angles, axes), atol=1e-6)
        assert np.all(np.abs(np.diff(again, axis=0)) < 0.2)  # no jump out of the lock


# --- TRC --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", AXES)
def test_trc_round_trip(tmp_path: Path, axes: WorldAxes) -> None:
    rng = np.random.default_rng(0)
    times, points = np.arange(5) / 60, rng.normal(size=(5, 3, 3))
    points[2, 1] = points[4, 2] = np.nan  # in the middle and at the end of a row
    write_trc(tmp_path / "a.trc", times, ["hip_r", "nose", "last"], points, axes)
    again = read_trc(tmp_path / "a.trc", axes)
    assert again.names == ("hip_r", "nose", "last")
    np.testing.assert_allclose(again.times, times, atol=1e-6)
    np.testing.assert_allclose(again.points, points, atol=1e-6)
    (tmp_path / "mm.trc").write_text((tmp_path / "a.trc").read_text().replace("\tm\t", "\tmm\t"))
    np.testing.assert_array_equal(read_trc(tmp_path / "mm.trc", axes).points, 0.001 * again.points)


def test_trc_axes_as_pose2sim_writes_them(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", np.array([0.0, 0.5]), ["p"], np.array([[[1.0, 2.0, 3.0]]] * 2), axes="pose2sim")
    lines = (tmp_path / "a.trc").read_text().splitlines()
    assert lines[0].startswith("PathFileType\t4\t(X/Y/Z)")
    assert lines[2].split("\t")[:5] == ["2", "2", "2", "1", "m"]
    assert [float(v) for v in lines[6].split("\t")[2:]] == [2.0, 3.0, 1.0]


TRC_ERRORS = {
    "Units is 'km'": ("\tm\t", "\tkm\t"),
    "NumMarkers is 2": ("\t1\tm", "\t2\tm"),
    "line 7: 'two' is no number": ("3.000000", "two"),
    "line 7 has more than 5 fields": ("3.000000", "2.0\t3.0"),
    "not a TRC file": ("PathFileType", "Path"),
    "Time is missing": ("1\t0.0\t", "1\t\t"),
    "NumFrames is 20, but it has 2 rows; it was cut off": ("\t2\t1\tm", "\t20\t1\tm"),
}


@pytest.mark.parametrize("said", TRC_ERRORS)
def test_bad_trc(tmp_path: Path, said: str) -> None:
    path = tmp_path / "a.trc"
    write_trc(path, np.array([0.0, 0.5]), ["p"], np.array([[[1.0, 2.0, 3.0]]] * 2))
    path.write_text(path.read_text().replace(*TRC_ERRORS[said], 1))
    with pytest.raises(InputError, match=said):
        read_trc(path)


def test_missing_files(tmp_path: Path) -> None:
    for reader in (read_trc, read_mot, read_keypoints3d):
        with pytest.raises(InputError, match=r"gone\.x"):
            reader(tmp_path / "gone.x")


# --- MOT --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", AXES)
def test_mot_round_trip(tmp_path: Path, body: Body, axes: WorldAxes) -> None:
    poses, times = some_poses(body), np.arange(12) / 60
    write_mot(tmp_path / "a.mot", body, times, poses, axes)
    table = read_mot(tmp_path / "a.mot")
    again, unknown = poses_from_mot(table, body, axes)
    assert unknown == []
    np.testing.assert_allclose(table.times, times, atol=1e-8)
    for pose, other in zip(poses, again, strict=True):
        np.testing.assert_allclose(other.root, pose.root, atol=1e-7)
        np.testing.assert_allclose(Posed(body, other).landmarks, Posed(body, pose).landmarks, atol=1e-7)


def test_mot_pelvis_is_opensims(tmp_path: Path, body: Body) -> None:
    """R = Rz(tilt) Rx(list) Ry(rotation) in OpenSim's frame (x forward, y up, z right), written out with scipy."""
    poses = some_poses(body)
    write_mot(tmp_path / "a.mot", body, np.arange(12) / 60, poses)
    table = read_mot(tmp_path / "a.mot")
    to_opensim = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    angles = np.stack([table.get(f"pelvis_{n}") for n in ("tilt", "list", "rotation")], axis=1)
    R = Rotation.from_euler("ZXY", angles).as_matrix()
    ours = np.array([to_opensim @ pose.root[:3, :3] @ to_opensim.T for pose in poses])
    np.testing.assert_allclose(R, ours, atol=1e-7)
    assert np.abs(np.diff(angles, axis=0)).max() < 1.0  # a full turn stays continuous


def test_mot_shoulders_are_opensims(tmp_path: Path, body: Body) -> None:
    """arm_flex, arm_add, arm_rot about z, x, y (mirrored on the left) give the upper arm's rotation in the torso."""
    poses = some_poses(body)
    write_mot(tmp_path / "a.mot", body, np.arange(12) / 60, poses)
    table = read_mot(tmp_path / "a.mot")
    to_opensim = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    for side, sign in (("r", 1), ("l", -1)):
        angles = np.stack([table.get(f"arm_{n}_{side}") for n in ("flex", "add", "rot")], axis=1)
        R = Rotation.from_euler("ZXY", angles * [1, sign, sign]).as_matrix()
        for pose, wanted in zip(poses, R, strict=True):
            T = Posed(body, pose).segment_transforms
            torso, arm = T[body.segment("torso"), :3, :3], T[body.segment(f"humerus_{side}"), :3, :3]
            np.testing.assert_allclose(to_opensim @ torso.T @ arm @ to_opensim.T, wanted, atol=1e-7)


def test_t_pose_goes_through_opensims_gimbal_lock(tmp_path: Path, body: Body) -> None:
    q = np.zeros(len(body.coordinate_names))
    q[[body.coordinate("arm_add_r"), body.coordinate("arm_add_l")]] = -np.pi / 2
    q[body.coordinate("arm_rot_r")] = 0.3
    pose = Pose(np.eye(4), q)
    write_mot(tmp_path / "a.mot", body, np.array([0.0]), [pose])
    again, _ = poses_from_mot(read_mot(tmp_path / "a.mot"), body)
    np.testing.assert_allclose(Posed(body, again[0]).vertices, Posed(body, pose).vertices, atol=1e-6)


MOT = "x\nversion=1\nnRows=2\nnColumns=3\ninDegrees={deg}\nendheader\n"
MOT += "time\tknee_angle_r\tpelvis_ty\n0\t{k}\t1\n1\t{k}\t1\n"


def test_mot_units_and_knee_sign(tmp_path: Path, body: Body) -> None:
    path = tmp_path / "a.mot"
    path.write_text(MOT.format(deg="yes", k=-40))
    table = read_mot(path)
    np.testing.assert_allclose(table.values, [[np.radians(-40), 1.0]] * 2)
    knee = body.coordinate("knee_angle_r")
    poses, _ = poses_from_mot(table, body)
    assert np.degrees(poses[0].q[knee]) == pytest.approx(40)
    path.write_text(MOT.format(deg="no", k=0.5))
    assert read_mot(path).values[0, 0] == 0.5


MOT_ERRORS = {
    "endheader": ("endheader\n", ""),
    "must be time": ("time\t", "frame\t"),
    "line 8 has 2 fields": ("0\t3\t1", "0\t3"),
    "line 8: 'one' is no number": ("0\t3\t1", "0\t3\tone"),
}


@pytest.mark.parametrize("said", MOT_ERRORS)
def test_bad_mot(tmp_path: Path, said: str) -> None:
    path = tmp_path / "a.mot"
    path.write_text(MOT.format(deg="yes", k=3).replace(*MOT_ERRORS[said], 1))
    with pytest.raises(InputError, match=said):
        read_mot(path)


def test_mot_that_fits_no_body(tmp_path: Path, body: Body) -> None:
    path = tmp_path / "a.mot"
    path.write_text(MOT.format(deg="yes", k="nan"))
    with pytest.raises(InputError, match="NaN"):
        poses_from_mot(read_mot(path), body)
    path.write_text(MOT.format(deg="yes", k=1).replace("knee_angle_r", "force_x").replace("pelvis_ty", "force_y"))
    with pytest.raises(InputError, match="none of its columns"):
        poses_from_mot(read_mot(path), body)


# --- BVH --------------------------------------------------------------------------------------------------------------


def skewed(body: Body) -> Body:
    """The body with subtalar axes 3 cm below the ankle's, so that the two do not meet."""
    twists = body.twists.copy()
    for side in "rl":
        k = body.coordinate(f"subtalar_angle_{side}")
        twists[k, 3:] += np.cross([0, 0, 0.03], twists[k, :3])  # v = −ω × p
    return replace(body, twists=twists)


@pytest.mark.parametrize("skew", [False, True])
def test_bvh_against_pybvh(tmp_path: Path, body: Body, skew: bool) -> None:
    body = skewed(body) if skew else body
    poses = some_poses(body)
    write_bvh(tmp_path / "a.bvh", body, poses, 60.0)
    read = pybvh.read_bvh_file(tmp_path / "a.bvh")
    assert read.fps == pytest.approx(60.0, rel=1e-5)
    assert len(read.joint_names) == len(body.segment_names) + (2 if skew else 0)
    assert set(read.euler_orders) == {"ZYX"}
    there = read.joint_positions()[..., [2, 0, 1]]
    motions = np.array([Posed(body, pose).segment_transforms for pose in poses])
    for s, name in enumerate(body.segment_names):
        ours = se3.apply(motions[:, s], joint_origin(body, s)[None])[:, 0]
        if not (skew and name.startswith("foot")):  # there the last joint stands on the second axis
            np.testing.assert_allclose(there[:, read.joint_names.index(name)], ours, atol=1e-4)
    # The ends of the feet prove rotations too: the landmark farthest from the joint is the big toe.
    ends = read.node_positions()[..., [2, 0, 1]]
    marks = np.array([Posed(body, pose).landmarks for pose in poses])
    toes = marks[:, [body.landmarks.index("toe_r"), body.landmarks.index("toe_l")]]
    for n in range(2):
        nearest = np.linalg.norm(ends - toes[:, n, None], axis=-1).min(axis=1)
        assert nearest.max() < 1e-4


def test_bvh_refuses_what_it_cannot_hold(tmp_path: Path, body: Body) -> None:
    with pytest.raises(InputError, match="frame rate"):
        write_bvh(tmp_path / "a.bvh", body, some_poses(body), 0.0)
    sliding = body.twists.copy()
    sliding[0] = [0, 0, 0, 0, 0, 1]
    with pytest.raises(InputError, match="sliding"):
        write_bvh(tmp_path / "a.bvh", replace(body, twists=sliding), some_poses(body), 60.0)


# --- CSV and npz ------------------------------------------------------------------------------------------------------


def test_csv(tmp_path: Path, body: Body) -> None:
    poses = some_poses(body, 3)
    covariance = np.diag(np.r_[np.full(3, 0.01), np.full(3, 0.02), np.full(len(poses[0].q), 0.03)] ** 2)
    estimates = [Estimate(n, n / 60, pose, covariance) for n, pose in enumerate(poses)]
    left = np.array([name in ("humerus_l", "ulna_l", "radius_l") for name in body.segment_names])
    estimates[1] = replace(estimates[1], part_probability=np.where(left, 0.75, 0.125))
    result = result_of(tmp_path, body, estimates)
    write_csv(tmp_path / "a.csv", result)
    write_mot(tmp_path / "a.mot", body, result.times, poses)
    rows = rows_of(tmp_path / "a.csv")
    arm, leg = ([row[f"probability_lost_{limb}"] for row in rows] for limb in ("arm_l", "leg_r"))
    assert (arm, leg) == (["", "0.7500", ""], ["", "0.1250", ""])
    for name, unit in {"knee_angle_r": "deg", "arm_flex_l": "deg", "pelvis_tilt": "deg", "pelvis_tx": "m"}.items():
        wanted = read_mot(tmp_path / "a.mot").get(name)  # a name means the same in both
        ours = np.array([float(row[f"{name}_{unit}"]) for row in rows])
        np.testing.assert_allclose(ours, np.degrees(wanted) if unit == "deg" else wanted, atol=2e-6)
    assert float(rows[1]["knee_angle_r_std_deg"]) == pytest.approx(np.degrees(0.03), abs=1e-5)
    assert [float(row["time"]) for row in rows] == result.times.tolist()


def result_of(folder: Path, body: Body, estimates: list[Estimate]) -> Result:
    with ResultWriter(folder / "r.h5", body, ring(), {}) as writer:
        for estimate in estimates:
            writer.append(estimate)
    return read_result(folder / "r.h5")


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("fill", [False, True])
def test_frames_that_are_lost_or_unseen_are_empty_unless_filled(tmp_path: Path, body: Body, fill: bool) -> None:
    unit, poses = np.eye(body.dof) * 1e-4, some_poses(body, 4)
    estimates = [Estimate(n, n / 60, pose, unit, lost=n == 1) for n, pose in enumerate(poses)]
    estimates[2] = replace(estimates[2], status="not_found")
    result, options = result_of(tmp_path, body, estimates), ExportOptions(fill=fill)
    empty = [False, not fill, not fill, False]
    for name in ("trc", "mot", "csv"):
        export(result, name, tmp_path, options=options)
    markers, table = read_trc(tmp_path / "joints.trc"), read_mot(tmp_path / "angles.mot")
    assert np.isnan(markers.points).all(axis=(1, 2)).tolist() == empty
    assert np.isnan(markers.points).any(axis=(1, 2)).tolist() == empty
    np.testing.assert_array_equal(table.times, result.times[~np.array(empty)])
    assert np.isfinite(table.values).all()
    told = "Frames filled with the predicted pose" if fill else "Frames left out"
    span = f"1-2 ({float(result.times[1])!r} to {float(result.times[2])!r} s)"
    assert f"{told}, since the body was lost or not seen: {span}\n" in (tmp_path / "angles.mot").read_text()
    rows = rows_of(tmp_path / "angles.csv")
    assert [row["knee_angle_r_deg"] == "" for row in rows] == empty
    assert [row["knee_angle_r_std_deg"] == "" for row in rows] == empty
    assert [row["lost"] for row in rows] == ["0", "1", "0", "0"]
    assert [row["status"] for row in rows] == ["converged", "converged", "not_found", "converged"]


def test_a_mot_without_any_row_is_not_written(tmp_path: Path, body: Body) -> None:
    poses = some_poses(body, 2)
    estimates = [Estimate(n, n / 60, pose, 1e-4 * np.eye(body.dof), lost=True) for n, pose in enumerate(poses)]
    result = result_of(tmp_path, body, estimates)
    with pytest.raises(InputError, match=r"angles.mot: the body is lost in every frame; with --fill"):
        export(result, "mot", tmp_path)
    assert not (tmp_path / "angles.mot").exists()
    export(result, "mot", tmp_path, options=ExportOptions(fill=True))
    assert len(read_mot(tmp_path / "angles.mot").times) == 2


@pytest.mark.parametrize("axes", AXES)
def test_points_and_angles_of_one_run_stand_in_one_world(tmp_path: Path, body: Body, axes: WorldAxes) -> None:
    """The angle file, played on the body in the file's own axes, puts the joints where the marker file has them."""
    poses = some_poses(body, 5)
    result = result_of(tmp_path, body, [Estimate(n, n / 60, p, np.eye(body.dof) * 1e-4) for n, p in enumerate(poses)])
    for name in ("trc", "mot"):
        export(result, name, tmp_path, options=ExportOptions(axes=axes))
    table = read_mot(tmp_path / "angles.mot")
    tilt, list_, turn = (table.get(f"pelvis_{name}") for name in ("tilt", "list", "rotation"))
    place = np.stack([table.get(f"pelvis_t{axis}") for axis in "xyz"], axis=1)
    R = Rotation.from_euler("ZXY", np.stack([tilt, list_, turn], axis=1)).as_matrix()
    lines = (tmp_path / "joints.trc").read_text().splitlines()
    names = lines[3].split("\t")[2::3]
    numbers = np.array([[float(v) for v in line.split("\t")[2:]] for line in lines[6:]]).reshape(5, -1, 3)
    hip = body.landmarks.points[body.landmarks.index("hip_r")] - pelvis_point(body)
    there = place + R @ np.array([hip[0], hip[2], -hip[1]])  # the pelvis of OpenSim: x forward, y up, z right
    np.testing.assert_allclose(numbers[:, names.index("hip_r")], there, atol=1e-4)


def test_keypoints3d(tmp_path: Path) -> None:
    X = np.random.default_rng(0).normal(size=(4, 25, 3))
    np.savez(tmp_path / "k.npz", X=X)
    with pytest.raises(InputError, match="clock"):
        read_keypoints3d(tmp_path / "k.npz")
    np.savez(tmp_path / "k.npz", X=X, fps=50.0)
    markers = read_keypoints3d(tmp_path / "k.npz")
    assert markers.names[0] == "nose" and markers.times[3] == pytest.approx(0.06)
    np.savez(tmp_path / "k.npz", X=X[:, :3], fps=10.0)
    with pytest.raises(InputError, match="3 points"):
        read_keypoints3d(tmp_path / "k.npz")


# --- real files -------------------------------------------------------------------------------------------------------


def test_real_trc_files(shared_data: Path) -> None:
    files = sorted(shared_data.glob("opensim_gait/**/*.trc")) + sorted(shared_data.glob("balance_4view/**/*.trc"))
    assert len(files) == 13
    for path in files:
        markers = read_trc(path)
        height = np.nanmax(markers.points[0, :, 2])
        assert 1.3 < height < 2.0, path  # metres, z up
        assert np.nanmin(markers.points[..., 2]) > -0.1


def test_real_mot_files(shared_data: Path, body: Body) -> None:
    gait = shared_data / "opensim_gait"
    knee, hip = body.coordinate("knee_angle_r"), body.coordinate("hip_flexion_r")
    for name in (
        "Pipelines/Gait2354_Simbody/subject01_walk1_ik.mot",
        "Tutorials/Intro_to_Musculoskeletal_Modeling/normal.mot",
    ):
        poses, _ = poses_from_mot(read_mot(gait / name), body)
        q = np.degrees([pose.q for pose in poses])
        assert 50 < q[:, knee].max() < 75 and q[:, knee].min() > -5  # flexion turned positive
        assert 15 < q[:, hip].max() < 45
        assert all(0.8 < pose.root[2, 3] < 1.2 for pose in poses)  # upright, z up
    forces = read_mot(gait / "Pipelines/Gait2354_Simbody/subject01_walk1_grf.mot")
    assert forces.get("ground_force_vy").max() > 700  # newtons stay newtons, though inDegrees=yes


def test_real_angles_put_the_joints_where_the_keypoints_were(shared_data: Path, body: Body) -> None:
    """Pose2Sim's own angles on our generic body against its own TRC: centimetres, or the conventions are wrong.

    Legs only: that model bends its spine joint by joint, which ours does not know.
    """
    folder = shared_data / "balance_4view" / "reference"
    table = read_mot(next((folder / "S00_P00_OpenSim").glob("*BalancingTrial*body25b.mot")))
    trial = folder / "S00_P00_T01_BalancingTrial" / "pose-3d" / "S00_P00_T01_BalancingTrial_0-100_filt_butterworth.trc"
    markers = read_trc(trial, "pose2sim")
    poses, unknown = poses_from_mot(table, body, "pose2sim")
    assert "mtp_angle_r" in unknown
    marks = np.array([Posed(body, pose).landmarks for pose in poses])
    for ours, theirs in (("hip_r", "RHip"), ("knee_r", "RKnee"), ("knee_l", "LKnee"), ("ankle_l", "LAnkle")):
        gap = marks[:, body.landmarks.index(ours)] - markers.points[:, markers.names.index(theirs)]
        assert np.median(np.linalg.norm(gap, axis=1)) < 0.10, ours


def test_unknown_choices_are_refused(tmp_path: Path, body: Body) -> None:
    """None of them falls back to a default, in Python either."""
    times, points = np.array([0.0, 0.5]), np.zeros((2, 1, 3))
    with pytest.raises(InputError, match="axes is 'opensin'; it must be one of opensim, pose2sim, z_up"):
        write_trc(tmp_path / "a.trc", times, ["p"], points, axes="opensin")  # pyright: ignore[reportArgumentType]
    write_mot(tmp_path / "a.mot", body, times, [Pose.rest(body)] * 2)
    with pytest.raises(InputError, match="axes is 'pose3sim'"):
        poses_from_mot(read_mot(tmp_path / "a.mot"), body, axes="pose3sim")  # pyright: ignore[reportArgumentType]
