"""From which frame on a camera stands as it was found to stand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import tee

import numpy as np

from twistcap.adjust.refine.measure import SequenceImages
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.arrays import Float
from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.estimate import Estimate, Frame
from twistcap.settings import Settings


def agreement_at(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], camera: int, place: Float,
    tracker: Settings | None = None,
) -> tuple[Float, Float]:  # fmt: skip
    """(F,) share of a camera's contour points that agree in each frame, as calibrated, and at a place `T_cam_world`.

    NaN without an image. Raises InputError where the frames are not those of the estimates.
    """
    given, others = rig.pinhole(), tuple(c for c in range(len(rig)) if c != camera)
    there = replace(given[camera], T_cam_world=place)
    mended = Rig((*given.cameras[:camera], there, *given.cameras[camera + 1 :]))
    settings = replace(tracker or Settings(), method="direct")
    alone = [replace(e, left_out=others, bumps=None) for e in estimates]
    both = [SequenceImages(cameras, RefineConfig(), settings, body) for cameras in (given, mended)]
    for _ in zip(*(images.read(own, alone) for images, own in zip(both, tee(frames), strict=True)), strict=True):
        pass  # each keeps what is about the body as it sees it: that may be far apart
    posed = [Posed(body, e.pose) for e in estimates]
    before, after = (images.agreeing(posed, [camera])[camera] for images in both)
    return before, after


def holds_from(before: Float, after: Float) -> int:
    """The first frame (0 … F) from which the mended camera agrees better with the images than the given one.

    Args:
        before, after: (F,) share of the contour points that agree in each frame, with the camera as given and as
            mended; NaN without an image of the body.
    """
    gain = np.nan_to_num(zero_beside(before, after) - zero_beside(after, before))
    return int(np.argmax(np.concatenate([[0.0], np.cumsum(gain)])))


def zero_beside(share: Float, other: Float) -> Float:
    """(F,) shares that agree; 0 where the camera, standing so, sees no body (NaN), but does where it stands otherwise.

    A body outside its image is as wrong as can be. Without an image both are NaN, and stay so.
    """
    return np.where(np.isnan(share) & ~np.isnan(other), 0.0, share)
