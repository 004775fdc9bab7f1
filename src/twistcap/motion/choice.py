"""The predictors by name."""

from __future__ import annotations

from typing import Literal

from twistcap.body import Body
from twistcap.motion.autoregressive import AutoregressiveMotion
from twistcap.motion.following import FollowedMotion
from twistcap.motion.library import MotionLibrary
from twistcap.motion.openloop import OpenLoop
from twistcap.motion.paper import PaperMotion

MotionKind = Literal["followed", "scaled", "unscaled", "standard", "autoregressive"]


def motion_predictor(kind: MotionKind, library: MotionLibrary, body: Body) -> OpenLoop:
    """The default, "followed"; one of the paper's (`PaperMotion`); or a linear one (`AutoregressiveMotion`).

    Raises:
        InputError: where body and library have no coordinate in common, or the library is too small.
    """
    if kind == "autoregressive":
        return AutoregressiveMotion(library, body)
    return FollowedMotion(library, body) if kind == "followed" else PaperMotion(library, body, kind)
