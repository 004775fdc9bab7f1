"""Keypoint detectors by name: model files of pose networks, and what installed packages offer by entry point.

A package offers one in its ``pyproject.toml``::

    [project.entry-points."twistcap.detectors"]
    mine = "my_package:detect"

where ``detect(images, rig)`` takes one RGB uint8 image (H, W, 3) per camera, as recorded (with the lens's distortion),
and the `Rig`, and returns `Keypoints` in those very pixels, in landmark names of the body (``knee_r``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from twistcap.arrays import UInt8
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.keypoints import NoKeypoints
from twistcap.io.model_file import check_there, is_model_file
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


def check_detector(name: str, people: str | None) -> None:
    """Raises InputError where a model file does not exist, or a detector is not installed."""
    for model in (name, people or ""):
        check_there(model)
    if not is_model_file(name):
        detector(name)


def detected(
    name: str, images: Sequence[UInt8 | None], rig: Rig, people: str | None = None, first: bool = True
) -> Keypoints:
    """What a detector finds in one image of each camera; None is a camera without one, for model files alone.

    `name` is a model file, as in `io.model_file`, or an installed detector; `people` a model file that finds people.
    With a model file, cameras that are exchanged are refused where the `first` pose is to be found.
    Raises InputError as `detector` and `load_detector`, and for an answer that is no `Keypoints` of this rig;
    NoKeypoints where nobody is found in two views, or an image is missing.
    """
    if is_model_file(name):
        return detected_by_model(load_detector(name, people), images, rig, first)
    if people is not None:
        raise InputError(f"detector {name!r} is no model file, so it takes no people; remove that key.")
    offered_by = detector(name)
    given = [image for image in images if image is not None]
    if len(given) < len(images):
        raise NoKeypoints(f"a camera has no image of this frame, and detector {name!r} needs all; take another frame.")
    try:
        offered = offered_by(given, rig)
    except InputError:
        raise
    except Exception as error:  # whatever a stranger's code raises
        raise InputError(f"detector {name!r} failed: {type(error).__name__}: {error}.") from error
    return _checked(offered, name, rig)


def _checked(offered: Any, name: str, rig: Rig) -> Keypoints:
    """The answer of a detector that a package offers, its shapes and numbers checked."""
    if not isinstance(offered, Keypoints):
        raise InputError(f"detector {name!r} returned {type(offered).__name__}; it must return Keypoints.")
    pixels, weights = np.asarray(offered.pixels, float), np.asarray(offered.confidence, float)
    C, L = len(rig), len(offered.names)
    if pixels.shape != (C, L, 2) or weights.shape != (C, L):
        raise InputError(f"detector {name!r} returned pixels {pixels.shape}; {C} cameras, {L} names need {(C, L, 2)}.")
    if not np.all(np.isfinite(weights)) or not np.all(np.isfinite(pixels[weights > 0])):
        raise InputError(f"detector {name!r} returned a number that is not finite; give it confidence 0.")
    return Keypoints(offered.names, pixels, weights)
