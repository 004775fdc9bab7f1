"""Blocks of variables: retraction and difference undo each other, and the derivatives of a pose between two frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from support.blocks import step_between
from support.finite_differences import check_jacobian
from support.shapes import camera_at
from twistcap import se3
from twistcap.body import Pose
from twistcap.solve import CameraBlock, PoseTrack, Variables, Vector

Array = np.ndarray
JOINTS = 5


def poses(count: int, seed: int = 0, size: float = 0.4) -> tuple[Pose, ...]:
    rng = np.random.default_rng(seed)
    return tuple(Pose(se3.exp(size * rng.normal(size=6)), size * rng.normal(size=JOINTS)) for _ in range(count))


def track(count: int = 4, seed: int = 0) -> PoseTrack:
    return PoseTrack(poses(count, seed), np.array([0.0, 0.1, 0.25, 0.3])[:count])


BLOCKS: dict[str, Any] = {
    "poses": track(),
    "camera": CameraBlock(camera_at((2.8, 0.7, 0.4))),
    "clock": Vector(np.array([0.02])),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_the_difference_is_the_step_that_was_taken(name: str) -> None:
    block = BLOCKS[name]
    step = 0.3 * np.random.default_rng(1).normal(size=block.dof)
    np.testing.assert_allclose(step_between(block.retract(step), block), step, atol=1e-12)


def test_a_vector_stays_inside_its_limits_and_says_where_it_presses() -> None:
    vector = Vector(np.zeros(3), np.array([[-1.0, 1.0], [0.0, 2.0], [0.0, 2.0]]))
    np.testing.assert_allclose(vector.retract(np.array([5.0, -5.0, 0.5])).values, [1.0, 0.0, 0.5])
    np.testing.assert_array_equal(vector.pressed(np.array([9.0, 9.0, -9.0])), [False, True, False])


def test_free_blocks_move_and_others_stay() -> None:
    x = Variables(BLOCKS, ("clock", "poses"), longest={"clock": 0.01})
    step = 0.1 * np.random.default_rng(2).normal(size=x.dof)
    moved = x.retract(step)
    assert x.dof == 1 + BLOCKS["poses"].dof
    assert moved["camera"] is x["camera"] and moved["clock"].values[0] == pytest.approx(0.02 + step[0])
    np.testing.assert_allclose(step_between(moved, x), step, atol=1e-12)
    np.testing.assert_allclose(x.longest_step()[:3], [0.01, 1.0, 1.0])


def test_numbers_that_are_fixed_or_pressed_against_a_limit_are_held() -> None:
    blocks = {"a": Vector(np.zeros(2), np.array([[0.0, 1.0], [-1.0, 1.0]])), "b": Vector(np.zeros(3))}
    x = Variables(blocks, ("a", "b"), fixed={"b": np.array([False, True, False])})
    np.testing.assert_array_equal(x.held(np.ones(5)), [True, False, False, True, False])
    np.testing.assert_array_equal(x.held(-np.ones(5)), [False, False, False, True, False])


@pytest.mark.parametrize("time", [-0.03, 0.0, 0.04, 0.1, 0.2, 0.28, 0.35])
def test_a_pose_between_two_frames_and_its_derivatives(time: float) -> None:
    here = track()
    at = here.at(time)

    def moved(step: Array, late: float = 0.0) -> Array:
        return here.retract(step).at(time + late).pose.minus(at.pose)

    D = here.pose_dof
    expected = np.zeros((D, here.dof))
    for k, by in zip(at.frames, at.by_frame, strict=True):
        expected[:, k * D : (k + 1) * D] = by
    check_jacobian(moved, expected, np.zeros(here.dof), atol=1e-7)
    if time not in (0.0, 0.1):  # where the velocity jumps
        check_jacobian(lambda t: moved(np.zeros(here.dof), float(t[0])), at.velocity[:, None], np.zeros(1), rtol=1e-5)


def test_at_its_frames_a_track_has_its_poses() -> None:
    here = track()
    for time, pose in zip(here.times, here.poses, strict=True):
        np.testing.assert_allclose(here.at(float(time)).pose.minus(pose), 0.0, atol=1e-12)
    two = replace(here, poses=here.poses[:2], times=here.times[:2])
    assert two.at(1.0).frames == (0, 1)
