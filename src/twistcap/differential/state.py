"""What the differential tracker follows, the views' own motions beside the joints, and what it goes on from.

`state_of` and `world_pose` lead from calibrated cameras to scaled views and back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap.arrays import AnyArray, Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera
from twistcap.camera.scaled import ROOT, ScaledView
from twistcap.cues.light import Light
from twistcap.cues.memory import Memory

_DEPTH = 1e-3
"""Information of a view along its ray against across it: scale tells depth badly, so that other views decide it."""


@dataclass(frozen=True)
class State:
    """A body in all views, one per camera, which share the joint coordinates q (J,) rad: what is followed."""

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

    These are the state in the last frame (before the first, in that), its last step (6 V + J,), and the memories of the
    V views, under even light and None before a view's first image, with the light before each camera.
    """

    state: State
    velocity: Float
    memories: tuple[Memory | None, ...]
    lights: tuple[Light, ...]

    @staticmethod
    def of(state: State) -> Track:
        """Before the first frame, whose state is known."""
        views = len(state.views)
        return Track(state, np.zeros(ROOT * views + len(state.q)), (None,) * views, (Light.even(),) * views)

    @property
    def started(self) -> bool:
        """Whether a view has been remembered."""
        return any(memory is not None for memory in self.memories)


def state_of(pose: Pose, cameras: Iterable[Camera], perspective: bool = False) -> State:
    """The state of a body at a pose before calibrated cameras, distortion left out. With `perspective` the views are
    those of the pinholes, else scaled orthography."""
    return State(tuple(ScaledView.of(camera, pose.root, perspective) for camera in cameras), pose.q)


def world_pose(state: State, cameras: Sequence[Camera]) -> Pose:
    """The pose in the world that all views together tell; one view's depth follows from its scale.

    Each view has turns of its own in the tracker; the mean of their rotations is taken (in the chordal sense), and the
    point that is nearest to all of their rays.
    """
    roots = [view.root(camera) for view, camera in zip(state.views, cameras, strict=True)]
    U, _, Vt = np.linalg.svd(np.sum([root[:3, :3] for root in roots], axis=0))
    rotation = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    A, b = np.zeros((3, 3)), np.zeros(3)
    for root, camera in zip(roots, cameras, strict=True):
        ray = root[:3, 3] - camera.centre
        ray /= np.linalg.norm(ray)
        weight = np.eye(3) - (1.0 - _DEPTH) * np.outer(ray, ray)
        A, b = A + weight, b + weight @ root[:3, 3]
    return Pose(se3.transform(rotation, np.asarray(np.linalg.solve(A, b), np.float64)), state.q)
