"""Pictures that come under other cameras' names are told apart by the cameras' backgrounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.faulty_walk import FAULT, empty, tracked_walk, walk
from twistcap.camera import Rig
from twistcap.camera.bump import turned_back
from twistcap.cues.view import as_calibrated
from twistcap.estimate import Estimate, Frame, Keypoints
from twistcap.hindsight import Passed
from twistcap.predict import Prediction
from twistcap.search.recollection import fitted
from twistcap.search.swap import SwapRule
from twistcap.track import Model
from twistcap.track.align import FrameProblem
from twistcap.track.state import State
from twistcap.track.step import posed_problem

PAIR, ROUND = (1, 0, 2), (2, 0, 1)
"""Whose picture comes under each name; in a round, each camera's comes under the name of the next one."""
BUMP = np.deg2rad([0.9, -1.6, 0.8])


def _given(frame: Frame, whose: tuple[int, ...]) -> Frame:
    return replace(frame, images=tuple(frame.images[c] for c in whose))


def _sources(whose: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(np.argsort(whose).tolist())


@pytest.mark.parametrize("whose", [PAIR, ROUND])
def test_swapped_pictures_go_to_their_own_cameras(whose: tuple[int, ...]) -> None:
    """From the first frame on, and back again."""
    track = [(error, tracker.state) for error, tracker in tracked_walk(lambda frame: _given(frame, whose))]
    assert max(error for error, _ in track) < 0.03
    assert all(state.left_out == () and not np.any(state.bumps) for _, state in track)
    for k, (_, state) in enumerate(track):
        assert state.sources == (_sources(whose) if k in FAULT else ())


def test_pictures_that_are_swapped_while_nobody_is_in_sight() -> None:
    def faulty(frame: Frame) -> Frame:
        seen = empty(frame) if frame.index < FAULT[8] else frame
        return _given(seen, PAIR) if frame.index >= FAULT[4] else seen

    track = [(error, tracker.state.sources) for error, tracker in tracked_walk(faulty)]
    assert min(error for error, _ in track[FAULT[8] : FAULT[8] + 4]) < 0.02
    assert max(error for error, _ in track[FAULT[12] :]) < 0.03
    assert all(sources == _sources(PAIR) for _, sources in track[FAULT[8] : FAULT[-1]]) and track[-1][1] == ()


def test_a_camera_that_stands_turned_keeps_its_turn() -> None:
    rig = walk()[0].rig

    def faulty(frame: Frame) -> Frame:
        first = frame.images[0]
        assert first is not None
        turned = replace(frame, images=(turned_back(first, rig[0], -BUMP), *frame.images[1:]))
        return _given(turned, PAIR) if frame.index >= FAULT[6] else turned

    track = [(error, tracker.state) for error, tracker in tracked_walk(faulty)]
    assert max(error for error, _ in track) < 0.04
    assert [state.sources for _, state in track[FAULT[0] : FAULT[-1] + 1]] == [()] * 6 + [_sources(PAIR)] * 12
    for _, state in track[FAULT[0] : FAULT[-1] + 1]:
        np.testing.assert_allclose(state.bumps, np.outer([1.0, 0.0, 0.0], BUMP), atol=np.deg2rad(0.05))


def _problem(faulty: Frame) -> tuple[State, FrameProblem]:
    """What a walk has taught, and a frame of it."""
    scene, _ = walk()
    *_, (_, tracker) = (pair for pair, _ in zip(tracked_walk(lambda frame: frame), range(12), strict=False))
    none = np.zeros((scene.body.dof, scene.body.dof))
    prediction = Prediction(scene.true_poses[12], "hold", none, none)
    model: Model = tracker.model
    return tracker.state, posed_problem(tracker.state, faulty, model, prediction)


@pytest.mark.parametrize(
    ("whose", "sources"), [(PAIR, (1, 0, 2)), (ROUND, (1, 2, 0)), ((0, 1, 2), ()), ((1, 1, 2), ()), ((1, 2, 2), ())]
)
def test_only_cameras_that_show_each_other_s_backgrounds_are_swapped(
    whose: tuple[int, ...], sources: tuple[int, ...]
) -> None:
    state, problem = _problem(_given(walk()[1][12], whose))
    known, rule = state.searches["lost body"].known, SwapRule()
    assert rule.sources(known, problem) == sources
    dark = replace(problem.frame, images=(np.zeros((240, 320, 3), np.uint8), *problem.frame.images[1:]))
    assert rule.sources(known, replace(problem, frame=dark)) == ()
    missing = replace(problem.frame, images=(None, *problem.frame.images[1:]))
    assert rule.sources(known, replace(problem, frame=missing)) == ()


def test_cameras_that_were_left_out_are_sorted_where_the_body_is_clear_then() -> None:
    """A camera alone agrees better with itself than three do: that is no measure. They are looked at in every third
    frame."""
    state, problem = _problem(_given(walk()[1][12], PAIR))
    known = state.searches["lost body"].known
    alone = fitted(known, problem.excluding(frozenset({0, 1})))
    alone = replace(alone, check=replace(alone.check, nats=2.0 * alone.check.nats))  # as clear as can be
    rule = SwapRule()
    assert rule.sorted_by(known, alone, 4) == ((), alone)
    sources, again = rule.sorted_by(known, alone, 3)
    assert sources == _sources(PAIR) and again.problem.left_out == frozenset() and len(again.fit.sights) == 3


def test_pictures_are_not_sorted_where_the_body_is_no_clearer_then() -> None:
    state, problem = _problem(walk()[1][12])
    known = state.searches["lost body"].known
    wrong = replace(known, backdrops=(known.backdrops[1], known.backdrops[0], known.backdrops[2]))
    assert SwapRule().sources(wrong, problem) == _sources(PAIR)
    right = fitted(known, problem)
    suspected = replace(right, check=replace(right.check, fitting=np.zeros(3)))
    assert SwapRule().sorted_by(wrong, suspected, 1) == ((), suspected)
    nobody = replace(suspected, check=replace(suspected.check, nats=np.zeros_like(right.check.nats)))
    assert SwapRule().sorted_by(wrong, nobody, 1)[0] == _sources(PAIR)  # it is the body that decided


def test_pictures_of_other_sizes_are_never_taken_for_each_other() -> None:
    state, problem = _problem(_given(walk()[1][12], PAIR))
    model = problem.model
    other = replace(model.rig[1], size=(300, 240))
    problem = replace(problem, model=replace(model, rig=Rig((model.rig[0], other, model.rig[2]))))
    assert SwapRule().sources(state.searches["lost body"].known, problem) == ()


def test_frames_are_sorted_wherever_estimates_are_used_again() -> None:
    """With their keypoints; and a picture that told nothing is missed where it came."""
    scene, frames = walk()
    points = Keypoints(("knee_r",), np.arange(3.0)[:, None, None] + np.zeros((3, 1, 2)), np.ones((3, 1)))
    own = replace(frames[0], keypoints=points)
    given = replace(_given(own, ROUND), keypoints=points.sorted_by(ROUND))
    pose, covariance = scene.first_pose, np.eye(scene.body.dof)
    estimate = Estimate(0, 0.0, pose, covariance, sources=_sources(ROUND), missing=(2,))
    again = as_calibrated(given, estimate, scene.rig)
    assert all(a is b for a, b in zip(again.images, own.images, strict=True))
    assert again.keypoints is not None
    np.testing.assert_array_equal(again.keypoints.pixels, points.pixels)
    assert estimate.swapped == (0, 1, 2)
    seen = Passed(given, estimate).seen
    assert [image is None for image in seen.images] == [True, False, False]  # camera 2's came under the name of 0
    assert as_calibrated(seen, estimate, scene.rig).images[2] is None
