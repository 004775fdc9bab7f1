"""``KEYVIEWS.toml``: which pictures the body is to be built from.

calibration = "calibration.toml"     # cameras, as of a session
body_line = 1.0                      # optional: height above the floor, m, above which arm pits are looked for
[views.front]                        # and views.side, views.above, views.elbows
camera = "cam01"                     # as named in the calibration
image = "front.png"
background = "empty.png"             # the same camera without the person, or
# mask = "front_mask.png"            # white on the person; then no image is needed
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twistcap._typing import Bool, UInt8
from twistcap.camera import Camera, Rectifier, Rig
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig
from twistcap.io.strict import validated
from twistcap.keyviews.silhouette import KeyView, difference_mask, one_person


class ViewEntry(BaseModel):
    """``[views.ROLE]``."""

    model_config = ConfigDict(extra="forbid")
    camera: str
    image: Path | None = None
    background: Path | None = None
    mask: Path | None = None


class ViewEntries(BaseModel):
    """``[views]``; which of them are needed is judged by what builds the body."""

    model_config = ConfigDict(extra="forbid")
    front: ViewEntry | None = None
    side: ViewEntry | None = None
    above: ViewEntry | None = None
    elbows: ViewEntry | None = None


class KeyViewsFile(BaseModel):
    """The file; see the module's head."""

    model_config = ConfigDict(extra="forbid")
    calibration: Path
    body_line: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    views: ViewEntries


def read_key_views(path: Path | str) -> tuple[dict[str, KeyView], float | None]:
    """The key views by role, rectified, and the body line, m, if one is given. Paths are relative to the file.

    Raises:
        InputError: for a file, a picture or a camera that is missing or does not fit.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file ({error}).") from error
    file: KeyViewsFile = validated(KeyViewsFile, data, str(path), {})
    rig = read_rig(path.parent / file.calibration)
    entries = {role: getattr(file.views, role) for role in ViewEntries.model_fields}
    views = {role: _view(role, e, rig, path.parent) for role, e in entries.items() if e is not None}
    return views, file.body_line


def _view(role: str, entry: ViewEntry, rig: Rig, folder: Path) -> KeyView:
    if entry.camera not in rig.names:
        raise InputError(f"[views.{role}]: camera {entry.camera!r} is not in the calibration ({', '.join(rig.names)}).")
    camera = rig[rig.names.index(entry.camera)]
    rectify = Rectifier(camera)
    mask = rectify(_silhouette(role, entry, camera, folder).astype("uint8"), nearest=True) > 0
    return KeyView(role, camera.pinhole(), one_person(mask))


def _silhouette(role: str, entry: ViewEntry, camera: Camera, folder: Path) -> Bool:
    if entry.mask is not None:
        return _picture(folder / entry.mask, camera).max(axis=2) > 127
    if entry.image is None or entry.background is None:
        raise InputError(f"[views.{role}]: give `image` and `background`, or a `mask`.")
    return difference_mask(_picture(folder / entry.image, camera), _picture(folder / entry.background, camera))


def _picture(path: Path, camera: Camera) -> UInt8:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise InputError(f"{path}: the picture cannot be read.")
    if (image.shape[1], image.shape[0]) != camera.size:
        raise InputError(
            f"{path} is {image.shape[1]}×{image.shape[0]} pixels, but camera {camera.name!r} has"
            f" {camera.size[0]}×{camera.size[1]}; use pictures of the calibrated size."
        )
    return np.asarray(image, dtype=np.uint8)
