"""The built-in humanoid: closed, right in its proportions, neutral at zero, and its kinematics differentiable."""

from __future__ import annotations

import numpy as np
import pytest

from support.finite_differences import check_jacobian
from support.twins import check_twin
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.kinematics import chain_reference, points_at, skin_points_reference
from twistcap.errors import InputError

H = 1.75
VARIANTS = [
    humanoid(),
    humanoid("legs"),
    humanoid(thorax=True, clavicles=True, wrists=True),
    humanoid(neck=False, stature=1.6, lengths={"femur_r": 1.05}),
]


def mark(body: Body, name: str, pose: Pose | None = None) -> np.ndarray:
    return Posed(body, pose or Pose.rest(body)).landmarks[body.landmarks.index(name)]


def posed(body: Body, **degrees: float) -> Pose:
    pose = Pose.rest(body)
    for name, value in degrees.items():
        for full in (name, f"{name}_r", f"{name}_l"):
            if full in body.coordinate_names:
                pose.q[body.coordinate(full)] = np.deg2rad(value)
    return pose


def volume(body: Body, vertices: np.ndarray) -> float:
    a, b, c = (vertices[body.faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def distance(body: Body, a: str, b: str) -> float:
    return float(np.linalg.norm(mark(body, a) - mark(body, b)))


@pytest.mark.parametrize("body", VARIANTS, ids=lambda b: f"{b.name}-{b.dof}")
def test_surface_is_one_closed_manifold_with_a_sound_binding(body: Body) -> None:
    edges, faces = body.edges
    assert faces.min() >= 0 and len(edges) * 2 == len(body.faces) * 3  # two faces at every edge, never three
    assert len(body.vertices) - len(edges) + len(body.faces) == 2  # a sphere: connected, no handles
    directed = body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)  # every face turns the same way
    assert volume(body, body.vertices) > 0
    assert body.skin_weights.min() >= 0 and body.skin_segments.shape[1] <= 4
    assert np.mean((body.skin_weights > 0).sum(axis=1) <= 2) > 0.75


def test_size_of_the_surface() -> None:
    full, legs = humanoid(), humanoid("legs")
    assert 3600 <= len(full.faces) <= 4400
    assert 0.065 < volume(full, full.vertices) < 0.085
    assert full.dof == 6 + 28 and legs.dof == 6 + 12
    assert humanoid(clavicles=True, wrists=True, thorax=True).dof == 34 + 4 + 2 + 3


def test_surface_folds_nowhere_in_the_modelling_pose() -> None:
    body = humanoid()
    v = Posed(body, posed(body, arm_add=-42, hip_adduction=-7)).vertices
    normals = np.cross(v[body.faces[:, 1]] - v[body.faces[:, 0]], v[body.faces[:, 2]] - v[body.faces[:, 0]])
    assert np.linalg.norm(normals, axis=1).min() / 2 > 5e-6  # m²: no sliver
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bend = np.einsum("ei,ei->e", *(normals[body.edges[1][:, k]] for k in (0, 1)))
    assert np.degrees(np.arccos(bend.min())) < 110


@pytest.mark.parametrize("stature", [1.75, 1.6])
def test_proportions_are_those_cited(stature: float) -> None:
    body = humanoid(stature=stature)
    v = body.vertices
    foot = v[body.vertex_part == body.segment("foot_r")]
    expected = {  # Winter 2009, fig. 4.1
        np.ptp(v[:, 2]): 1.0,
        distance(body, "hip_l", "knee_l"): 0.245,
        distance(body, "knee_l", "ankle_l"): 0.246,
        distance(body, "shoulder_r", "elbow_r"): 0.186,
        distance(body, "elbow_r", "wrist_r"): 0.146,
        mark(body, "wrist_r")[2] - v[body.vertex_part == body.segment("radius_r")][:, 2].min(): 0.108,
        np.ptp(foot[:, 0]): 0.152,
        mark(body, "mid_hip")[2] - v[:, 2].min(): 0.530,
        mark(body, "eye_l")[2] - v[:, 2].min(): 0.936,
    }
    for value, ratio in expected.items():
        assert value == pytest.approx(ratio * stature, rel=0.01)


def test_left_mirrors_right() -> None:
    body = humanoid()
    mirrored = body.vertices * [1, -1, 1]
    gaps = np.linalg.norm(mirrored[:, None] - body.vertices[None], axis=2).min(axis=1)
    assert gaps.max() < 1e-4
    pose = posed(body, arm_add=-30, hip_rotation=20, subtalar_angle=10, pro_sup=30, arm_rot=15, ankle_angle=10)
    for name in ("toe", "wrist", "elbow", "small_toe"):
        np.testing.assert_allclose(
            mark(body, f"{name}_r", pose), mark(body, f"{name}_l", pose) * [1, -1, 1], atol=1e-12
        )


def test_zero_is_the_neutral_pose() -> None:
    body = humanoid()
    np.testing.assert_allclose(Posed(body, Pose.rest(body)).vertices, body.vertices, atol=1e-12)
    np.testing.assert_allclose(mark(body, "hip_r") + mark(body, "hip_l"), 0, atol=1e-12)
    for limb in (("hip_r", "knee_r", "ankle_r"), ("shoulder_l", "elbow_l", "wrist_l")):
        points = np.array([mark(body, name) for name in limb])
        assert np.ptp(points[:, :2], axis=0).max() < 1e-9  # straight down
    assert mark(body, "toe_l")[0] > mark(body, "heel_l")[0] + 0.2
    hand = body.vertices[body.vertex_part == body.segment("radius_l")]
    hand = hand[hand[:, 2] < mark(body, "wrist_l")[2] - 0.04]
    assert np.ptp(hand[:, 0]) > 2 * np.ptp(hand[:, 1])  # flat, palms to the thighs


@pytest.mark.parametrize(
    ("coordinate", "site", "direction"),
    [
        ("hip_flexion", "knee_r", (1, 0, 0)),
        ("hip_adduction", "knee_r", (0, 1, 0)),
        ("hip_rotation", "toe_r", (0, 1, 0)),
        ("knee_angle", "ankle_r", (-1, 0, 0)),
        ("ankle_angle", "toe_r", (0, 0, 1)),
        ("subtalar_angle", "small_toe_r", (0, 1, 0)),
        ("lumbar_extension", "neck", (-1, 0, 0)),
        ("lumbar_bending", "neck", (0, -1, 0)),
        ("lumbar_rotation", "shoulder_r", (1, 0, 0)),
        ("neck_rotation", "nose", (0, 1, 0)),
        ("arm_flex", "elbow_r", (1, 0, 0)),
        ("arm_add", "elbow_r", (0, 1, 0)),
        ("elbow_flex", "wrist_r", (1, 0, 0)),
    ],
)
def test_signs_are_opensims(coordinate: str, site: str, direction: tuple[int, int, int]) -> None:
    body = humanoid()
    moved = mark(body, site, posed(body, **{coordinate: 5})) - mark(body, site)
    assert moved @ np.array(direction) > 0.6 * np.linalg.norm(moved) > 0


def test_volume_holds_when_joints_bend() -> None:
    body = humanoid()
    at_rest = volume(body, body.vertices)
    for pose in (
        posed(body, arm_add=-90),
        posed(body, hip_flexion=95, knee_angle=100),
        posed(body, elbow_flex=100),
        posed(body, arm_flex=90),
    ):
        assert volume(body, Posed(body, pose).vertices) == pytest.approx(at_rest, rel=0.05)


@pytest.mark.parametrize("body", VARIANTS[:3], ids=lambda b: f"{b.name}-{b.dof}")
def test_jacobians_and_readable_twins(body: Body) -> None:
    rng = np.random.default_rng(1)
    pose = Pose.rest(body).retract(rng.normal(0, 0.3, body.dof))
    here = Posed(body, pose)
    np.testing.assert_allclose(
        here.joint_transforms, chain_reference(pose.root, body.twists, body.parent, pose.q), atol=1e-12
    )
    twin = skin_points_reference(here.segment_transforms, body.skin_segments, body.skin_weights, body.vertices)
    np.testing.assert_allclose(here.vertices, twin, atol=1e-12)
    some = rng.choice(len(body.vertices), 60, replace=False)
    bound = body.skin_segments[some], body.skin_weights[some], body.vertices[some]
    q = pose.q + rng.normal(0, 0.3, (4, len(pose.q)))
    moving = body.segment_joint[bound[0]], *bound[1:]
    moved = check_twin(points_at, pose.root, body.twists, body.parent, q, *moving)
    np.testing.assert_allclose(moved[2], Posed(body, Pose(pose.root, q[2])).points(*bound), atol=1e-12)
    J = here.point_jacobian(*bound)
    check_jacobian(lambda d: Posed(body, pose.retract(d)).points(*bound), J, np.zeros(body.dof))
    marks = body.landmarks
    rigid = marks.segments[:, None], np.ones((len(marks.names), 1)), marks.points
    J = here.point_jacobian(*rigid)
    check_jacobian(lambda d: Posed(body, pose.retract(d)).landmarks, J, np.zeros(body.dof))


def test_lengths_and_girths_scale_their_segment_alone() -> None:
    plain, long = humanoid(), humanoid(lengths={"femur_r": 1.1, "ulna_l": 0.9}, girths={"tibia_l": 1.2})
    assert distance(long, "hip_r", "knee_r") == pytest.approx(1.1 * distance(plain, "hip_r", "knee_r"), rel=1e-6)
    assert distance(long, "elbow_l", "wrist_l") == pytest.approx(0.9 * distance(plain, "elbow_l", "wrist_l"), rel=1e-6)
    for pair in (("hip_l", "knee_l"), ("knee_r", "ankle_r"), ("elbow_r", "wrist_r"), ("ankle_l", "toe_l")):
        assert distance(long, *pair) == pytest.approx(distance(plain, *pair), rel=1e-6)
    calf = (plain.vertex_part == plain.segment("tibia_l")) & (np.abs(plain.vertices[:, 2] + 0.6) < 0.05)
    assert np.ptp(long.vertices[calf, 1]) == pytest.approx(1.2 * np.ptp(plain.vertices[calf, 1]), rel=0.02)


def test_bad_wishes_are_named() -> None:
    with pytest.raises(InputError, match="variant"):
        humanoid("arms")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="stature"):
        humanoid(stature=-1.0)
    with pytest.raises(InputError, match="tail"):
        humanoid(lengths={"tail": 2.0})
