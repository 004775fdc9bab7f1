"""A walk in three cameras of which some frames are faulty, and how it is tracked through them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from twistcap.body import Pose, Posed
from twistcap.build import build
from twistcap.estimate import Frame
from twistcap.predict import Prediction
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Tracker
from twistcap.track.align import FrameProblem
from twistcap.track.step import posed_problem

FAULT = range(16, 34)
"""Frames that a test may change."""


@cache
def walk() -> tuple[Capture, list[Frame]]:
    """The capture, and its frames."""
    scene = capture(StudioConfig(seed=2, views=3, frames=40, fps=30.0, size=(320, 240)))
    return scene, list(scene.frames())


@cache
def _before_the_fault() -> list[tuple[float, Tracker]]:
    """As `tracked_walk` gives it, of the frames that no test changes. A state never changes; see `tests/track`."""
    scene, frames = walk()
    model, out = build(scene.body, scene.rig), list[tuple[float, Tracker]]()
    state = model.start(scene.first_pose)
    for k, frame in enumerate(frames[: FAULT[0]]):
        tracker = Tracker(model)
        tracker.state = state
        out.append((_off(tracker.step(frame).pose, k), tracker))
        state = tracker.state
    return out


def _off(pose: Pose, k: int) -> float:
    scene, _ = walk()
    return float(np.linalg.norm(Posed(scene.body, pose).landmarks - scene.landmarks[k], axis=1).max())


def tracked_walk(faulty: Callable[[Frame], Frame], first: Pose | None = None) -> Iterator[tuple[float, Tracker]]:
    """The greatest error of the landmarks (m) in each frame, and the tracker after it."""
    scene, frames = walk()
    tracker, begun = Tracker(build(scene.body, scene.rig)), [] if first else _before_the_fault()
    yield from begun
    if begun:
        tracker.state = begun[-1][1].state
    else:
        tracker.start(first or scene.first_pose)
    for k, frame in enumerate(frames[len(begun) :], len(begun)):
        yield _off(tracker.step(faulty(frame) if k in FAULT else frame).pose, k), tracker


def expecting(tracker: Tracker, frame: int, pose: Pose) -> FrameProblem:
    """A frame as a problem, where the body is expected at a pose."""
    scene, frames = walk()
    none = np.zeros((scene.body.dof,) * 2)
    return posed_problem(tracker.state, frames[frame], tracker.model, Prediction(pose, "hold", none, none))


def empty(frame: Frame) -> Frame:
    """The frame as if nobody were there."""
    rooms = [np.asarray(255 * room, np.uint8) for room in walk()[0].rooms]
    return replace(frame, images=tuple(rooms))
