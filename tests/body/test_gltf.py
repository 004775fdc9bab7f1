"""GLB bodies: round trip, foreign files, what a viewer sees, and bad files."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pygltflib import GLTF2

from support.rigs import rigged_glb
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.gltf import load_described, load_glb, save_glb
from twistcap.body.humanoid import humanoid
from twistcap.body.model import edges_of
from twistcap.errors import InputError

TO_REST = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # glTF (y up, facing z) to ours (z up, facing x)


def random_poses(body: Body, count: int, seed: int = 0) -> list[Pose]:
    rng = np.random.default_rng(seed)
    lo, hi = body.limits.T
    return [Pose(se3.exp(rng.normal(size=6)), rng.uniform(lo, hi)) for _ in range(count)]


# --- a viewer of its own: plain glTF, knowing nothing of twistcap ---------------------------------------------------


def accessor(gltf: GLTF2, blob: bytes, number: int) -> np.ndarray:
    entry = gltf.accessors[number]
    view = gltf.bufferViews[entry.bufferView]
    kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[entry.componentType]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry.type]
    data = np.frombuffer(blob, kind, entry.count * width, (view.byteOffset or 0) + (entry.byteOffset or 0))
    return data.reshape(entry.count, width).astype(float)


def quaternion_matrix(q: np.ndarray) -> np.ndarray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def viewed(path: Path, key: int | None) -> np.ndarray:
    """World vertices of the first skinned node at a key of the first animation (or in the nodes' own pose)."""
    gltf = GLTF2().load(str(path))
    assert gltf is not None
    blob = bytes(gltf.binary_blob() or b"")
    local = [
        {"rotation": np.array(n.rotation or [0, 0, 0, 1.0]), "translation": np.array(n.translation or [0, 0, 0.0])}
        for n in gltf.nodes
    ]
    if key is not None:
        for channel in gltf.animations[0].channels:
            sampler = gltf.animations[0].samplers[channel.sampler]
            local[channel.target.node][channel.target.path] = accessor(gltf, blob, sampler.output)[key]
    world: dict[int, np.ndarray] = {}

    def walk(n: int, above: np.ndarray) -> None:
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = quaternion_matrix(local[n]["rotation"]), local[n]["translation"]
        world[n] = above @ own
        for child in gltf.nodes[n].children or []:
            walk(child, world[n])

    for n in gltf.scenes[gltf.scene].nodes:
        walk(n, np.eye(4))
    node = next(n for n in gltf.nodes if n.skin is not None)
    skin = gltf.skins[node.skin]
    binds = accessor(gltf, blob, skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
    motion = np.array([world[j] for j in skin.joints]) @ binds
    at = gltf.meshes[node.mesh].primitives[0].attributes
    V = np.c_[accessor(gltf, blob, at.POSITION), np.ones(gltf.accessors[at.POSITION].count)]
    J, W = accessor(gltf, blob, at.JOINTS_0).astype(int), accessor(gltf, blob, at.WEIGHTS_0)
    return np.einsum("vk,vkij,vj->vi", W, motion[J], V)[:, :3]


# --- a foreign file: two boxes on two bones, with texture seams, under a scaled armature ----------------------------


def box(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """A box 0.2 wide from y = low to y = high, each face with its own four vertices."""
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (low, high) for z in (-0.1, 0.1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    vertices = np.concatenate([corners[list(q)] for q in quads])
    faces = np.concatenate([[[4 * f, 4 * f + 1, 4 * f + 2], [4 * f, 4 * f + 2, 4 * f + 3]] for f in range(6)])
    return vertices, faces


def foreign(path: Path, **changes: Any) -> Path:
    """A glTF with data URI: joints `base` (at the origin) and `tip` (at y = 1), in centimetres."""
    blob, views, accessors = bytearray(), list[dict[str, Any]](), list[dict[str, Any]]()

    def add(data: np.ndarray, kind: str, code: int, normalized: bool = False) -> int:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": data.nbytes})
        entry = {"bufferView": len(views) - 1, "componentType": code, "count": len(data), "type": kind}
        accessors.append(entry | ({"normalized": True} if normalized else {}))
        blob.extend(data.tobytes() + b"\0" * (-data.nbytes % 4))
        return len(accessors) - 1

    primitives = []
    for low, high, joint in ((0.0, 1.0, 0), (1.2, 2.0, 1)):
        vertices, faces = box(low, high)
        # One end of the lower box is shared half and half, as bytes that do not sum to 1.
        joints, weights = np.zeros((len(vertices), 4), np.uint8), np.zeros((len(vertices), 4), np.uint8)
        joints[:, 0], joints[:, 1], weights[:, 0] = joint, 1 - joint, 200
        weights[vertices[:, 1] == 1.0, 1] = 200
        attributes = {
            "POSITION": add((100 * vertices).astype("<f4"), "VEC3", 5126),
            "JOINTS_0": add(joints, "VEC4", 5121),
            "WEIGHTS_0": add(weights, "VEC4", 5121, normalized=True),
        }
        primitives.append({"attributes": attributes, "indices": add(faces.astype("<u2").ravel(), "SCALAR", 5123)})
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = -100.0
    gltf: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 3]}],
        "nodes": [
            {"name": "armature", "children": [1], "scale": [0.01] * 3, "translation": [0, 0.5, 0]},
            {"name": "base", "children": [2]},
            {"name": "tip", "translation": [0, 100.0, 0]},
            {"name": "mesh", "mesh": 0, "skin": 0, "translation": [7, 7, 7]},  # to be ignored for skinned meshes
        ],
        "meshes": [{"primitives": primitives}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": add(binds.transpose(0, 2, 1).astype("<f4"), "MAT4", 5126)}],
        "accessors": accessors,
        "bufferViews": views,
    }
    gltf["accessors"][-1]["count"] = 2
    uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(blob)).decode()
    gltf["buffers"] = [{"byteLength": len(blob), "uri": uri}]
    for key, value in changes.items():
        gltf[key] = value(gltf) if callable(value) else value
    path.write_text(json.dumps({k: v for k, v in gltf.items() if v is not None}))
    return path


def test_round_trip_of_the_humanoid(tmp_path: Path) -> None:
    body = humanoid("full")
    save_glb(body, tmp_path / "b.glb", random_poses(body, 3), np.arange(3) / 30)
    again = load_glb(tmp_path / "b.glb")
    assert again.coordinate_names == body.coordinate_names and again.segment_names == body.segment_names
    assert again.landmarks.names == body.landmarks.names and again.name == body.name
    np.testing.assert_array_equal(again.faces, body.faces)
    np.testing.assert_array_equal(again.parent, body.parent)
    np.testing.assert_array_equal(again.limits, body.limits)
    for pose in random_poses(body, 5, seed=1):
        np.testing.assert_allclose(Posed(again, pose).vertices, Posed(body, pose).vertices, atol=1e-6)
        np.testing.assert_allclose(Posed(again, pose).landmarks, Posed(body, pose).landmarks, atol=1e-9)


def test_more_than_four_influences_survive(tmp_path: Path) -> None:
    body = humanoid("full")
    rng = np.random.default_rng(0)
    V = len(body.vertices)
    segments = np.tile(np.arange(6, dtype=np.int32), (V, 1))
    weights = rng.dirichlet(np.ones(6), V)
    six = replace(body, skin_segments=segments, skin_weights=weights)
    save_glb(six, tmp_path / "six.glb")
    pose = random_poses(body, 1)[0]
    np.testing.assert_allclose(
        Posed(load_glb(tmp_path / "six.glb"), pose).vertices, Posed(six, pose).vertices, atol=1e-6
    )


def test_a_viewer_sees_the_motion(tmp_path: Path) -> None:
    body = humanoid("full")
    poses = random_poses(body, 4)
    save_glb(body, tmp_path / "b.glb", poses, np.arange(4) / 30)
    np.testing.assert_allclose(viewed(tmp_path / "b.glb", None) @ TO_REST.T, body.vertices, atol=1e-5)
    for key, pose in enumerate(poses):
        np.testing.assert_allclose(viewed(tmp_path / "b.glb", key) @ TO_REST.T, Posed(body, pose).vertices, atol=1e-5)


def test_animation_needs_times_that_rise(tmp_path: Path) -> None:
    body = humanoid("legs")
    with pytest.raises(InputError, match="needs the time of each pose"):
        save_glb(body, tmp_path / "b.glb", random_poses(body, 2))
    for times in ([0.0, 0.0], [-1.0, 0.0], [0.0, np.nan], [0.5, 0.4]):
        with pytest.raises(InputError, match="must rise"):
            save_glb(body, tmp_path / "b.glb", random_poses(body, 2), np.array(times))


def test_foreign_file_in_our_frame(tmp_path: Path) -> None:
    body = load_glb(foreign(tmp_path / "arm.gltf"))
    assert body.segment_names == ("base", "tip")
    assert body.coordinate_names == ("tip_x", "tip_y", "tip_z")
    assert len(body.vertices) == 16  # seams welded: two boxes of eight corners
    _, sides = edges_of(body.faces)
    assert np.all(sides >= 0)  # closed
    np.testing.assert_allclose(body.vertices.min(axis=0), [-0.1, -0.1, 0.5], atol=1e-6)
    np.testing.assert_allclose(body.vertices.max(axis=0), [0.1, 0.1, 2.5], atol=1e-6)
    np.testing.assert_allclose(body.skin_weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(body.landmarks.points[body.landmarks.index("tip")], [0, 0, 1.5], atol=1e-6)
    corners = body.vertices[body.faces]
    volume = np.sum(np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]) / 6
    assert volume == pytest.approx(0.04 * 1.8, rel=1e-5)  # positive: faces still look outward


def test_foreign_file_bends_as_gltf_says(tmp_path: Path) -> None:
    """Turning the tip by 90° about the file's x is our tip_y; rigid part and half-and-half rim by hand."""
    body = load_glb(foreign(tmp_path / "arm.gltf"))
    q = np.array([0.0, np.pi / 2, 0.0])
    moved = Posed(body, Pose(np.eye(4), q)).vertices
    joint = np.array([0, 0, 1.5])
    R = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    turned = (body.vertices - joint) @ R.T + joint
    z = body.vertices[:, 2]
    share = np.where(z > 1.6, 1.0, np.where(z > 1.4, 0.5, 0.0))[:, None]
    np.testing.assert_allclose(moved, share * turned + (1 - share) * body.vertices, atol=1e-6)


def test_the_bind_pose_is_the_rest_pose(tmp_path: Path) -> None:
    plain = load_glb(foreign(tmp_path / "arm.gltf"))
    bent = foreign(tmp_path / "bent.gltf", nodes=lambda g: [*g["nodes"][:2], _turned(g["nodes"][2]), g["nodes"][3]])
    body = load_glb(bent)
    np.testing.assert_allclose(body.vertices, plain.vertices)
    np.testing.assert_allclose(body.twists, plain.twists, atol=1e-9)


def test_without_inverse_binds_the_nodes_pose_the_skin(tmp_path: Path) -> None:
    """Vertices are then in the joints' own axes: the upper box, at 1.2 to 2 of the tip, ends at 0.5 + 1 + 2."""
    body = load_glb(foreign(tmp_path / "arm.gltf", skins=[{"joints": [1, 2]}]))
    np.testing.assert_allclose(body.vertices[:, 2].max(), 3.5, atol=1e-6)
    np.testing.assert_allclose(body.landmarks.points[body.landmarks.index("tip")], [0, 0, 1.5], atol=1e-6)


def _turned(node: dict[str, Any]) -> dict[str, Any]:
    return node | {"rotation": [np.sin(0.3), 0, 0, np.cos(0.3)]}


def test_rig_toml_beside_the_file(tmp_path: Path) -> None:
    path = foreign(tmp_path / "arm.gltf")
    (tmp_path / "arm.rig.toml").write_text(
        """
        scale = 2.0
        [joints.tip]
        kind = "revolute"
        axes = [[0, 2, 0]]
        names = ["bend"]
        limits_deg = [[-10, 120]]
        segment = "hand"
        [landmarks]
        end = { joint = "tip", at = [0, 0, 5.0] }
        """
    )
    body = load_glb(path)
    assert body.coordinate_names == ("bend",) and body.segment_names == ("base", "hand")
    np.testing.assert_allclose(body.limits, np.radians([[-10, 120]]))
    np.testing.assert_allclose(body.vertices[:, 2].max(), 5.0, atol=1e-5)
    end = Posed(body, Pose(np.eye(4), np.array([np.pi / 2]))).landmarks[0]
    np.testing.assert_allclose(end, [2.0, 0, 3.0], atol=1e-6)


def test_a_rig_file_without_joints_keeps_the_known_rig(tmp_path: Path) -> None:
    path = rigged_glb(tmp_path / "anna.glb", scale=[100.0] * 3)
    said = r"anna\.glb: the body is 175 m high; .* scale = 0\.01 for cm"
    with pytest.raises(InputError, match=said):
        load_glb(path)
    beside = tmp_path / "anna.rig.toml"
    beside.write_text("scale = 0.01")
    body, about = load_described(path)
    assert body.coordinate_names == humanoid().coordinate_names and "taken for the rig of Mixamo" in about
    beside.write_text("scale = 0.01\n[joints]")
    assert "mixamorig:LeftArm_x" in load_glb(path).coordinate_names


def test_fixed_joint_goes_into_its_parent(tmp_path: Path) -> None:
    path = foreign(tmp_path / "arm.gltf")
    (tmp_path / "r.toml").write_text('[joints.tip]\nkind = "fixed"')
    body = load_glb(path, tmp_path / "r.toml")
    assert body.segment_names == ("base",) and body.coordinate_names == ()
    assert np.all(body.skin_weights[:, 0] == 1.0)


def test_universal_and_local_axes(tmp_path: Path) -> None:
    path = foreign(tmp_path / "arm.gltf")
    (tmp_path / "r.toml").write_text(
        '[joints.tip]\nkind = "universal"\naxes = [[1, 0, 0], [0, 1, 0]]\nframe = "joint"\nnames = ["a", "b"]'
    )
    body = load_glb(path, tmp_path / "r.toml")
    np.testing.assert_allclose(body.twists[:, :3], [[0, 1, 0], [0, 0, 1]], atol=1e-9)  # file x is our y, file y our z
    assert list(body.parent) == [-1, 0]


BAD_RIGS = {
    'colour = "red"': "unknown key 'colour' at the top",
    '[joints.tip]\nkindd = "ball"': r"unknown key 'kindd' in \[joints.tip\]; did you mean 'kind'",
    '[joints.tipp]\nkind = "ball"': r"^rig file .*r\.toml: .*arm\.gltf: joints names .*'tipp', .* it has base, tip",
    '[joints.tip]\nkind = "revolute"': "needs axes",
    '[joints.tip]\nkind = "revolute"\naxes = [[0,0,0]]': "no length",
    '[joints.tip]\nnames = ["a"]': "names has 1 entries",
    'root = "nobody"': "nobody",
    'forward = "y"': "vertical",
    "scale = -1": "scale",
    "x = ": "not valid TOML",
}


@pytest.mark.parametrize(("toml", "said"), BAD_RIGS.items())
def test_bad_rig(tmp_path: Path, toml: str, said: str) -> None:
    (tmp_path / "r.toml").write_text(toml)
    with pytest.raises(InputError, match=said):
        load_glb(foreign(tmp_path / "arm.gltf"), tmp_path / "r.toml")


def _lines_mode(gltf: dict[str, Any]) -> Any:
    return [{"primitives": [p | {"mode": 1} for p in gltf["meshes"][0]["primitives"]]}]


def _no_weights(gltf: dict[str, Any]) -> Any:
    p = gltf["meshes"][0]["primitives"][0]
    return [{"primitives": [p | {"attributes": {"POSITION": p["attributes"]["POSITION"]}}]}]


BAD_FILES: dict[str, tuple[dict[str, Any], str]] = {
    "no skin": ({"skins": None, "nodes": [{"mesh": 0}]}, "no skin"),
    "lines": ({"meshes": _lines_mode}, "triangles"),
    "no weights": ({"meshes": _no_weights}, "JOINTS_0"),
    "no buffer": ({"buffers": [{"byteLength": 10, "uri": "gone.bin"}]}, "gone.bin"),
    "short buffer": ({"buffers": [{"byteLength": 4, "uri": "data:;base64,AAAAAA=="}]}, "past the end"),
    "compressed": ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "without compression"),
    "ring": ({"nodes": lambda g: [*g["nodes"][:2], g["nodes"][2] | {"children": [1]}, g["nodes"][3]]}, "ring"),
    "two tops": ({"nodes": lambda g: [g["nodes"][0], {"name": "base"}, *g["nodes"][2:]]}, "several top joints"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file(tmp_path: Path, case: str) -> None:
    changes, said = BAD_FILES[case]
    with pytest.raises(InputError, match=said):
        load_glb(foreign(tmp_path / "arm.gltf", **changes))


@pytest.mark.parametrize("name", ["a.glb", "a.gltf"])
def test_garbage(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_glb(tmp_path / name)
    (tmp_path / name).write_bytes(b"not a mesh at all")
    with pytest.raises(InputError, match=r"no GLB or glTF; check its path"):
        load_glb(tmp_path / name)
