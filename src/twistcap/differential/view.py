"""What the differential tracker follows: the views' own motions beside the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap._typing import AnyArray, Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera.scaled import ROOT, ScaledView

__all__ = ["ROOT", "ScaledView", "State"]


@dataclass(frozen=True)
class State:
    """A body in all views: what the differential tracker follows.

    Attributes:
        views: one per camera.
        q: (J,) joint coordinates, rad, shared by all views.
    """

    views: tuple[ScaledView, ...]
    q: Float

    def retract(self, delta: Float) -> State:
        """After a step (6 V + J,): the views' own motions one after the other, then the joints'."""
        joints = ROOT * len(self.views)
        views = tuple(view.retract(delta[ROOT * v : ROOT * v + ROOT]) for v, view in enumerate(self.views))
        return State(views, self.q + delta[joints:])

    def sized(self, images: Sequence[AnyArray]) -> State:
        """The same state before such images (H, W[, 3])."""
        pairs = zip(self.views, images, strict=True)
        return State(tuple(replace(view, size=(im.shape[1], im.shape[0])) for view, im in pairs), self.q)

    def minus(self, other: State) -> Float:
        """The step (6 V + J,) that `retract` needs to come from `other` to this state."""
        views = [view.minus(before) for view, before in zip(self.views, other.views, strict=True)]
        return np.concatenate([*views, self.q - other.q])

    def posed(self, body: Body) -> Posed:
        """The body in its own frame."""
        return Posed(body, Pose(np.eye(4), self.q))
