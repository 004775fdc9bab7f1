"""A camera that shows another moment than the others is left out, and taken back when it is in step again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from twistcap.build import build
from twistcap.estimate import Estimate, Frame
from twistcap.search.contradiction import ContradictionRule
from twistcap.search.lost import LostBody
from twistcap.search.memory import LostMemory
from twistcap.search.out_of_step import OutOfStep, OutOfStepRule
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, State, Tracker

BEFORE, UNTIL, FRAMES = 14, 34, 60
ODD = 1  # the camera that is out of step


@cache
def _scene() -> Capture:
    return capture(StudioConfig(seed=2, views=4, frames=FRAMES + 3, fps=60.0, size=(320, 240)))


@cache
def _frames() -> list[Frame]:
    return list(_scene().frames())


@cache
def _model(rule: OutOfStepRule = OutOfStepRule()) -> Model:  # noqa: B008
    """Cameras are left out for being out of step alone."""
    scene = _scene()
    model = build(scene.body, scene.rig)
    alone = ContradictionRule(suspect=0.0, steps=rule)
    searches = (replace(s, contradiction=alone) if isinstance(s, LostBody) else s for s in model.searches)
    return replace(model, searches=tuple(searches))


@cache
def _before() -> State:
    tracker = Tracker(_model())
    tracker.start(_scene().first_pose)
    for frame in _frames()[:BEFORE]:
        tracker.step(frame)
    return tracker.state


def _shifted(by: int, cameras: Sequence[int] = (ODD,)) -> list[Frame]:
    """The frames from there on; cameras show the picture `by` frames later for a while, or earlier."""
    out = list[Frame]()
    for k in range(BEFORE, FRAMES):
        now = _frames()[k].images
        other = _frames()[k + by if k < UNTIL else k].images
        out.append(replace(_frames()[k], images=tuple(other[c] if c in cameras else now[c] for c in range(4))))
    return out


def _tracked(frames: Sequence[Frame], rule: OutOfStepRule = OutOfStepRule()) -> list[tuple[Estimate, OutOfStep]]:  # noqa: B008
    tracker, out = Tracker(_model(rule)), list[tuple[Estimate, OutOfStep]]()
    tracker.state = _before()
    for frame in frames:
        estimate = tracker.step(frame)
        memory = tracker.state.searches["lost body"]
        assert isinstance(memory, LostMemory) and memory.suspicion.steps is not None
        out.append((estimate, memory.suspicion.steps))
    return out


@pytest.mark.parametrize("by", [-2, -1, 1, 2])
def test_a_camera_out_of_step_is_left_out_and_comes_back(by: int) -> None:
    track = _tracked(_shifted(by))
    out = [e.left_out for e, _ in track]
    first = out.index((ODD,))
    assert first < 12 and set(out) == {(), (ODD,)}
    assert all(cameras == (ODD,) for cameras in out[first : UNTIL - BEFORE]) and out[-1] == ()
    score = track[first][1]
    assert (score.late if by < 0 else score.early)[ODD] > (score.early if by < 0 else score.late)[ODD] == 0.0


@pytest.mark.parametrize("by", [-3, 3])
def test_a_camera_that_seemed_out_of_step_comes_back_when_another_one_is_found(by: int) -> None:
    """The one opposite is taken for it at first."""
    out = [e.left_out for e, _ in _tracked(_shifted(by))]
    both = next(k for k, cameras in enumerate(out) if len(cameras) == 2)
    assert ODD in out[both] and both < 8
    assert all(cameras == (ODD,) for cameras in out[both + 8 : UNTIL - BEFORE]) and out[-1] == ()


def test_cameras_in_step_are_believed() -> None:
    assert all(e.left_out == () and s.most.max() < 0.2 for e, s in _tracked(_shifted(0)))


def test_nothing_is_kept_where_it_stays_undecided_which_camera_it_is() -> None:
    never = OutOfStepRule(enough=100.0, tries=3)
    track = _tracked(_shifted(2)[:16], never)
    assert all(e.left_out == () for e, _ in track)
    tries, most = [s.tries for _, s in track], [float(s.most.max()) for _, s in track]
    ended = tries.index(3) + 1
    assert most[ended - 1] >= never.clear and tries[ended] == 0 and most[ended] == 0.0


def test_of_two_cameras_none_is_left_out() -> None:
    """Nobody knows which one is late."""
    frames = [replace(f, images=(f.images[0], f.images[1], None, None)) for f in _shifted(2)]
    assert all(e.left_out == () and s.most.max() == 0.0 for e, s in _tracked(frames))


def test_cameras_that_are_believed_again_have_nothing_against_them() -> None:
    memory = OutOfStep(np.array([0.1, 0.6, 0.0]), np.array([0.0, 0.0, 0.5]), np.ones(3), (1, 2), 2, 5)
    after = memory.of({2})
    np.testing.assert_array_equal(after.late, [0.1, 0.0, 0.0])
    np.testing.assert_array_equal(after.early, [0.0, 0.0, 0.5])
    assert after.cameras == (2,) and memory.of({1, 2}) is memory
