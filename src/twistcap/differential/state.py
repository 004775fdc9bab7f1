"""What the differential tracker follows, the views' own motions beside the joints, and what it goes on from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera.scaled import ROOT, ScaledView
from twistcap.cues.memory import Memory


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

    def sized(self, images: Sequence[AnyArray | None]) -> State:
        """The same state before such images (H, W[, 3])."""
        pairs = zip(self.views, images, strict=True)
        views = (view if im is None else replace(view, size=(im.shape[1], im.shape[0])) for view, im in pairs)
        return State(tuple(views), self.q)

    def minus(self, other: State) -> Float:
        """The step (6 V + J,) that `retract` needs to come from `other` to this state."""
        views = [view.minus(before) for view, before in zip(self.views, other.views, strict=True)]
        return np.concatenate([*views, self.q - other.q])

    def posed(self, body: Body) -> Posed:
        """The body in its own frame."""
        return Posed(body, Pose(np.eye(4), self.q))


@dataclass(frozen=True)
class Track:
    """A track between two frames: everything that the next one depends on.

    Attributes:
        state: in the last frame; before the first, where the body is in that.
        velocity: (6 V + J,) the last step of the state.
        memories: of the V views; None before a view's first image.
    """

    state: State
    velocity: Float
    memories: tuple[Memory | None, ...]

    @staticmethod
    def of(state: State) -> Track:
        """Before the first frame, whose state is known."""
        views = len(state.views)
        return Track(state, np.zeros(ROOT * views + len(state.q)), (None,) * views)

    @property
    def started(self) -> bool:
        """Whether a view has been remembered."""
        return any(memory is not None for memory in self.memories)
