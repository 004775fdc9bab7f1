"""A walk that is tracked rightly, and the same as if an arm had been elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import named_limbs
from twistcap.build import build
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.estimate import Estimate, Frame
from twistcap.hindsight import Passed
from twistcap.predict import Past, Prediction
from twistcap.search.memory import LostMemory
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, State, Tracker

WRONG = range(12, 20)  # frames in which the arm is taken to be elsewhere
ARM = "arm_r"


@dataclass(frozen=True)
class Misled:
    """A predictor that is sure, in some frames, that the right arm is elsewhere; then it knows better, or keeps still.

    Attributes:
        frames: those.
        poses: the true poses.
        back: whether it knows better in the next frame.
        name: that of a predictor by which nothing is tracked again.
    """

    frames: range
    body: Body
    poses: Sequence[Pose]
    back: bool
    name: str = "motion"

    def start(self, body: Body, rig: Rig) -> None:
        """Nothing is remembered."""

    def predict(self, memory: None, past: Past, frame: Frame) -> tuple[Prediction | None, None]:
        true, sure = self.poses[frame.index], np.eye(self.body.dof)
        if frame.index in self.frames:
            return Prediction(bent(self.body, true), "misled", 1e-4 * sure, 1e8 * sure), None
        back = self.back and frame.index == self.frames.stop
        return Prediction(true, "misled", 1e-4 * sure, 1e2 * sure) if back else None, None

    def learn(self, memory: None, fit: Fit, past: Past, frame: Frame) -> None:
        """Nothing."""


@cache
def walk() -> tuple[Capture, Model, list[Passed], State, State]:
    """A walk that is tracked rightly, and the states before and after its last frame."""
    scene = capture(StudioConfig(seed=3, views=3, frames=21))
    model, passed, before = build(scene.body, scene.rig), list[Passed](), None
    tracker = Tracker(model)
    tracker.start(scene.first_pose)
    for frame in scene.frames():
        before = tracker.state
        passed.append(Passed(frame, tracker.step(frame)))
    assert before is not None
    return scene, model, passed, before, tracker.state


def bent(body: Body, pose: Pose) -> Pose:
    """With the right arm 70° elsewhere."""
    own = body.chain[named_limbs(body)[ARM]].any(axis=0) & ~body.chain[named_limbs(body)["trunk"]].any(axis=0)
    swing = np.zeros(len(pose.q))
    swing[np.flatnonzero(own)[:2]] = np.deg2rad(70.0)
    return Pose(pose.root, np.clip(pose.q + swing, *body.limits.T))


def with_poses(state: State, passed: list[Passed], last: Pose) -> State:
    """The state as if these had been the poses; that before the last is as a search leaves it, at rest."""
    poses = [*(p.estimate.pose for p in passed[:-1]), last, last]
    moments = tuple(replace(m, pose=pose) for m, pose in zip(state.past.moments, poses, strict=True))
    return state.with_past(replace(state.past, moments=moments))


def with_found(state: State, limb: str | None) -> State:
    """The state as if a search had just found a limb; None: the whole body."""
    ((name, memory),) = state.searches.items()
    assert isinstance(memory, LostMemory)
    own = named_limbs(walk()[0].body).get(limb or "", np.ones(memory.groups.shape[1], np.bool_))
    found = np.array([1.0 if (group & own).any() else 0.0 for group in memory.groups])
    return replace(state, searches={name: replace(memory, found=found)})


def errors(scene: Capture, estimates: list[Estimate]) -> Float:
    marks = [scene.body.landmarks.index(f"{joint}_r") for joint in ("elbow", "wrist")]
    found = np.array([Posed(scene.body, e.pose).landmarks[marks] for e in estimates])
    true = np.array([Posed(scene.true_body, scene.true_poses[e.index]).landmarks[marks] for e in estimates])
    return 1000.0 * np.linalg.norm(found - true, axis=2).max(axis=1)
