"""2D keypoints by a pose network in an ONNX file, on this machine (extra ``detect``: ONNX Runtime).

Two families, told apart by their outputs: RTMPose (Jiang et al. 2023, arXiv:2303.07399), top-down, with SimCC outputs
x (1, K, W s) and y (1, K, H s); and RTMO (Lu et al. 2024, arXiv:2312.07526), one stage, with boxes (1, N, 5) and
keypoints (1, N, K, 3). The number of keypoints says their layout.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twistcap.arrays import Float, UInt8
from twistcap.camera import Rig
from twistcap.doors.text import read_bytes
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.keypoints import LAYOUTS, of_people
from twistcap.io.people import same_person

_LARGEST = 1 << 30  # bytes of a model
_LAYOUTS = {17: "coco_17", 26: "halpe_26", 133: "coco_133"}
_MEAN, _STD = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])  # of RTMPose's training, RGB
_GREY, _MARGIN = 114, 1.25  # beside the image of RTMO; of the box about a person, as RTMPose was trained
_SEEN = 0.3  # score of a keypoint, and of a person, that counts


@dataclass(frozen=True)
class OnnxDetector:
    """A model that is loaded."""

    path: Path
    session: Any  # onnxruntime.InferenceSession
    size: tuple[int, int]  # (width, height) px of its input

    def people(self, image: UInt8) -> Float:
        """(P, K, 3) x, y, px of the image (H, W, 3) RGB, and score; score 0 where a keypoint is not seen."""
        found = self._simcc(image) if self._is_simcc else self._one_stage(image)
        found[found[..., 2] < _SEEN] = 0.0
        return found[(found[..., 2] > 0).sum(axis=1) >= 3]

    @property
    def _is_simcc(self) -> bool:
        return len(self.session.get_outputs()[0].shape) == 3 and self.session.get_outputs()[1].shape[-1] != 3

    def _simcc(self, image: UInt8) -> Float:
        """One person: in the whole image, then in the box about what was found there."""
        height, width = image.shape[:2]
        first = self._in_box(image, np.array([0.0, 0.0, width, height]), 1.0)
        seen = first[first[:, 2] >= _SEEN, :2]
        if len(seen) < 3:
            return first[None]
        return self._in_box(image, np.r_[seen.min(axis=0), seen.max(axis=0)], _MARGIN)[None]

    def _in_box(self, image: UInt8, box: Float, margin: float) -> Float:
        """(K, 3) keypoints in a box x0, y0, x1, y1 that is widened to the input's shape."""
        (x0, y0, x1, y1), (width, height) = box, self.size
        zoom = min(width / max(x1 - x0, 1.0), height / max(y1 - y0, 1.0)) / margin
        corner = np.array([x0 + x1, y0 + y1]) / 2 - np.array([width, height]) / (2 * zoom)
        A = np.array([[zoom, 0, -zoom * corner[0]], [0, zoom, -zoom * corner[1]]])
        crop = (cv2.warpAffine(image, A, self.size).astype(np.float32) - _MEAN) / _STD
        x, y = self._run(crop)
        split = x.shape[-1] / width
        scores = np.minimum(x[0].max(axis=-1), y[0].max(axis=-1))
        pixels = np.stack([x[0].argmax(axis=-1), y[0].argmax(axis=-1)], axis=-1) / split
        return np.column_stack([pixels / zoom + corner, np.clip(scores, 0.0, 1.0)])

    def _one_stage(self, image: UInt8) -> Float:
        """Everybody; the image lies in the upper left of the input."""
        (width, height), (h, w) = self.size, image.shape[:2]
        zoom = min(width / w, height / h)
        padded = np.full((height, width, 3), _GREY, np.float32)
        small = cv2.resize(image, (max(1, round(w * zoom)), max(1, round(h * zoom))))
        padded[: small.shape[0], : small.shape[1]] = small[..., ::-1]  # trained on BGR
        boxes, keypoints = self._run(padded)
        people = np.array(keypoints[0][boxes[0][:, 4] >= _SEEN], float)
        people[..., :2] /= zoom
        people[..., 2] = np.clip(people[..., 2], 0.0, 1.0)
        return people

    def _run(self, picture: Any) -> tuple[Any, Any]:
        batch = np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)
        first, second = self.session.run(None, {self.session.get_inputs()[0].name: batch})[:2]
        if not np.all(np.isfinite(first)) or not np.all(np.isfinite(second)):
            raise InputError(f"model {self.path} gives numbers that are not finite; take another file.")
        return first, second


def load_detector(path: Path | str, sha256: str | None = None) -> OnnxDetector:
    """A model file. Raises InputError where the extra is not installed, the file is missing, is no such model, or has
    another checksum than it should.
    """
    path = Path(path)
    data = read_bytes(path, _LARGEST)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256.lower():
        raise InputError(f"model {path} has another checksum than the session says; get the file again.")
    try:
        import onnxruntime  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError("the detector needs ONNX Runtime; install it: pip install 'twistcap[detect]'.") from error
    try:
        session: Any = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    except Exception as error:  # its own kinds of exceptions, for whatever is wrong with a file
        raise InputError(f"model {path} is no ONNX file that ONNX Runtime can load.") from error
    inputs, outputs = session.get_inputs(), session.get_outputs()
    shape = inputs[0].shape if len(inputs) == 1 else []
    if len(shape) != 4 or shape[1] != 3 or not all(isinstance(n, int) for n in shape[2:]) or len(outputs) < 2:
        raise InputError(
            f"model {path} is neither RTMPose nor RTMO: it must take one image (1, 3, H, W) of fixed size."
        )
    return OnnxDetector(path, session, (shape[3], shape[2]))


def detected_by_model(detector: OnnxDetector, images: Sequence[UInt8 | None], rig: Rig) -> Keypoints:
    """The keypoints of the person on whom the views agree, in images as recorded; None is a camera without one.

    Raises InputError where nobody is seen by two cameras, or the layout of the keypoints is not known.
    """
    people = [np.zeros((0, 0, 3)) if image is None else detector.people(image) for image in images]
    counts = {p.shape[1] for p in people if len(p)}
    if sum(len(p) > 0 for p in people) < 2:
        raise InputError(f"model {detector.path} finds a person in fewer than two views; click the first pose instead.")
    if len(counts) != 1 or not counts <= set(_LAYOUTS):
        known = ", ".join(map(str, _LAYOUTS))
        raise InputError(f"model {detector.path} gives {min(counts)} keypoints; layouts of {known} are known.")
    layout = _LAYOUTS[counts.pop()]
    people = [p if len(p) else np.zeros((0, len(LAYOUTS[layout]), 3)) for p in people]
    choice, _ = same_person(rig, people)
    return of_people(people, choice, layout)
