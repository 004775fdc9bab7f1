"""Joint angles by their definitions, computed here again from the posed body's points; their standard deviations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.anatomy import bones_of
from twistcap.body.humanoid import humanoid
from twistcap.body.shape import joints_moved
from twistcap.errors import InputError
from twistcap.io.coordinates import Coordinates, coordinates_of, opensim_angles
from twistcap.se3 import transform
from twistcap.studio.motion import gait


@pytest.fixture(scope="module")
def body() -> Body:
    """Somebody whose limbs are not straight: knees and elbows out of line."""
    whole = humanoid(thorax=True, clavicles=True, wrists=True)
    shifts = {"tibia_r": [0.01, -0.015, 0.0], "tibia_l": [-0.01, -0.01, 0.02], "ulna_r": [0.012, 0.006, 0.0]}
    return joints_moved(whole, {name: np.array(shift) for name, shift in shifts.items()})


@pytest.fixture(scope="module")
def poses(body: Body) -> list[Pose]:
    """A walk with every coordinate disturbed by 0.3 rad: no joint is left at its zero."""
    rng = np.random.default_rng(5)
    heading = gait(body, frames=40, heading=0.7)
    return [Pose(p.root, p.q + rng.normal(scale=0.3, size=len(p.q))) for p in heading]


def column(table: Coordinates, name: str) -> Float:
    return table.in_degrees[0][:, table.names.index(name)]


def degrees_apart(one: Float, other: Float) -> float:
    return float(np.abs((one - other + 180) % 360 - 180).max())


def unit(v: Float) -> Float:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def world_frame(body: Body, poses: list[Pose], top: str, bottom: str, hinge: str, sign: float) -> Float:
    """(T, 3, 3) columns x, y, z of a long bone in the world: from two posed landmarks and a posed hinge axis."""
    posed = [Posed(body, pose) for pose in poses]
    marks = np.array([p.landmarks for p in posed])
    y = unit(marks[:, body.landmarks.index(top)] - marks[:, body.landmarks.index(bottom)])
    right = sign * np.array([p.world_twists[body.coordinate(hinge), :3] for p in posed])
    x = unit(np.cross(y, right))
    return np.stack([x, y, np.cross(x, y)], axis=2)


def trunk_frame(body: Body, poses: list[Pose], segment: str) -> Float:
    R = np.array([Posed(body, p).segment_transforms[body.segment(segment), :3, :3] for p in poses])
    return np.stack([R[:, :, 0], R[:, :, 2], -R[:, :, 1]], axis=2)


def grood_suntay(upper: Float, lower: Float, right: bool) -> tuple[Float, Float, Float]:
    """Their formulas: e1 the upper bone's z, e3 the lower bone's y, e2 across both; degrees, signs as for the hip."""
    e1, e3 = upper[:, :, 2], lower[:, :, 1]
    e2 = unit(np.cross(e3, e1))
    first = np.arctan2(np.sum(e2 * upper[:, :, 1], axis=1), np.sum(e2 * upper[:, :, 0], axis=1))
    second = np.arccos(np.sum(e1 * e3, axis=1)) - np.pi / 2
    third = np.arctan2(-np.sum(e2 * lower[:, :, 2], axis=1), np.sum(e2 * lower[:, :, 0], axis=1))
    side = 1.0 if right else -1.0
    return np.degrees(first), -side * np.degrees(second), -side * np.degrees(third)


@pytest.mark.parametrize("side", ["r", "l"])
def test_isb_angles_of_the_leg_by_grood_and_suntays_vectors(body: Body, poses: list[Pose], side: str) -> None:
    table = coordinates_of(body, poses, angles="isb")
    femur = world_frame(body, poses, f"hip_{side}", f"knee_{side}", f"knee_angle_{side}", -1.0)
    tibia = world_frame(body, poses, f"knee_{side}", f"ankle_{side}", f"knee_angle_{side}", -1.0)
    pelvis = trunk_frame(body, poses, "pelvis")
    for joint, upper, lower, names, signs in (
        ("hip", pelvis, femur, ("flexion", "adduction", "rotation"), (1, 1, 1)),
        ("knee", femur, tibia, ("flexion", "adduction", "rotation"), (-1, 1, 1)),
    ):
        for name, sign, angle in zip(names, signs, grood_suntay(upper, lower, side == "r"), strict=True):
            assert degrees_apart(column(table, f"isb_{joint}_{name}_{side}"), sign * angle) < 0.01, name
    assert np.abs(column(table, f"isb_knee_adduction_{side}")).max() > 0.5  # those knees are out of line


@pytest.mark.parametrize("side", ["r", "l"])
def test_isb_angles_of_the_ankle_are_zero_in_the_neutral_posture(body: Body, poses: list[Pose], side: str) -> None:
    neutral = coordinates_of(body, [Pose.rest(body)], angles="isb")
    parts = [f"isb_ankle_{name}_{side}" for name in ("dorsiflexion", "inversion", "rotation")]
    assert max(abs(column(neutral, name)[0]) for name in parts) < 1e-9
    tibia = world_frame(body, poses, f"knee_{side}", f"ankle_{side}", f"knee_angle_{side}", -1.0)
    shank = np.array([Posed(body, p).segment_transforms[body.segment(f"tibia_{side}"), :3, :3] for p in poses])
    sole = np.array([Posed(body, p).segment_transforms[body.segment(f"foot_{side}"), :3, :3] for p in poses])
    foot = sole @ shank.swapaxes(1, 2) @ tibia
    table = coordinates_of(body, poses, angles="isb")
    for name, angle in zip(parts, grood_suntay(tibia, foot, side == "r"), strict=True):
        assert degrees_apart(column(table, name), angle) < 0.01, name


@pytest.mark.parametrize("side", ["r", "l"])
def test_isb_angles_of_the_arm_by_scipy(body: Body, poses: list[Pose], side: str) -> None:
    mirror = np.diag([1.0, 1.0, 1.0 if side == "r" else -1.0])
    humerus = world_frame(body, poses, f"shoulder_{side}", f"elbow_{side}", f"elbow_flex_{side}", 1.0)
    thorax = trunk_frame(body, poses, "thorax")
    relative = mirror @ thorax.swapaxes(1, 2) @ humerus @ mirror
    plane, down, turn = Rotation.from_matrix(relative).as_euler("YXY", degrees=True).T
    plane, down, turn = plane - 180, -down, turn + 180  # scipy's second angle is positive, Wu's negative
    table = coordinates_of(body, poses, angles="isb")
    for name, angle in (("plane", plane), ("elevation", -down), ("rotation", turn)):
        assert degrees_apart(column(table, f"isb_shoulder_{name}_{side}"), angle) < 0.01, name
    np.testing.assert_array_less(-1e-9, column(table, f"isb_shoulder_elevation_{side}"))


def test_isb_angles_of_trunk_and_neck_by_grood_and_suntays_vectors(body: Body, poses: list[Pose]) -> None:
    table = coordinates_of(body, poses, angles="isb")
    pelvis, thorax, head = (trunk_frame(body, poses, segment) for segment in ("pelvis", "thorax", "head"))
    for joint, upper, lower in (("trunk", pelvis, thorax), ("neck", thorax, head)):
        for name, angle in zip(("extension", "bending", "rotation"), grood_suntay(upper, lower, True), strict=True):
            assert degrees_apart(column(table, f"isb_{joint}_{name}"), angle) < 0.01, name


@pytest.mark.parametrize("side", ["r", "l"])
def test_isb_angles_of_elbow_and_wrist_by_grood_and_suntays_vectors(body: Body, poses: list[Pose], side: str) -> None:
    """The forearm's x is where the palm faces: at rest to the thigh."""
    rest = [Pose.rest(body)]
    at_rest = world_frame(body, rest, f"elbow_{side}", f"wrist_{side}", f"elbow_flex_{side}", 1.0)[0]
    palm, up = (-1.0 if side == "r" else 1.0) * at_rest[:, 2], at_rest[:, 1]
    neutral = np.stack([palm, up, np.cross(palm, up)], axis=1)
    humerus = world_frame(body, poses, f"shoulder_{side}", f"elbow_{side}", f"elbow_flex_{side}", 1.0)
    forearm, hand = (
        np.array([Posed(body, p).segment_transforms[body.segment(f"{segment}_{side}"), :3, :3] for p in poses])
        @ neutral
        for segment in ("radius", "hand")
    )
    table = coordinates_of(body, poses, angles="isb")
    for joint, upper, lower, names in (
        ("elbow", humerus, forearm, ("flexion", "carrying", "pronation")),
        ("wrist", forearm, hand, ("flexion", "deviation", "rotation")),
    ):
        for name, angle in zip(names, grood_suntay(upper, lower, side == "r"), strict=True):
            assert degrees_apart(column(table, f"isb_{joint}_{name}_{side}"), angle) < 0.01, name


def test_signs_of_isb_angles(body: Body) -> None:
    """One movement at a time, known by where it takes the limb; both sides alike."""
    q = np.zeros(len(body.coordinate_names))
    for side in ("r", "l"):
        for name, angle in {"hip_flexion": 30, "knee_angle": 50, "elbow_flex": 70, "pro_sup": 20, "wrist_flex": 10,
                            "hip_adduction": 0, "arm_add": -60}.items():  # fmt: skip
            q[body.coordinate(f"{name}_{side}")] = np.radians(angle)
    straight = humanoid(thorax=True, clavicles=True, wrists=True)
    table = coordinates_of(straight, [Pose(np.eye(4), q)], angles="isb")
    for side in ("r", "l"):
        wanted = {"hip_flexion": 30, "knee_flexion": 50, "elbow_flexion": 70, "elbow_pronation": 110}
        wanted |= {"wrist_flexion": 10, "shoulder_plane": 0, "shoulder_elevation": 60, "shoulder_rotation": 0}
        for name, angle in wanted.items():
            assert column(table, f"isb_{name}_{side}")[0] == pytest.approx(angle, abs=1e-6), name
    forward = np.zeros_like(q)
    forward[[body.coordinate("arm_flex_r"), body.coordinate("arm_flex_l")]] = np.radians(80)
    table = coordinates_of(straight, [Pose(np.eye(4), forward)], angles="isb")
    for side in ("r", "l"):
        assert column(table, f"isb_shoulder_plane_{side}")[0] == pytest.approx(90)
        assert column(table, f"isb_shoulder_elevation_{side}")[0] == pytest.approx(80)


@pytest.mark.parametrize("angles", ["opensim", "isb"])
@pytest.mark.parametrize("axes", ["opensim", "pose2sim", "z_up"])
def test_standard_deviations_by_finite_differences(body: Body, poses: list[Pose], angles: str, axes: str) -> None:
    few, size = poses[:3], 1e-6
    A = np.random.default_rng(0).normal(size=(3, body.dof, body.dof)) * 0.003
    args: dict[str, str] = {"angles": angles, "axes": axes}
    table = coordinates_of(body, few, A @ A.swapaxes(1, 2), **args)  # type: ignore[arg-type]

    def moved(step: Float) -> Float:
        return coordinates_of(body, [pose.retract(step) for pose in few], **args).values  # type: ignore[arg-type]

    steps = size * np.eye(body.dof)
    by_step = np.stack([(moved(step) - moved(-step)) / (2 * size) for step in steps], axis=2)
    wanted = np.sqrt(np.einsum("tci,tij,tcj->tc", by_step, A @ A.swapaxes(1, 2), by_step))
    wanted[:, table.turning] = np.minimum(wanted[:, table.turning], np.pi)
    np.testing.assert_allclose(table.sigmas, wanted, atol=1e-7, rtol=1e-5)


def test_isb_angles_of_the_shoulder_are_continuous() -> None:
    """Of arms that hang a little inwards, in a walk: the plane of elevation passes 180°."""
    plain = humanoid()
    walk = gait(plain, frames=200)
    inward = np.zeros(len(plain.coordinate_names))
    inward[[plain.coordinate(f"arm_add_{side}") for side in "rl"]] = np.radians(3.0)
    table = coordinates_of(plain, [Pose(p.root, p.q + inward) for p in walk], angles="isb")
    for part in ("plane", "rotation"):
        assert np.abs(np.diff(column(table, f"isb_shoulder_{part}_r"))).max() < 90


def test_lost_poses_that_turn_leave_no_whole_turn(body: Body, poses: list[Pose]) -> None:
    known = np.ones(len(poses), bool)
    known[10:30] = False
    steps = np.clip(np.arange(len(poses)) - 10, 0, 20) / 20  # a whole turn while nothing is known
    turns = transform(Rotation.from_rotvec(2 * np.pi * steps[:, None] * [0.0, 0.0, 1.0]).as_matrix(), np.zeros(3))
    turned = [Pose(turn @ p.root, p.q) for turn, p in zip(turns, poses, strict=True)]
    whole, found = coordinates_of(body, poses), coordinates_of(body, turned, known=known)
    np.testing.assert_allclose(found.values[known], whole.values[known], atol=1e-9)


def test_an_angle_that_is_not_defined_has_a_sigma_of_180_degrees(body: Body) -> None:
    straight = humanoid()
    table = coordinates_of(straight, [Pose.rest(straight)], np.eye(straight.dof)[None] * 1e-6, "isb")
    sigma = table.in_degrees[1][0, table.names.index("isb_shoulder_plane_r")]
    assert sigma == pytest.approx(180.0)


def test_what_a_body_lacks_is_left_out() -> None:
    legs = humanoid("legs")
    assert set(bones_of(legs)) == {"pelvis", *(f"{b}_{s}" for b in ("femur", "tibia", "foot") for s in "rl")}
    assert not any("shoulder" in name for name in coordinates_of(legs, [Pose.rest(legs)], angles="isb").names)
    with pytest.raises(InputError, match="angles is 'euler'; it must be one of opensim, isb"):
        coordinates_of(legs, [], angles="euler")  # type: ignore[arg-type]


def test_opensim_angles_of_some_coordinates(body: Body, poses: list[Pose]) -> None:
    """As in the whole table, whatever the order of the names; a gap stays one and spoils no other frame."""
    table = coordinates_of(body, poses)
    names = ["pro_sup_r", "arm_rot_l", "knee_angle_r", "arm_add_l", "arm_flex_l", "arm_flex_r"]
    q = np.array([pose.q for pose in poses])[:, [body.coordinate(name) for name in names]]
    q[3, 1] = np.nan
    found = np.degrees(opensim_angles(body, names, q))
    wanted = np.stack([column(table, name) for name in names], axis=1)
    rest = np.arange(len(poses)) != 3
    np.testing.assert_allclose(found[rest, :5], wanted[rest, :5], atol=1e-9)
    assert np.isnan(found[3, 1]) and found[3, 2] == pytest.approx(wanted[3, 2])
    np.testing.assert_allclose(found[:, 5], np.degrees(q[:, 5]))  # its shoulder is not whole
