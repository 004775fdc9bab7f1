"""From which frame on a camera stands as it was found to stand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

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
    images = SequenceImages(mended, RefineConfig(), replace(tracker or Settings(), method="direct"), body)
    for _ in images.read(frames, [replace(e, left_out=others) for e in estimates]):
        pass
    posed = [Posed(body, e.pose) for e in estimates]
    after = images.agreeing(posed, [camera])[camera]
    return images.standing_at({camera: given[camera].T_cam_world}).agreeing(posed, [camera])[camera], after


def holds_from(before: Float, after: Float) -> int:
    """The first frame (0 … F) from which the mended camera agrees better with the images than the given one.

    Args:
        before, after: (F,) share of the contour points that agree in each frame, with the camera as given and as
            mended; NaN without an image.
    """
    gain = np.concatenate([[0.0], np.cumsum(np.nan_to_num(after - before))])
    return int(np.argmin(gain))
