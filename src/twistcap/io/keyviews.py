"""``KEYVIEWS.toml``: which pictures the body is to be built from.

calibration = "calibration.toml"     # cameras, as of a session
body_line = 1.0                      # optional: height above the floor, m, above which arm pits are looked for
[views.front]                        # and views.side, views.above, views.elbows
camera = "cam01"                     # as named in the calibration
image = "front.png"
background = "empty.png"             # the same camera without the person, or
# mask = "front_mask.png"            # white on the person; `twistcap body silhouettes` cuts it out of the image by hand
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from twistcap.acquire.silhouette import KeyView, difference_mask, one_person
from twistcap.arrays import Bool, UInt8
from twistcap.camera import Camera, Rectifier, Rig
from twistcap.doors.images import read_image
from twistcap.doors.strict import validated
from twistcap.doors.text import read_toml
from twistcap.errors import InputError, naming
from twistcap.io.calibration import read_rig
from twistcap.io.session_tables import Table


def _named(path: Path) -> Path:
    if "\0" in str(path):
        raise ValueError("it is no name of a file")
    return path


File = Annotated[Path, AfterValidator(_named)]


class ViewEntry(Table):
    """``[views.ROLE]``."""

    camera: str
    image: File | None = None
    background: File | None = None
    mask: File | None = None


class ViewEntries(Table):
    """``[views]``; which of them are needed is judged by what builds the body."""

    front: ViewEntry | None = None
    side: ViewEntry | None = None
    above: ViewEntry | None = None
    elbows: ViewEntry | None = None


class KeyViewsFile(Table):
    """The file; see the module's head."""

    calibration: File
    body_line: float | None = Field(default=None, gt=0)
    views: ViewEntries

    @property
    def entries(self) -> dict[str, ViewEntry]:
        """By role, those that there are."""
        return {role: entry for role, entry in self.views if entry is not None}


def read_key_views(path: Path | str) -> tuple[dict[str, KeyView], float | None]:
    """The key views by role, rectified, and the body line, m, if one is given. Paths are relative to the file. Raises
    InputError for a file, a picture or a camera that is missing or does not fit.
    """
    path = Path(path)
    file, rig = _opened(path)
    with naming(path):
        return {role: _view(role, e, rig, path.parent) for role, e in file.entries.items()}, file.body_line


def _opened(path: Path) -> tuple[KeyViewsFile, Rig]:
    file: KeyViewsFile = validated(KeyViewsFile, read_toml(path, "key views"), str(path))
    return file, read_rig(path.parent / file.calibration, key=f"calibration in {path}")


@dataclass(frozen=True)
class Uncut:
    """A key view's picture, to be cut out by hand."""

    image: UInt8  # (H, W, 3) RGB, as recorded
    target: Path  # file for its mask
    known: Bool | None  # (H, W) the silhouette that mask or background give, if there is one
    named: bool  # whether the file names the target as this view's mask


def read_uncut(path: Path | str) -> dict[str, Uncut]:
    """The pictures of the key views by role; only pictures and cameras must be there. Raises InputError for a file, a
    picture or a camera that is missing or does not fit, no picture at all, or a mask that would be written over another
    picture.
    """
    path = Path(path)
    file, rig = _opened(path)
    with naming(path):
        uncut = {role: _uncut(role, e, rig, path) for role, e in file.entries.items() if e.image is not None}
        if not uncut:
            raise InputError('no view names an `image`; give [views.front] image = "front.png" and so on.')
        _refuse_shared(uncut, file.entries, path)
    return uncut


def _refuse_shared(uncut: Mapping[str, Uncut], entries: Mapping[str, ViewEntry], path: Path) -> None:
    """A mask must not overwrite any other picture."""
    masks = {role: _target(role, e, path).resolve() for role, e in entries.items() if e.mask or role in uncut}
    pictures = [(path.parent / p).resolve() for e in entries.values() for p in (e.image, e.background) if p]
    for role, view in uncut.items():
        if [*pictures, *masks.values()].count(masks[role]) > 1:
            raise InputError(f"[views.{role}]: `mask` {view.target} is another picture too; name a file of its own.")


def _target(role: str, entry: ViewEntry, path: Path) -> Path:
    return path.parent / (entry.mask or f"{path.stem}_{role}_mask.png")


def _uncut(role: str, entry: ViewEntry, rig: Rig, path: Path) -> Uncut:
    camera, folder = _camera(role, entry, rig), path.parent
    assert entry.image is not None
    image = _picture(folder / entry.image, camera)
    target = _target(role, entry, path)
    known: Bool | None = None
    if target.is_file():
        known = _picture(target, camera).max(axis=2) > 127
    elif entry.background is not None:
        known = one_person(difference_mask(image, _picture(folder / entry.background, camera)))
    return Uncut(np.ascontiguousarray(image[..., ::-1]), target, known, entry.mask is not None)


def _view(role: str, entry: ViewEntry, rig: Rig, folder: Path) -> KeyView:
    camera = _camera(role, entry, rig)
    if entry.mask is not None:
        silhouette = _picture(folder / entry.mask, camera).max(axis=2) > 127
    elif entry.image is not None and entry.background is not None:
        silhouette = difference_mask(*(_picture(folder / path, camera) for path in (entry.image, entry.background)))
    else:
        hint = "twistcap body silhouettes makes one by hand"
        raise InputError(f"[views.{role}]: give `image` and `background`, or a `mask` ({hint}).")
    mask = Rectifier(camera)(silhouette.astype("uint8"), nearest=True) > 0
    return KeyView(role, camera.pinhole(), one_person(mask))


def _camera(role: str, entry: ViewEntry, rig: Rig) -> Camera:
    if entry.camera not in rig.names:
        raise InputError(f"[views.{role}]: camera {entry.camera!r} is not in the calibration ({', '.join(rig.names)}).")
    return rig[rig.names.index(entry.camera)]


def _picture(path: Path, camera: Camera) -> UInt8:
    image = read_image(path, "picture")
    if image.shape[1::-1] != camera.size:
        its, theirs = (f"{width}×{height}" for width, height in (image.shape[1::-1], camera.size))
        mend = "use pictures of the calibrated size"
        raise InputError(f"{path} is {its} pixels, but camera {camera.name!r} has {theirs}; {mend}.")
    return image
