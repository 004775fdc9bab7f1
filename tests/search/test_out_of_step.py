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

BEFORE, UNTIL, FRAMES, FPS = 14, 34, 60, 60.0
ODD = 1  # the camera that is out of step


@cache
def _scene() -> Capture:
    return capture(StudioConfig(seed=2, views=4, frames=FRAMES + 3, fps=FPS, size=(320, 240)))


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


@pytest.mark.parametrize("by", [-3, -2, -1, 1, 2, 3])
def test_a_camera_out_of_step_is_left_out_and_comes_back(by: int) -> None:
    track = _tracked(_shifted(by))
    out = [e.left_out for e, _ in track]
    first = out.index((ODD,))
    assert first < 16 and set(out) == {(), (ODD,)}
    assert all(cameras == (ODD,) for cameras in out[first : UNTIL - BEFORE]) and out[-1] == ()
    _, memory = track[UNTIL - BEFORE - 1]
    assert 0.4 < memory.ahead[ODD] * FPS / by < 1.2 and np.abs(np.delete(memory.ahead, ODD)).max() < 0.005


def test_cameras_in_step_are_believed() -> None:
    assert all(e.left_out == () and np.abs(s.ahead).max() < 0.01 for e, s in _tracked(_shifted(0)))


def test_a_camera_out_of_step_whose_pictures_are_missing_now_and_then_is_left_out() -> None:
    frames = _shifted(2)
    for k in range(0, len(frames), 3):
        frames[k] = replace(frames[k], images=tuple(None if c == ODD else i for c, i in enumerate(frames[k].images)))
    out = [e.left_out for e, _ in _tracked(frames)]
    assert (ODD,) in out[:20] and set(out) <= {(), (ODD,)} and out[-1] == ()


def test_where_it_stays_undecided_it_is_tried_less_often() -> None:
    track = _tracked(_shifted(2)[: UNTIL - BEFORE], OutOfStepRule(enough=100.0, prompt=1))
    assert all(e.left_out == () for e, _ in track)
    waiting = [memory.waiting for _, memory in track]
    assert sorted(set(waiting)) == [*range(max(waiting) + 1)] and max(waiting) > 1


def test_a_camera_stays_left_out_while_the_body_stands_still() -> None:
    """Nothing is known of its clock. Here the body must have moved by 5 m in a tenth of a second: it stands still."""
    frames = _shifted(2)
    tracker = Tracker(_model())
    tracker.state = _before()
    for frame in frames[: UNTIL - BEFORE]:
        out = tracker.step(frame).left_out
    assert out == (ODD,)
    still = OutOfStepRule(shift=10.0)
    tracker.model = _model(still)
    assert all(tracker.step(frame).left_out == (ODD,) for frame in frames[UNTIL - BEFORE :])


@pytest.mark.parametrize("side", [-1.0, 0.0, 1.0])
def test_a_camera_that_was_early_and_is_late_without_it_is_believed_again(side: float) -> None:
    """Something else put the body beside where it is: here the pictures are two frames late."""
    state = _before()
    memory = state.searches["lost body"]
    assert isinstance(memory, LostMemory)
    steps = OutOfStep.none(4).leaving_out(ODD, side)
    memory = replace(memory, suspicion=replace(memory.suspicion, steps=steps))
    tracker, believed = Tracker(_model()), list[bool]()
    tracker.state = replace(state, left_out=(ODD,), searches={"lost body": memory})
    for frame in _shifted(-2)[:8]:
        believed.append(not tracker.step(frame).left_out)
    assert believed[-1] == (side > 0.0), believed
    after = tracker.state.searches["lost body"]
    assert isinstance(after, LostMemory) and after.suspicion.steps is not None
    assert side <= 0.0 or (after.suspicion.steps.waiting > 0 and not after.suspicion.steps.sides.any())


def test_of_two_cameras_none_is_left_out() -> None:
    """Nobody knows which one is late."""
    frames = [replace(f, images=(f.images[0], f.images[1], None, None)) for f in _shifted(2)]
    track = _tracked(frames)
    assert all(e.left_out == () for e, _ in track) and len({memory.sums.tobytes() for _, memory in track}) == 1


@pytest.mark.parametrize("by", [-3, 2])
def test_of_three_cameras_the_odd_one_is_left_out(by: int) -> None:
    """One faces it: without that one nobody else would see where along its picture the body is."""
    frames = [replace(f, images=(None, *f.images[1:])) for f in _shifted(by)]
    out = [e.left_out for e, _ in _tracked(frames)]
    assert (ODD,) in out[:20] and set(out) == {(), (ODD,)} and out[-1] == ()


def test_a_camera_out_of_step_may_come_back_where_only_one_other_sees_the_body() -> None:
    frames = _shifted(2)
    alone = [replace(f, images=(None, f.images[1], f.images[2], None)) for f in frames[UNTIL - BEFORE :]]
    track = _tracked([*frames[: UNTIL - BEFORE], *alone])
    assert track[UNTIL - BEFORE - 1][0].left_out == (ODD,) and track[-1][0].left_out == ()


def test_two_cameras_that_are_hardly_apart_do_not_hide_a_third_one() -> None:
    information, ahead = np.array([2500.0, 2500.0, 30.0]), np.array([0.0, 0.0055, 0.025])
    memory = OutOfStep(np.stack([information, information * ahead]), np.zeros(3), np.zeros(3))
    cameras = np.arange(3, dtype=np.int32)
    assert memory.most_apart(cameras, 0.0)[:2] == (1, 0)
    early, late, clear = memory.most_apart(cameras, 0.006)
    assert (early, late) == (2, 0) and clear == pytest.approx(0.025 / np.sqrt(1 / 2500 + 1 / 30))


def test_cameras_that_are_believed_again_have_nothing_against_them() -> None:
    memory = OutOfStep(np.arange(1.0, 7.0).reshape(2, 3), np.ones(3), np.zeros(3), (1, 2), 5.0)
    after = memory.of({2})
    np.testing.assert_array_equal(after.sums, [[1.0, 0.0, 3.0], [4.0, 0.0, 6.0]])
    np.testing.assert_array_equal(after.against, [1.0, 0.0, 1.0])
    assert after.cameras == (2,) and memory.of({1, 2}) is memory
    early = replace(memory, sides=np.array([1.0, 0.0, 1.0]))  # the first is out of step no longer, and believed
    np.testing.assert_array_equal(early.of({1, 2}).sides, [0.0, 0.0, 1.0])


def test_another_track_knows_the_cameras_and_nothing_of_the_way() -> None:
    memory = OutOfStep(np.ones((2, 3)), np.ones(3), np.zeros(3), (1,), 5.0, 3)
    after = memory.begun_anew()
    assert after.cameras == (1,) and not after.sums.any() and not after.against.any()
    assert (after.tries, after.waiting) == (0.0, 0)
    lost = _before().searches["lost body"]
    assert isinstance(lost, LostMemory)
    again = replace(lost, suspicion=replace(lost.suspicion, steps=memory)).begun_anew().suspicion.steps
    assert again is not None and again.cameras == (1,) and not again.sums.any()
