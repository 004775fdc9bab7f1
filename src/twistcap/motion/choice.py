"""The predictors by name."""

from __future__ import annotations

from typing import Literal

from twistcap.body import Body
from twistcap.motion.autoregressive import AutoregressiveMotion
from twistcap.motion.following import FollowedMotion
from twistcap.motion.guarded import GuardedMotion
from twistcap.motion.library import MotionLibrary
from twistcap.motion.openloop import MotionPredictor
from twistcap.motion.paper import PaperMotion

MotionKind = Literal["followed", "scaled", "unscaled", "standard", "autoregressive", "guarded"]


def motion_predictor(kind: MotionKind, library: MotionLibrary, body: Body) -> MotionPredictor:
    """The default, "followed"; one of the paper's (`PaperMotion`); or a linear one (`AutoregressiveMotion`).

    "guarded" is the default where it proves itself, and inertia elsewhere (`GuardedMotion`).

    Raises:
        InputError: where body and library have no coordinate in common, or the library is too small.
    """
    if kind == "autoregressive":
        return AutoregressiveMotion(library, body)
    if kind == "guarded":
        return GuardedMotion(FollowedMotion(library, body))
    return FollowedMotion(library, body) if kind == "followed" else PaperMotion(library, body, kind)
