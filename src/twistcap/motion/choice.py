"""The predictors by name."""

from __future__ import annotations

from typing import Literal

from twistcap.body import Body
from twistcap.motion.following import FollowedMotion
from twistcap.motion.guarded import GuardedMotion
from twistcap.motion.library import MotionLibrary
from twistcap.motion.openloop import MotionPredictor
from twistcap.motion.paper import PaperMotion

MotionKind = Literal["followed", "scaled", "unscaled", "standard", "guarded"]


def motion_predictor(kind: MotionKind, library: MotionLibrary, body: Body) -> MotionPredictor:
    """A predictor: "followed", the default (`FollowedMotion`), "guarded" (`GuardedMotion`), or a `PaperMotion`.

    Raises:
        InputError: where body and library have no coordinate in common, or the library is too small.
    """
    if kind == "guarded":
        return GuardedMotion(FollowedMotion(library, body))
    return FollowedMotion(library, body) if kind == "followed" else PaperMotion(library, body, kind)
