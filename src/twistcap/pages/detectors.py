"""Keypoint detectors of the user, offered by entry point; twistcap has none.

A package offers one in its ``pyproject.toml``::

    [project.entry-points."twistcap.detectors"]
    mine = "my_package:detect"

where ``detect(images, rig)`` takes one RGB uint8 image (H, W, 3) per camera, as recorded (with the lens's distortion),
and the `Rig`, and returns `Keypoints` in those very pixels, in landmark names of the body (``knee_r``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points

import numpy as np

from twistcap.arrays import UInt8
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.onnx_detector import detected_by_model, load_detector

GROUP = "twistcap.detectors"
Detector = Callable[[Sequence[UInt8], Rig], Keypoints]


def detector(name: str) -> Detector:
    """The detector of a name. Raises InputError where nothing of that name is installed, or it cannot be imported."""
    offered = entry_points(group=GROUP)
    if name not in offered.names:
        installed = ", ".join(sorted(offered.names)) or "none"
        raise InputError(f"detector {name!r} is not installed (installed: {installed}); see docs/how-to/first-pose.md.")
    try:
        return next(iter(offered.select(name=name))).load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"detector {name!r} cannot be loaded: {error}.") from error


def detected(name: str, images: Sequence[UInt8], rig: Rig) -> Keypoints:
    """What a detector finds, its shapes and numbers checked. Raises InputError as `detector`; for an answer that is no
    `Keypoints` of this rig.
    """
    if name.lower().endswith(".onnx"):
        return detected_by_model(load_detector(name), images, rig)
    offered = detector(name)(images, rig)
    if not isinstance(offered, Keypoints):
        raise InputError(f"detector {name!r} returned {type(offered).__name__}; it must return Keypoints.")
    pixels, weights = np.asarray(offered.pixels, float), np.asarray(offered.confidence, float)
    C, L = len(rig), len(offered.names)
    if pixels.shape != (C, L, 2) or weights.shape != (C, L):
        raise InputError(f"detector {name!r} returned pixels {pixels.shape}; {C} cameras, {L} names need {(C, L, 2)}.")
    if not np.all(np.isfinite(weights)) or not np.all(np.isfinite(pixels[weights > 0])):
        raise InputError(f"detector {name!r} returned a number that is not finite; give it confidence 0.")
    return Keypoints(offered.names, pixels, weights)
