"""Which cameras are left out, and when they come back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest

from reproduce.faults.kinds import take_of
from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.build import build
from twistcap.estimate import Frame
from twistcap.predict import Prediction
from twistcap.search.contradiction import ContradictionRule, Suspicion, _moved, _taken_back, _there
from twistcap.search.memory import LostMemory
from twistcap.search.recollection import Check, Covered, Judged
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import State, Tracker
from twistcap.track.step import posed_problem

BEFORE = 16


@cache
def _scene() -> Capture:
    return capture(StudioConfig(seed=2, views=3, frames=36, fps=30.0, size=(320, 240)))


@cache
def _frames() -> list[Frame]:
    return list(_scene().frames())


@cache
def _tracked() -> State:
    """After the first frames, which nothing disturbs."""
    scene = _scene()
    tracker = Tracker(build(scene.body, scene.rig))
    tracker.start(scene.first_pose)
    for frame in _frames()[:BEFORE]:
        tracker.step(frame)
    return tracker.state


@pytest.mark.parametrize(
    ("fitting", "moved"), [((0.7, 0.98, 1.0), {0}), ((0.7, 0.74, 0.97), {0, 1}), ((0.72, 0.74, 0.76), set()),
                           ((0.72, 0.74, 0.71), set())],
)  # fmt: skip
def test_a_camera_has_moved_where_another_has_not(fitting: tuple[float, ...], moved: set[int]) -> None:
    """Noise and light change the backgrounds of all, if not equally."""
    known = _memory(_tracked()).known
    nothing = np.zeros_like(known.nats)
    check = Check(nothing, known.pixels, nothing, np.array(fitting) * known.fitting)
    assert _moved(ContradictionRule(), known, check, np.full(3, 0.6)) == moved


def _memory(state: State) -> LostMemory:
    memory = state.searches["lost body"]
    assert isinstance(memory, LostMemory)
    return memory


def _going_on(state: State) -> Iterator[tuple[float, State]]:
    """Errors and states from there on."""
    scene = _scene()
    tracker = Tracker(build(scene.body, scene.rig))
    tracker.state = state
    for frame in _frames()[BEFORE:]:
        found = Posed(scene.body, tracker.step(frame).pose).landmarks
        yield float(np.linalg.norm(found - scene.landmarks[frame.index], axis=1).max()), tracker.state


def test_cameras_come_back_where_the_others_have_lost_the_body() -> None:
    """One camera alone let it run away; the two that were left out would see it."""
    state = _tracked()
    here = state.past.last
    away = Pose(se3.transform(here.root[:3, :3], here.root[:3, 3] + (0.8, 0.5, 0.0)), here.q)
    moments = tuple(replace(m, pose=away) for m in state.past.moments)
    memory = replace(_memory(state), suspicion=Suspicion({}, moved=(0, 1)))
    state = replace(state.with_past(replace(state.past, moments=moments)), left_out=(0, 1))
    state = replace(state, searches={"lost body": memory})
    track = list(islice(_going_on(state), 5))
    assert track[-1][1].left_out == () and track[-1][0] < 0.03


def test_all_cameras_are_believed_where_nobody_is() -> None:
    scene = _scene()
    tracker = Tracker(build(scene.body, scene.rig))
    tracker.state = replace(_tracked(), left_out=(1,))
    told = [tracker.step(_empty(frame)) for frame in _frames()[BEFORE : BEFORE + 2]]
    assert told[-1].status == "not_found" and tracker.state.left_out == ()


def test_all_cameras_are_believed_under_another_light() -> None:
    """It may have been that light for which one was left out, and of what it showed nothing is known any more."""
    scene = _scene()
    tracker = Tracker(build(scene.body, scene.rig))
    tracker.state = replace(_tracked(), left_out=(1,))
    found = tracker.step(_dark(_frames()[BEFORE]))
    assert found.seen and tracker.state.left_out == ()


@pytest.mark.parametrize(("evidence", "left"), [(0.4, set()), (0.9, {1}), (np.nan, {1})])
def test_cameras_come_back_where_the_others_say_that_they_have_lost_the_body(evidence: float, left: set[int]) -> None:
    """Not where they hardly see it: they say nothing then."""
    state, scene = replace(_tracked(), left_out=(1,)), _scene()
    model, frame = build(scene.body, scene.rig), _frames()[BEFORE]
    none = np.zeros((scene.body.dof, scene.body.dof))
    frame = replace(frame, images=(frame.images[0], None, frame.images[2]))
    problem = posed_problem(state, frame, model, Prediction(state.past.last, "hold", none, none))
    known, fit = _memory(state).known, problem.measured(state.past.last)
    check = known.check(fit.posed, fit.sights, problem)
    check = replace(check, nats=evidence * known.usual * check.pixels)
    out, _ = _taken_back(ContradictionRule(), Suspicion({}), known, Judged(problem, fit, check))
    assert out == left


def _thought_away(turned: bool, by: tuple[float, float, float]) -> tuple[State, Judged]:
    """A frame whose second camera, left out, may be turned, and in which the others think the body to be away by m."""
    state, scene = replace(_tracked(), left_out=(1,)), _scene()
    model, frame = build(scene.body, scene.rig), _frames()[BEFORE]
    images, here = list(frame.images), state.past.last
    images[1] = np.roll(images[1], 40, axis=1) if turned and images[1] is not None else images[1]
    away = Pose(se3.transform(here.root[:3, :3], here.root[:3, 3] + by), here.q)
    none = np.zeros((scene.body.dof, scene.body.dof))
    problem = posed_problem(state, replace(frame, images=tuple(images)), model, Prediction(away, "hold", none, none))
    known, fit = _memory(state).known, problem.measured(away)
    check = known.check(fit.posed, fit.sights, problem)
    return state, Judged(problem, fit, replace(check, nats=0.9 * known.usual * check.pixels))


@pytest.mark.parametrize("turned", [False, True])
def test_a_camera_that_stands_again_comes_back_though_the_body_is_thought_to_be_elsewhere(turned: bool) -> None:
    """It was left out while it was dark, and one camera alone let the body slide away."""
    state, judged = _thought_away(turned, (0.2, -0.2, 0.0))
    out, _ = _taken_back(ContradictionRule(twice=1), Suspicion({}, moved=(1,)), _memory(state).known, judged)
    assert out == ({1} if turned else set())


@pytest.mark.parametrize("turned", [False, True])
def test_a_camera_comes_back_where_all_fit_together(turned: bool) -> None:
    """The body that two cameras see may be too far off for the third one to agree with it."""
    state, judged = _thought_away(turned, (0.04, -0.04, 0.0))
    known, rule = _memory(state).known, ContradictionRule(twice=1)
    assert known.ratios(_there(known, 1, judged), rule.clear)[1] < rule.right
    out, _ = _taken_back(rule, Suspicion({}), known, judged)
    assert out == ({1} if turned else set())


def test_no_camera_is_left_out_before_it_is_known_what_is_usual() -> None:
    scene, frames = _scene(), _frames()
    tracker, out = Tracker(build(scene.body, scene.rig)), list[tuple[int, ...]]()
    tracker.start(scene.first_pose)
    for k, frame in enumerate(frames[:BEFORE]):
        images = frame.images if k < 3 else (frames[k + 20].images[0], *frame.images[1:])
        out.append(tracker.step(replace(frame, images=images)).left_out)
    assert all(cameras == () for cameras in out[:10]) and out[-1] == (0,)


def _empty(frame: Frame) -> Frame:
    return replace(frame, images=tuple(np.asarray(255 * room, np.uint8) for room in _scene().rooms))


def _dark(frame: Frame) -> Frame:
    return replace(frame, images=tuple(np.uint8(0.4 * np.float32(image)) for image in frame.images))


def test_what_lacks_of_a_body_that_is_hardly_told_from_the_background_is_little() -> None:
    known = _memory(_tracked()).known
    usual = known.usual * known.pixels
    clear, half = usual.sum(axis=1) / known.pixels.sum(axis=1), Covered(0.5 * usual, known.pixels)
    np.testing.assert_allclose(known.ratios(half), 0.5)
    np.testing.assert_allclose(known.ratios(half, 0.9 * clear.min()), 0.5)
    np.testing.assert_allclose(known.ratios(half, 2.0 * clear.max()), 1.0 - 0.25 * clear / clear.max())


def test_a_camera_in_which_body_and_room_look_alike_contradicts_nobody() -> None:
    """Seed of the fault bench in which one was left out from the third frame on, and an arm was lost without it."""
    scene = take_of(5474)
    tracker = Tracker(build(scene.scene.body, scene.scene.rig))
    tracker.start(scene.first_pose)
    assert [tracker.step(frame).left_out for frame in islice(scene.frames(), 26)] == [()] * 26
