"""Which of several formats keypoints have, where their number fits all: the one in which they are those of a body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from twistcap.adjust.first_pose import fit_keypoints
from twistcap.body.humanoid import humanoid
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.io.recording import keypoints_of
from twistcap.io.session_tables import KeypointSet

_GOOD, _CLEAR = 0.03, 0.5  # residual as a fraction of the person's height in the image, and of the next best format's


def fitting_format(folders: Mapping[str, Path], rig: Rig, formats: Sequence[str]) -> tuple[str | None, str]:
    """The format in which the first frame's keypoints fit a body, None where none does clearly; and a sentence.

    `folders` hold the JSON files of each camera; z of the rig is up.
    """
    off = {name: _off(folders, rig, name) for name in formats}
    best, second = sorted(off, key=lambda name: off[name])[:2]
    fact = f"The number of keypoints fits {' and '.join(formats)}"
    if not np.isfinite(off[best]):
        return None, f"{fact}, and no body can be fitted to the first frame"
    found = f"as {best} they are {100 * off[best]:.1f} % of the person's height off a body, as {second} "
    found += f"{100 * off[second]:.1f} %" if np.isfinite(off[second]) else "none fits"
    if off[best] < min(_GOOD, _CLEAR * off[second]):
        return best, f"{fact}; {best} is taken: {found}."
    return None, f"{fact}; none is clear: {found}"


def _off(folders: Mapping[str, Path], rig: Rig, name: str) -> float:
    """Median distance of the keypoints to a body, as a fraction of the person's height in the image."""
    table = KeypointSet.model_validate({"format": name, "folders": {k: str(path) for k, path in folders.items()}})
    try:
        (keypoints,) = keypoints_of(table, rig)
        residual = fit_keypoints(humanoid(), rig, keypoints).residual_px
    except InputError:
        return float("inf")
    heights = [np.ptp(y[np.isfinite(y)]) for y in keypoints.pixels[..., 1] if np.isfinite(y).any()]
    return float(np.nanmedian(residual) / max(np.median(heights), 1.0))
