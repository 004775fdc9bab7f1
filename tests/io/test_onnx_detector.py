"""The ONNX detector, end to end with small models that find coloured dots."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.cameras import ring
from twistcap.adjust.first_pose import fit_keypoints
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.io.keypoints import LAYOUTS
from twistcap.io.onnx_detector import detected_by_model, load_detector

onnx = pytest.importorskip("onnx", reason="needs onnx, to make a model")
pytest.importorskip("onnxruntime", reason="needs the extra detect")

NAMES = LAYOUTS["coco_17"]
LEVELS = np.linspace(60, 250, len(NAMES)).round()  # red of each joint's dot


def tent(image: str, level: float, k: int) -> list[Any]:
    """Nodes of the score of joint k: 1 where red is its level, 0 from 4 on; -> (1, 1, H, W)."""
    make = onnx.helper.make_node
    return [
        make("Sub", [image, f"level{k}"], [f"d{k}"]), make("Abs", [f"d{k}"], [f"a{k}"]),
        make("Sub", ["reach", f"a{k}"], [f"t{k}"]), make("Relu", [f"t{k}"], [f"h{k}"]),
    ]  # fmt: skip


def simcc_model(path: Path, size: tuple[int, int]) -> Path:
    """SimCC: for each joint the largest score of each column and of each row, split 1."""
    make, value, const = onnx.helper.make_node, onnx.helper.make_tensor_value_info, onnx.numpy_helper.from_array
    scale = np.float32([58.395])
    nodes = [
        make("Slice", ["image", "zero", "one", "channel"], ["red"]),
        make("Mul", ["red", "std"], ["scaled"]), make("Add", ["scaled", "mean"], ["raw"]),
    ]  # fmt: skip
    constants = {"zero": np.int64([0]), "one": np.int64([1]), "channel": np.int64([1]), "std": scale,
                 "mean": np.float32([123.675]), "reach": np.float32([4.0])}  # fmt: skip
    for k, level in enumerate(LEVELS):
        constants[f"level{k}"] = np.float32([level])
        nodes += tent("raw", level, k)
    nodes += [
        make("Concat", [f"h{k}" for k in range(len(LEVELS))], ["heat"], axis=1),
        make("ReduceMax", ["heat"], ["simcc_x"], axes=[2], keepdims=0),
        make("ReduceMax", ["heat"], ["simcc_y"], axes=[3], keepdims=0),
    ]
    width, height = size
    outputs = [value(n, 1, [1, len(LEVELS), m]) for n, m in (("simcc_x", width), ("simcc_y", height))]
    tensors = [const(v, n) for n, v in constants.items()]
    graph = onnx.helper.make_graph(nodes, "simcc", [value("image", 1, [1, 3, height, width])], outputs, tensors)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def one_stage_model(path: Path, size: tuple[int, int], people: np.ndarray) -> Path:
    """RTMO: gives the same boxes and keypoints for any image (a node reads it, so that it is an input)."""
    make, value, const = onnx.helper.make_node, onnx.helper.make_tensor_value_info, onnx.numpy_helper.from_array
    boxes = np.float32([[[0, 0, 9, 9, 0.9]] * (len(people) - 1) + [[0, 0, 9, 9, 0.1]]])
    nodes = [
        make("ReduceMean", ["image"], ["m"], keepdims=0), make("Mul", ["m", "zero"], ["z"]),
        make("Add", ["b", "z"], ["dets"]), make("Add", ["k", "z"], ["keypoints"]),
    ]  # fmt: skip
    tensors = [const(np.float32(v), n) for n, v in (("zero", 0.0), ("b", boxes), ("k", people[None]))]
    outputs = [value("dets", 1, boxes.shape), value("keypoints", 1, (1, *people.shape))]
    graph = onnx.helper.make_graph(nodes, "rtmo", [value("image", 1, [1, 3, size[1], size[0]])], outputs, tensors)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def test_a_simcc_model_gives_the_first_pose(tmp_path: Path) -> None:
    rig, body = ring(), humanoid("full")
    root = np.eye(4)
    root[2, 3] = 0.93
    person = Posed(body, Pose(root, np.array([0.4 if n.startswith("elbow") else 0.0 for n in body.coordinate_names])))
    marks = dict(zip(body.landmarks.names, person.landmarks, strict=True))
    images = list[Any]()
    for camera in rig:
        image = np.zeros((camera.size[1], camera.size[0], 3), np.uint8)
        for name, level in zip(NAMES, LEVELS, strict=True):
            x, y = camera.project(marks[name][None])[0][0].round().astype(int)
            image[y - 1 : y + 2, x - 1 : x + 2, 0] = level
        images.append(image)
    width, height = rig[0].size
    detector = load_detector(simcc_model(tmp_path / "pose.onnx", (width, height)))
    found = detected_by_model(detector, images, rig)
    assert found.names == NAMES and (found.confidence > 0).sum() > 0.6 * found.confidence.size
    fit = fit_keypoints(body, rig, found)
    error = np.linalg.norm(Posed(fit.body, fit.pose).landmarks - person.landmarks, axis=1)
    hips = [body.landmarks.names.index(f"{j}_{s}") for j in ("hip", "knee", "shoulder") for s in "rl"]
    assert np.median(error[hips]) < 0.04


def test_a_one_stage_model_gives_everybody_in_the_image_s_pixels(tmp_path: Path) -> None:
    people = np.full((3, 17, 3), 0.8)
    people[..., 0], people[..., 1] = 10.0, 20.0
    people[1, :, 0] = 30.0
    detector = load_detector(one_stage_model(tmp_path / "rtmo.onnx", (64, 64), people))
    found = detector.people(np.zeros((128, 128, 3), np.uint8))
    assert found.shape == (2, 17, 3)  # the third has a low score
    np.testing.assert_allclose(found[:, 0, :2], [[20, 40], [60, 40]], atol=1e-4)


def test_a_model_that_cannot_be_used_is_told(tmp_path: Path) -> None:
    path = one_stage_model(tmp_path / "m.onnx", (64, 64), np.full((2, 5, 3), 0.8))
    assert load_detector(path, hashlib.sha256(path.read_bytes()).hexdigest()).size == (64, 64)
    with pytest.raises(InputError, match="checksum"):
        load_detector(path, "0" * 64)
    images = [np.zeros((64, 64, 3), np.uint8)] * 4
    with pytest.raises(InputError, match="gives 5 keypoints"):
        detected_by_model(load_detector(path), images, ring())
    (tmp_path / "bad.onnx").write_bytes(b"none")
    with pytest.raises(InputError, match=r"bad\.onnx is no ONNX file"):
        load_detector(tmp_path / "bad.onnx")
    with pytest.raises(InputError, match=r"none\.onnx"):
        load_detector(tmp_path / "none.onnx")
