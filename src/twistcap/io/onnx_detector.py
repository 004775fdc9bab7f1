"""2D keypoints by pose networks in ONNX files, on this machine (extra ``detect``: ONNX Runtime).

Three families, told apart by what they give: RTMPose (Jiang et al. 2023, arXiv:2303.07399), one person in a box, with
SimCC outputs x (1, K, s W) and y (1, K, s H); RTMO (Lu et al. 2024, arXiv:2312.07526), everybody at once, with boxes
(1, N, 5) and keypoints (1, N, K, 3); and YOLOX (Ge et al. 2021, arXiv:2107.08430), which finds people for RTMPose, with
boxes (1, N, 5) and labels (1, N). The number of keypoints says their layout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Float, UInt8
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.keypoints import LAYOUTS, NoKeypoints, of_people
from twistcap.io.model_file import model_bytes
from twistcap.io.people import check_arrangement, same_person

Family = Literal["RTMPose", "RTMO", "YOLOX"]
_LAYOUTS = {17: "coco_17", 26: "halpe_26", 133: "coco_133"}
_MEAN, _STD = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])  # of RTMPose's training, RGB
_GREY, _MARGIN = 114, 1.25  # beside the image of RTMO; of the box about a person, as RTMPose was trained
_SEEN = 0.3  # score of a keypoint, and of a person, that counts
_PROVIDERS = ["CPUExecutionProvider"]
_LARGEST_SIDE = 4096  # px of an input


@dataclass(frozen=True)
class Network:
    """A model that is loaded."""

    name: str  # as the user gave it
    session: Any  # onnxruntime.InferenceSession
    input: str
    size: tuple[int, int]  # (width, height) px of its input
    family: Family = "RTMPose"

    def run(self, picture: Any) -> tuple[AnyArray, AnyArray]:
        """The first two outputs for a picture (H, W, 3) of the input's size. Raises InputError where it fails, or its
        numbers are not finite.
        """
        batch = np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)
        try:
            first, second = (np.asarray(out) for out in self.session.run(None, {self.input: batch})[:2])
        except Exception as error:  # its own kinds of exceptions, for whatever is wrong with a file
            raise InputError(f"model {self.name} fails on an image; it is none of RTMPose, RTMO or YOLOX.") from error
        for out in (first, second):
            if out.dtype.kind not in "iuf" or not np.all(np.isfinite(out)):
                raise InputError(f"model {self.name} gives numbers that are not finite; take another file.")
        return first, second


@dataclass(frozen=True)
class OnnxDetector:
    """A pose network, and for RTMPose the one that finds people, if there is one."""

    pose: Network
    boxes: Network | None = None

    def people(self, image: UInt8) -> Float:
        """(P, K, 3) x, y, px of the image (H, W, 3) RGB, and score; score 0 where a keypoint is not seen."""
        found = _everybody(self.pose, image) if self.pose.family == "RTMO" else self._one_by_one(image)
        found[found[..., 2] < _SEEN] = 0.0
        return found[(found[..., 2] > 0).sum(axis=1) >= 3]

    def _one_by_one(self, image: UInt8) -> Float:
        if self.boxes is not None:
            boxes = _person_boxes(self.boxes, image)
            found = [_in_box(self.pose, image, box) for box in boxes]
            return np.stack(found) if found else np.zeros((0, 1, 3))
        height, width = image.shape[:2]
        first = _in_box(self.pose, image, np.array([0.0, 0.0, width, height]), 1.0)
        seen = first[first[:, 2] >= _SEEN, :2]  # somewhere in the whole image; then in the box about it
        return (first if len(seen) < 3 else _in_box(self.pose, image, np.r_[seen.min(axis=0), seen.max(axis=0)]))[None]


def load_detector(model: str, people: str | None = None) -> OnnxDetector:
    """The network of `model`, names as in `io.model_file`; `people` is a YOLOX that finds people for RTMPose.

    Raises InputError where the extra is not installed, a file cannot be had, or is no such network.
    """
    pose, boxes = load_network(model), None if people is None else load_network(people)
    if pose.family == "YOLOX":
        raise InputError(f"model {model} finds people, but no joints; name it as people, and RTMPose as model.")
    if boxes is not None and (boxes.family != "YOLOX" or pose.family != "RTMPose"):
        raise InputError(f"models {model} and {people} are {pose.family} and {boxes.family}; people is for RTMPose.")
    return OnnxDetector(pose, boxes)


def load_network(name: str) -> Network:
    """A model file, tried on a grey picture. Raises InputError as `load_detector`."""
    try:
        import onnxruntime  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError("the detector needs ONNX Runtime; install it: pip install 'twistcap[detect]'.") from error
    data = model_bytes(name)
    options: Any = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.add_session_config_entry("session.load_model_format", "ONNX")  # its other format is not checked
    try:
        session: Any = onnxruntime.InferenceSession(data, options, providers=_PROVIDERS, enable_fallback=0)
        inputs: Any = session.get_inputs()
    except Exception as error:  # as above
        raise InputError(f"model {name} is no ONNX file that ONNX Runtime can load.") from error
    shape = inputs[0].shape if len(inputs) == 1 else []
    if len(shape) != 4 or shape[1] != 3 or not all(isinstance(n, int) and 8 <= n <= _LARGEST_SIDE for n in shape[2:]):
        raise InputError(f"model {name} must take one image (1, 3, H, W) of fixed size, as RTMPose and RTMO do.")
    if len(session.get_outputs()) < 2:
        raise InputError(f"model {name} has one output; RTMPose, RTMO and YOLOX with its labels have two.")
    network = Network(name, session, inputs[0].name, (shape[3], shape[2]))
    return replace(network, family=_family(network))


def _family(network: Network) -> Family:
    """By the shapes of the outputs."""
    width, height = network.size
    first, second = network.run(np.full((height, width, 3), _GREY, np.float32))
    a, b = first.shape, second.shape
    if len(a) == len(b) == 3 and a[:2] == b[:2] and a[0] == 1 and a[1] and a[2] * height == b[2] * width > 0:
        return _of_known_layout(network, "RTMPose", a[1])
    if len(a) == 3 and a[0] == 1 and a[2] == 5 and b[:2] == a[:2]:
        if len(b) == 4 and b[3] == 3:
            return _of_known_layout(network, "RTMO", b[2])
        if len(b) == 2:
            return "YOLOX"
    raise InputError(f"model {network.name} gives arrays of {a} and {b}; it is none of RTMPose, RTMO or YOLOX.")


def _of_known_layout(network: Network, family: Family, count: int) -> Family:
    if count not in _LAYOUTS:
        known = ", ".join(map(str, _LAYOUTS))
        raise InputError(f"model {network.name} gives {count} keypoints; layouts of {known} are known.")
    return family


def _in_box(network: Network, image: UInt8, box: Float, margin: float = _MARGIN) -> Float:
    """(K, 3) keypoints in a box x0, y0, x1, y1 that is widened to the input's shape."""
    (x0, y0, x1, y1), (width, height) = box, network.size
    zoom = min(width / max(x1 - x0, 1.0), height / max(y1 - y0, 1.0)) / margin
    corner = np.array([x0 + x1, y0 + y1]) / 2 - np.array([width, height]) / (2 * zoom)
    A = np.array([[zoom, 0, -zoom * corner[0]], [0, zoom, -zoom * corner[1]]])
    x, y = network.run((cv2.warpAffine(image, A, network.size).astype(np.float32) - _MEAN) / _STD)
    scores = np.minimum(x[0].max(axis=-1), y[0].max(axis=-1))
    pixels = np.stack([x[0].argmax(axis=-1), y[0].argmax(axis=-1)], axis=-1) * width / x.shape[-1]
    return np.column_stack([pixels / zoom + corner, np.clip(scores, 0.0, 1.0)])


def _everybody(network: Network, image: UInt8) -> Float:
    """(P, K, 3) keypoints of all people."""
    picture, zoom = _letter(network, image)
    boxes, keypoints = network.run(picture)
    people = np.array(keypoints[0][boxes[0][:, 4] >= _SEEN], float)
    people[..., :2] /= zoom
    people[..., 2] = np.clip(people[..., 2], 0.0, 1.0)
    return people


def _person_boxes(network: Network, image: UInt8) -> Float:
    """(P, 4) boxes x0, y0, x1, y1 of people, px of the image."""
    picture, zoom = _letter(network, image)
    boxes, labels = network.run(picture)
    return np.array(boxes[0][(boxes[0][:, 4] >= _SEEN) & (labels[0] == 0)][:, :4], float) / zoom


def _letter(network: Network, image: UInt8) -> tuple[AnyArray, float]:
    """The image in the upper left of the input, BGR as RTMO and YOLOX were trained, and its zoom."""
    (width, height), (h, w) = network.size, image.shape[:2]
    zoom = min(width / w, height / h)
    picture = np.full((height, width, 3), _GREY, np.float32)
    small = cv2.resize(image, (max(1, int(w * zoom)), max(1, int(h * zoom))))
    picture[: small.shape[0], : small.shape[1]] = small[..., ::-1]
    return picture, zoom


def detected_by_model(
    detector: OnnxDetector, images: Sequence[UInt8 | None], rig: Rig, first: bool = True
) -> Keypoints:
    """The keypoints of the person on whom the views agree, in images as recorded; None is a camera without one.

    Raises NoKeypoints where nobody is seen by two cameras, and for the `first` pose InputError as `check_arrangement`.
    """
    people = [np.zeros((0, 0, 3)) if image is None else detector.people(image) for image in images]
    empty = [name for name, found in zip(rig.names, people, strict=True) if not len(found)]
    if len(people) - len(empty) < 2:
        nobody = f"finds nobody in {', '.join(empty)}, and two views are needed"
        raise NoKeypoints(f"model {detector.pose.name} {nobody}; choose another frame, or click the first pose.")
    layout = _LAYOUTS[max(found.shape[1] for found in people)]
    people = [found if len(found) else np.zeros((0, len(LAYOUTS[layout]), 3)) for found in people]
    if first:
        check_arrangement(rig, people)
    choice, _ = same_person(rig, people)
    return of_people(people, choice, layout)
