"""Small pose networks as ONNX files; they find joints that are drawn as dots of given red."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.body import Posed
from twistcap.camera import Camera
from twistcap.io.keypoints import LAYOUTS

NAMES = LAYOUTS["coco_17"]
LEVELS = np.linspace(60, 250, len(NAMES)).round()  # red of each joint's dot


def saved(
    path: Path, nodes: Sequence[Any], constants: Mapping[str, Any], size: tuple[Any, Any],
    outputs: Mapping[str, tuple[int, ...]], kind: int = 1,
) -> Path:  # fmt: skip
    """A model of one input ``image`` (1, 3, H, W) of a type (1 is float, 10 half), and the shapes of its outputs."""
    import onnx

    value = onnx.helper.make_tensor_value_info
    tensors = [onnx.numpy_helper.from_array(np.asarray(array), name) for name, array in constants.items()]
    image = value("image", kind, [1, 3, size[1], size[0]])
    told = [value(name, 1, shape) for name, shape in outputs.items()]
    graph = onnx.helper.make_graph(nodes, "network", [image], told, tensors)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def simcc_model(path: Path, size: tuple[int, int], split: int = 1) -> Path:
    """As RTMPose: for each joint the largest score of each column and row; a score falls to 0 four levels away."""
    from onnx.helper import make_node as make

    whole = {"zero": [0], "one": [1], "channel": [1]}
    numbers = {"std": [58.395], "mean": [123.675], "reach": [4.0], "x_ends": [1, 1, split]}
    constants: dict[str, Any] = {name: np.array(value, np.int64) for name, value in whole.items()}
    constants |= {name: np.array(value, np.float32) for name, value in numbers.items()}
    nodes = [
        make("Slice", ["image", "zero", "one", "channel"], ["red"]),
        make("Mul", ["red", "std"], ["scaled"]), make("Add", ["scaled", "mean"], ["raw"]),
    ]  # fmt: skip
    for k, level in enumerate(LEVELS):
        constants[f"level{k}"] = np.array([level], np.float32)
        nodes += [
            make("Sub", ["raw", f"level{k}"], [f"d{k}"]), make("Abs", [f"d{k}"], [f"a{k}"]),
            make("Sub", ["reach", f"a{k}"], [f"t{k}"]), make("Relu", [f"t{k}"], [f"h{k}"]),
        ]  # fmt: skip
    nodes.append(make("Concat", [f"h{k}" for k in range(len(LEVELS))], ["heat"], axis=1))
    for name, axis in (("x", 2), ("y", 3)):
        nodes.append(make("ReduceMax", ["heat"], [f"most_{name}"], axes=[axis], keepdims=0))
        nodes.append(make("Resize", [f"most_{name}", "", "x_ends"], [f"simcc_{name}"], mode="nearest",
                          coordinate_transformation_mode="asymmetric", nearest_mode="floor"))  # fmt: skip
    lengths = zip(("simcc_x", "simcc_y"), size, strict=True)
    return saved(path, nodes, constants, size, {name: (1, len(LEVELS), split * n) for name, n in lengths})


def constant_model(path: Path, size: tuple[Any, Any], *outputs: Any, kind: int = 1) -> Path:
    """The same arrays for any image, which a node reads, so that it is an input."""
    from onnx.helper import make_node as make

    nodes = [make("Cast", ["image"], ["f"], to=1), make("ReduceMean", ["f"], ["m"], keepdims=0)]
    nodes.append(make("Mul", ["m", "zero"], ["z"]))
    constants: dict[str, Any] = {"zero": np.float32(0.0)}
    for k, array in enumerate(outputs):
        constants[f"c{k}"] = np.asarray(array, np.float32)
        nodes.append(make("Add", [f"c{k}", "z"], [f"out{k}"]))
    return saved(path, nodes, constants, size, {f"out{k}": np.shape(a) for k, a in enumerate(outputs)}, kind)


def one_stage_model(path: Path, size: tuple[int, int], people: np.ndarray) -> Path:
    """As RTMO; the last of the people (P, K, 3) has a low score."""
    boxes = [[0, 0, 9, 9, 0.9]] * (len(people) - 1) + [[0, 0, 9, 9, 0.1]]
    return constant_model(path, size, [boxes], people[None])


def dotted(camera: Camera, person: Posed) -> np.ndarray:
    """(H, W, 3) an image with a dot at each joint."""
    marks = dict(zip(person.body.landmarks.names, person.landmarks, strict=True))
    image = np.zeros((camera.size[1], camera.size[0], 3), np.uint8)
    for name, level in zip(NAMES, LEVELS, strict=True):
        x, y = camera.project(marks[name][None])[0][0].round().astype(int)
        image[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2, 0] = level
    return image
