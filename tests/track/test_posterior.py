"""What is claimed of a pose: only what a frame's images say is added; and a hypothesis brings its own evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twistcap.body import Pose
from twistcap.build import build
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, State, step
from twistcap.track.align import FrameProblem
from twistcap.track.step import posed_problem, predicted


def settled(frames: int = 3) -> tuple[Capture, Model, State]:
    """A walk that has been tracked for some frames."""
    scene = capture(StudioConfig(seed=2, views=3, frames=frames + 8))
    model = build(scene.body, scene.rig)
    state = model.start(scene.first_pose)
    for k in range(frames):
        state, _ = step(state, scene.frame(k), model)
    return scene, model, state


def problem_of(scene: Capture, model: Model, state: State, index: int) -> FrameProblem:
    frame = scene.frame(index)
    prediction, state = predicted(state, frame, model)
    return posed_problem(state, frame, model, prediction)


def test_limits_and_the_rest_pose_are_no_news_frame_after_frame() -> None:
    """Without a cue the images say nothing: a joint at its limit, or at rest, grows uncertain as any other does."""
    scene, model, _ = settled(0)
    blind = replace(model, cues=(), searches=())
    q = scene.first_pose.q.copy()
    elbow = scene.body.coordinate("elbow_flex_r")
    q[elbow] = scene.body.limits[elbow, 0] - 0.02  # pressed against its limit
    state = blind.start(Pose(scene.first_pose.root, q))
    sigma = []
    for k in range(6):
        expected = problem_of(scene, blind, state, k).uncertainty.spread
        state, estimate = step(state, scene.frame(k), blind)
        np.testing.assert_allclose(estimate.covariance, expected, rtol=1e-6, atol=1e-9)
        sigma.append(np.sqrt(np.diag(estimate.covariance)[6:]))
    assert np.all(sigma[-1] > 1.2 * sigma[1])


def test_images_are_news() -> None:
    scene, model, state = settled()
    expected = problem_of(scene, model, state, 3).uncertainty.spread
    _, estimate = step(state, scene.frame(3), model)
    assert np.all(np.diag(estimate.covariance) < np.diag(expected))


@pytest.mark.parametrize("index", [3, 4])
def test_a_hypothesis_is_measured_where_it_is(index: int) -> None:
    """Evidence, contours and agreement of an accepted hypothesis are of its own pose, not of the fit that lost it."""
    scene, model, state = settled()
    problem = problem_of(scene, model, state, index)
    q = problem.start.q.copy()
    q[scene.body.coordinate("arm_flex_r")] += 1.0
    raised = Pose(problem.start.root, q)
    there, here = problem.measured(raised), problem.measured(problem.start)
    assert there.pose is raised and there.steps == 0
    for sight in there.sights:
        assert sight.seen.posed.pose is raised
    arm = scene.body.segment("humerus_r")
    assert there.agreement.agreeing[arm] < 0.7 * here.agreement.agreeing[arm]
