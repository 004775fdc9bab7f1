"""Motion files in a body's coordinates: limbs against the source, known angles, round trips, bad tables."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from support.finite_differences import check_jacobian, numeric_jacobian
from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.shape import joint_origin
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.io.motion_files import poses_from_mot, read_mot, write_mot
from twistcap.io.motions import read_motion, read_skeleton, write_motion
from twistcap.io.result import ResultWriter
from twistcap.motion import (
    MotionClip,
    SkeletonMotion,
    body_table,
    grounded,
    read_table,
    retarget,
    skeleton_of,
    table_for,
)
from twistcap.motion.branches import square_joints, within_limits
from twistcap.motion.retargeting import DirectionTerm, leg_length
from twistcap.motion.table import calibrated, shipped_tables

LIMBS = (("femur", "tibia"), ("tibia", "foot"), ("humerus", "ulna"), ("ulna", "radius"))


@pytest.fixture(scope="module")
def body() -> Body:
    return humanoid()


def moving(body: Body, count: int = 8, share: float = 0.7) -> MotionClip:
    """A smooth motion well within the limits."""
    lo, hi = share * body.limits.T
    t = np.linspace(0, 1, count)[:, None]
    q = lo + (hi - lo) * (0.5 + 0.5 * np.sin(0.6 * np.pi * (t + np.random.default_rng(3).uniform(size=len(lo)))))
    roots = se3.transform(se3.exp_rotation(t * [0.4, -0.3, 2.0]), np.hstack([t, 2 * t, 0.9 + 0 * t]))
    return MotionClip("moving", body.coordinate_names, 30.0, roots, q)


def source(data: Path, name: str, rate: float = 30.0) -> SkeletonMotion:
    path = data / "motions" / name
    return read_skeleton(path, path.with_name("01.asf") if path.suffix == ".amc" else None).resampled(rate)


def bends(motion: SkeletonMotion, clip: MotionClip, body: Body) -> dict[str, Float]:
    """Angle (N,) degrees between each limb's direction in the source and in the body, seen from the pelvis."""
    known = calibrated(motion, table_for(motion))
    pelvis = motion.rotations[:, known.joints["pelvis"]] @ known.axes["pelvis"]
    own = skeleton_of(body, clip.poses(), clip.rate)
    out: dict[str, Float] = {}
    for upper, lower in LIMBS:
        for side in "rl":
            if f"{lower}_{side}" not in known.joints:
                continue
            ends = [known.joints[f"{part}_{side}"] for part in (upper, lower)]
            there = _seen(pelvis, motion.positions[:, ends[1]] - motion.positions[:, ends[0]])
            ends = [own.joints.index(f"{part}_{side}") for part in (upper, lower)]
            here = _seen(clip.roots[:, :3, :3], own.positions[:, ends[1]] - own.positions[:, ends[0]])
            out[f"{upper}_{side}"] = np.degrees(2 * np.arcsin(np.minimum(np.linalg.norm(there - here, axis=1) / 2, 1)))
    return out


def _seen(frames: Float, vectors: Float) -> Float:
    local = np.einsum("nji,nj->ni", frames, vectors)
    return local / np.linalg.norm(local, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "name",
    [
        "cmu/07_02.amc",
        "cmu/08_02.amc",
        "cmu/131_02.bvh",
        "deepmimic/humanoid3d_walk.txt",
        "deepmimic/humanoid3d_run.txt",
        "deepmimic/humanoid3d_cartwheel.txt",
    ],
)
def test_limbs_point_where_the_source_s_do(shared_data: Path, body: Body, name: str) -> None:
    """All limbs within a degree, in walks, runs and a cartwheel; within the limits but for ankles and turned limbs."""
    motion = source(shared_data, name)
    clip = retarget(motion, body)
    angles = bends(motion, clip, body)
    assert len(angles) >= 6
    assert max(values.max() for values in angles.values()) < 1.0
    rates = np.abs(np.diff(clip.q, axis=0)) * clip.rate
    assert np.degrees(rates.max()) < 1600  # no angle jumps; the fastest here are feet and turns of an arm
    beyond = np.maximum(clip.q - body.limits[:, 1], body.limits[:, 0] - clip.q)
    assert np.degrees(beyond.max()) < 18.0


def test_flips_stay_within_the_shoulder_s_limits(shared_data: Path, body: Body) -> None:
    """The backflip's arms swing around the pole: they cross it on a bridge and leave their limits by 20° at most."""
    motion = source(shared_data, "deepmimic/humanoid3d_backflip.txt", 60.0)
    clip = retarget(motion, body)
    arms = [k for k, name in enumerate(body.coordinate_names) if name.startswith("arm_")]
    beyond = np.maximum(clip.q - body.limits[:, 1], body.limits[:, 0] - clip.q)[:, arms]
    assert np.degrees(beyond.max()) < 20.0
    assert np.degrees(np.abs(np.diff(clip.q, axis=0)).max()) < 60.0
    angles = bends(motion, clip, body)
    assert max(values.mean() for values in angles.values()) < 2.5
    assert np.mean(angles["humerus_l"] > 2.0) < 0.2


def test_hinges_keep_the_file_s_own_angles(shared_data: Path, body: Body) -> None:
    """CMU's knees and elbows are hinges: their numbers stand in the AMC, as the fit must find them again."""
    path = shared_data / "motions" / "cmu" / "08_02.amc"
    clip = read_motion(path, body, skeleton=path.with_name("01.asf"))
    words = [line.split() for line in path.read_text().splitlines()]
    for bone, name in (("rtibia", "knee_angle_r"), ("ltibia", "knee_angle_l"), ("rradius", "elbow_flex_r")):
        told = np.array([float(w[1]) for w in words if w[0] == bone])
        found = np.degrees(clip.q[:, body.coordinate(name)])
        np.testing.assert_allclose(found, told, atol=0.7)


def test_knee_of_a_cmu_walk_looks_like_gait(shared_data: Path, body: Body) -> None:
    """08_02's knees against the norm (Schwartz et al. 2008), from swing peak to swing peak."""
    norms = json.loads((shared_data / "gait_norms" / "Schwartz2008.json").read_text())["Schwartz2008"]
    norm = np.array(norms["Free"]["KneeAngles"]["X"])[:, 1:].mean(axis=1)
    expected = np.roll(norm[:-1], -int(np.argmax(norm)))
    path = shared_data / "motions" / "cmu" / "08_02.amc"
    clip = read_motion(path, body, skeleton=path.with_name("01.asf"), rate=60.0)
    for side in "rl":
        knee = np.degrees(clip.q[:, body.coordinate(f"knee_angle_{side}")])
        assert -3 < knee.min() < 20
        assert 55 < knee.max() < 78
        peaks = [n for n in range(len(knee)) if knee[n] > 45 and knee[n] == knee[max(0, n - 20) : n + 21].max()]
        cycles = list(pairwise(peaks))
        assert cycles
        for start, end in cycles:
            cycle = np.interp(np.linspace(start, end, 51)[:-1], np.arange(len(knee)), knee)
            assert np.corrcoef(cycle, expected)[0, 1] > 0.88


def test_a_walk_goes_forward_upright(shared_data: Path, body: Body) -> None:
    path = shared_data / "motions" / "cmu" / "07_02.amc"
    clip = read_motion(path, body, skeleton=path.with_name("01.asf"), rate=30.0)
    assert np.all(clip.roots[:, 2, 2] > 0.95)
    velocity = np.diff(clip.roots[:, :3, 3], axis=0).mean(axis=0) * clip.rate
    heading = clip.roots[:, :3, 0].mean(axis=0)
    assert 1.0 < velocity @ heading < 2.5
    assert np.linalg.norm(velocity - (velocity @ heading) * heading) < 0.2
    low = [Posed(body, pose).vertices[:, 2].min() for pose in grounded(clip, body).poses()]
    assert abs(np.percentile(low, 5)) < 0.01


@pytest.mark.parametrize("kind", ["plain", "thorax", "scaled"])
def test_own_skeleton_gives_its_own_coordinates(kind: str) -> None:
    """Body to skeleton to body: the inverse of forward kinematics, for all joints, oblique ankles included."""
    body = humanoid(thorax=kind == "thorax", clavicles=kind == "thorax", wrists=kind == "thorax", stature=1.6)
    clip = moving(body)
    back = retarget(skeleton_of(body, clip.poses(), clip.rate, "moving"), body, body_table())
    np.testing.assert_allclose(back.roots, clip.roots, atol=1e-9)
    np.testing.assert_allclose(back.q, clip.q, atol=1e-4)
    tall = humanoid(stature=1.8)
    if kind == "scaled":
        far = retarget(skeleton_of(body, clip.poses(), clip.rate), tall, body_table())
        np.testing.assert_allclose(far.roots[:, :3, 3] * 1.6, back.roots[:, :3, 3] * 1.8, atol=1e-9)
        near = retarget(skeleton_of(body, clip.poses(), clip.rate), tall, body_table(), scale=1.0)
        np.testing.assert_allclose(near.roots[:, :3, 3], back.roots[:, :3, 3], atol=1e-9)
        assert leg_length(tall) / leg_length(body) == pytest.approx(1.8 / 1.6)


def test_a_thorax_shares_what_one_trunk_joint_does(shared_data: Path, body: Body) -> None:
    """CMU's upper trunk and head are turned alike in a body with one trunk joint and in one with two."""
    motion, parted = source(shared_data, "cmu/08_02.amc", 10.0), humanoid(thorax=True)
    turns: list[Float] = []
    for which, chest in ((body, "torso"), (parted, "thorax")):
        T = np.array([Posed(which, pose).segment_transforms for pose in retarget(motion, which).poses()])
        turns.append(T[:, [which.segment(chest), which.segment("head")], :3, :3])
    np.testing.assert_allclose(turns[0], turns[1], atol=0.02)


def test_bvh_of_ours_comes_back(tmp_path: Path, body: Body) -> None:
    clip = moving(body)
    write_motion(tmp_path / "b.bvh", body, clip)
    back = read_motion(tmp_path / "b.bvh", body)
    assert back.rate == pytest.approx(clip.rate)
    np.testing.assert_allclose(back.q, clip.q, atol=1e-4)
    np.testing.assert_allclose(back.roots, clip.roots, atol=1e-5)
    with pytest.raises(InputError, match="unknown ending"):
        write_motion(tmp_path / "c.fbx", body, clip)
    with pytest.raises(InputError, match="coordinates are not those"):
        write_motion(tmp_path / "c.bvh", humanoid("legs"), clip)


def test_mot_passes_without_loss(tmp_path: Path, shared_data: Path, body: Body) -> None:
    """OpenSim's running: the numbers of `poses_from_mot`, and again after writing."""
    path = shared_data / "opensim_gait/Pipelines/Hamner/outputReference/ResultsIK/subject02_running_ik.mot"
    clip = read_motion(path, body)
    table = read_mot(path)
    poses, _ = poses_from_mot(table, body)
    assert clip.rate == pytest.approx(60, abs=1e-3)
    np.testing.assert_array_equal(clip.q, [pose.q for pose in poses])
    np.testing.assert_array_equal(clip.roots, [pose.root for pose in poses])
    knee = table.get("knee_angle_l")  # flexion is negative there
    np.testing.assert_allclose(clip.q[:, body.coordinate("knee_angle_l")], -knee, atol=1e-12)
    write_motion(tmp_path / "a.mot", body, clip)
    again = read_motion(tmp_path / "a.mot", body)
    np.testing.assert_allclose(again.q, clip.q, atol=1e-8)
    np.testing.assert_allclose(again.roots, clip.roots, atol=1e-7)


def test_mot_for_legs_and_for_other_joints(shared_data: Path, body: Body) -> None:
    """Legs take their coordinates as they are; a body whose joints turn otherwise takes the limbs' directions."""
    path = shared_data / "opensim_gait/Pipelines/Hamner/outputReference/ResultsIK/subject02_running_ik.mot"
    legs, whole = humanoid("legs"), read_motion(path, body)
    clip = read_motion(path, legs)
    same = [whole.names.index(name) for name in legs.coordinate_names]
    np.testing.assert_array_equal(clip.q, whole.q[:, same])
    np.testing.assert_array_equal(clip.roots, whole.roots)
    names = tuple(name.replace("hip_rotation", "hip_turn") for name in body.coordinate_names)
    other = read_motion(path, replace(body, coordinate_names=names), rate=10.0)
    np.testing.assert_allclose(other.q, read_motion(path, body, rate=10.0).q, atol=0.03)


def test_a_result_gives_its_longest_stretch(tmp_path: Path, body: Body) -> None:
    clip = moving(body, 12)
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n, pose in enumerate(clip.poses()):
            covariance = np.eye(body.dof)
            writer.append(Estimate(n, n / 30, pose, covariance, {}, "converged", 1, n in (2, 3, 9), 0.9))
    read = read_motion(tmp_path / "r.h5", body)
    assert read.rate == pytest.approx(30, rel=1e-5)
    np.testing.assert_array_equal(read.q, clip.q[4:9])
    np.testing.assert_array_equal(read.roots, clip.roots[4:9])


def test_directions_against_differences(body: Body) -> None:
    rng = np.random.default_rng(1)
    pose, segments = moving(body, 2).poses()[0], np.array([1, 4, 7, 9], np.int32)
    term = DirectionTerm(segments, se3.exp_rotation(rng.normal(size=(4, 3))), rng.uniform(0.1, 1.0, size=(4, 3)))
    still, found = np.zeros(body.dof), term.linearize(Posed(body, pose))

    def axes(step: Float) -> Float:
        have = Posed(body, pose.retract(step)).segment_transforms[segments, :3, :3]
        return (np.sqrt(term.squares)[:, None] * have).ravel()

    check_jacobian(lambda step: np.array(term.energy(Posed(body, pose.retract(step)))), found.gradient, still)
    by_step = numeric_jacobian(axes, still)
    np.testing.assert_allclose(found.hessian, by_step.T @ by_step, atol=1e-7)
    assert found.value == term.energy(Posed(body, pose))


def test_angles_that_wind_around_the_pole_cross_it(body: Body) -> None:
    """An arm that goes up on the inner side of the pole and comes to rest out at the side."""
    joint = [body.coordinate(f"arm_{part}_r") for part in ("add", "flex", "rot")]
    assert joint in square_joints(body)
    t = np.linspace(0, 1, 91)
    q = np.zeros((91, len(body.coordinate_names)))
    q[:, joint] = np.stack([np.radians(120) * t, np.radians(80) * np.sin(np.pi * t), np.radians(100) * t], axis=1)
    kept, bridged = within_limits(body, q, 60.0)
    assert 0 < bridged.sum() <= 7
    lo, hi = body.limits[joint].T
    assert np.all(np.clip(kept[:, joint], lo - 0.8, hi + 0.8) == kept[:, joint])
    for n in np.flatnonzero(~bridged):
        T = [Posed(body, Pose(np.eye(4), row)).segment_transforms for row in (q[n], kept[n])]
        np.testing.assert_allclose(T[0], T[1], atol=1e-9)
    calm = q.copy()
    calm[:, joint] *= 0.3
    same, bridged = within_limits(body, calm, 60.0)
    np.testing.assert_allclose(same, calm, atol=1e-12)
    assert not bridged.any()


def test_a_user_s_table(tmp_path: Path, shared_data: Path, body: Body) -> None:
    """Renamed joints need a table; with one the motion is the same."""
    motion = source(shared_data, "deepmimic/humanoid3d_run.txt", 10.0)
    renamed = replace(motion, joints=tuple(f"my_{joint}" for joint in motion.joints))
    with pytest.raises(InputError, match=r"is none of cmu, .*give a table"):
        retarget(renamed, body)
    text = (Path(__file__).parents[2] / "src/twistcap/motion/tables/deepmimic.toml").read_text()
    (tmp_path / "t.toml").write_text(text.replace('joint = "', 'joint = "my_'))
    clip = retarget(renamed, body, read_table(tmp_path / "t.toml"))
    np.testing.assert_array_equal(clip.q, retarget(motion, body).q)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pelvis =", "basin =", "unknown segment 'basin'"),
        ("tibia_r =", "#", "it lacks 'tibia_r'"),
        ("up = [0, 1, 0]", "over = [0, 1, 0]", r"unknown key 'over' in \[segments.pelvis\]"),
        ("up = [0, 1, 0]", "up = [0, 1]", "segments.pelvis.up"),
        (", up = [0, 1, 0]", "", "give either up or down"),
        ("down = [0, -1, 0]", 'down = "shin"', "points to 'shin'"),
        ("[segments]", "[segments", "not valid TOML"),
    ],
)
def test_broken_tables(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = (Path(__file__).parents[2] / "src/twistcap/motion/tables/deepmimic.toml").read_text()
    (tmp_path / "t.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_table(tmp_path / "t.toml")


def test_tables_that_do_not_fit(tmp_path: Path, body: Body) -> None:
    motion = skeleton_of(body, moving(body).poses(), 30.0)
    deepmimic = next(table for table in shipped_tables() if table.name == "deepmimic")
    with pytest.raises(InputError, match=r"no joint 'root' \(pelvis of table 'deepmimic'\)"):
        retarget(motion, body, deepmimic)
    rows = dict(body_table().segments)
    rows["femur_r"] = rows["femur_r"].model_copy(update={"forward": (0.0, 0.0, 1.0)})
    with pytest.raises(InputError, match="femur_r: forward and up must be two directions"):
        retarget(motion, body, body_table().model_copy(update={"segments": rows}))
    with pytest.raises(InputError, match=r"none\.toml cannot be read"):
        read_table(tmp_path / "none.toml")
    nameless = replace(body, segment_names=tuple(f"s{n}" for n in range(len(body.segment_names))))
    with pytest.raises(InputError, match="has no segment 'femur_r'"):
        retarget(motion, nameless, body_table())


def test_uneven_and_broken_coordinate_files(tmp_path: Path, body: Body) -> None:
    clip = moving(body)
    write_mot(tmp_path / "a.mot", body, np.array([0, 1, 2, 3, 5, 6, 7, 8]) / 30, clip.poses())
    with pytest.raises(InputError, match=r"a\.mot: its times must rise in even steps"):
        read_motion(tmp_path / "a.mot", body)
    (tmp_path / "b.mot").write_text("inDegrees=yes\nendheader\ntime knee_angle_r\n0 1\n0.1 nan\n")
    with pytest.raises(InputError, match=r"b\.mot: .*NaN"):
        read_motion(tmp_path / "b.mot", body)


def test_joints_are_where_the_body_has_them(body: Body) -> None:
    """`skeleton_of` against the landmarks, which are joint centres."""
    clip = moving(body, 3)
    motion = skeleton_of(body, clip.poses(), 30.0)
    marks = np.array([Posed(body, pose).landmarks for pose in clip.poses()])
    for segment, mark in (("tibia_r", "knee_r"), ("ulna_l", "elbow_l"), ("femur_l", "hip_l")):
        there = motion.positions[:, motion.joints.index(segment)]
        np.testing.assert_allclose(there, marks[:, body.landmarks.index(mark)], atol=1e-9)
    rest = motion.rest_positions()[motion.joints.index("foot_r")]
    np.testing.assert_allclose(rest, joint_origin(body, body.segment("foot_r")), atol=1e-12)
