"""First states from clicked joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from reproduce.plates import NINETEEN
from support.finite_differences import numeric_jacobian
from twistcap import se3
from twistcap.adjust.first_pose.clicks import click_problem, click_variables, fit_clicks, gathered
from twistcap.adjust.first_pose.skeleton import Skeleton
from twistcap.body import rescaled
from twistcap.body.humanoid import humanoid
from twistcap.body.simplify import side_view, simplified
from twistcap.camera import ScaledView
from twistcap.differential.state import State
from twistcap.errors import InputError
from twistcap.solve import Vector

GENERIC = humanoid()
SIDED = ("hip", "knee", "ankle", "toe", "shoulder", "elbow", "wrist")
JOINTS = (*(f"{joint}_{side}" for side in "rl" for joint in SIDED), "neck", "head_top")
FRONT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def view_of(facing_deg: float, scale: float = 110.0) -> ScaledView:
    turn = FRONT @ se3.exp_rotation(np.array([0.0, 0.0, np.deg2rad(facing_deg)]))
    return ScaledView(se3.exp_rotation([0.08, 0.0, 0.02]) @ turn, scale, np.array([190.0, 130.0]))


def clicked(body, state, names, rng, noise):
    marks = state.posed(body).landmarks
    return [
        {n: view.pixels(marks[body.landmarks.index(n)]) + rng.normal(0, noise, 2) for n in names}
        for view in state.views
    ]


def test_the_gradient_is_that_of_the_energy() -> None:
    """Of a view of scaled orthography and of a pinhole's, joints, dimensions and leans."""
    rng = np.random.default_rng(0)
    model = simplified(GENERIC, NINETEEN)
    state = State((view_of(20), view_of(80)), np.clip(rng.normal(0, 0.3, 19), *model.limits.T))
    clicks = gathered(model, clicked(model, state, JOINTS, rng, 5.0))
    near = replace(view_of(90), K=np.array([[400.0, 0, 192], [0, 410.0, 140], [0, 0, 1]]))
    start = click_variables(Skeleton(model), State((view_of(0), near), np.zeros(19)))
    start = replace(start, blocks={**start.blocks, "joints": Vector(np.zeros(19))})
    problem = click_problem(clicks, start)
    step = rng.normal(0, 0.15, start.dof)
    step[[1, 2, 7, 8]] *= 20
    x = start.retract(step)
    expected = numeric_jacobian(lambda d: np.asarray(sum(problem.energies(x.retract(d)).values())), np.zeros(x.dof))
    np.testing.assert_allclose(problem.dense(x).gradient, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_three_views_give_angles_and_lengths() -> None:
    rng = np.random.default_rng(1)
    generic = simplified(GENERIC, NINETEEN)
    body = rescaled(
        generic,
        {"femur_r": 1.08, "femur_l": 1.08, "tibia_r": 0.94, "tibia_l": 0.94, "humerus_r": 1.1, "humerus_l": 1.1},
    )
    q = np.zeros(19)
    posture = {"hip_flexion_r": 25, "knee_angle_r": 15, "hip_flexion_l": -10, "knee_angle_l": 35}
    posture |= {"arm_flex_r": -20, "arm_flex_l": 25, "elbow_flex_r": 20, "elbow_flex_l": 40}
    for name, degrees in posture.items():
        q[body.coordinate(name)] = np.deg2rad(degrees)
    state = State((view_of(90), view_of(30), view_of(150)), q)
    found = fit_clicks(generic, clicked(body, state, JOINTS, rng, 0.5), facing_deg=(80, 40, 140))
    assert np.nanmax(found.residual_px) < 4
    errors = np.degrees(np.abs(found.state.q - q))
    flexions = [body.coordinate(n) for n in body.coordinate_names if "knee" in n or "hip_flexion" in n]
    assert errors[flexions].mean() < 3
    ratio = lambda b: b.landmarks.points  # noqa: E731
    bone = lambda b, i, j: np.linalg.norm(ratio(b)[b.landmarks.index(i)] - ratio(b)[b.landmarks.index(j)])  # noqa: E731
    for i, j in (("hip_r", "knee_r"), ("knee_l", "ankle_l")):
        true = bone(body, i, j) * state.views[0].scale
        assert abs(bone(found.body, i, j) * found.state.views[0].scale / true - 1) < 0.03
    assert bone(found.body, "hip_r", "knee_r") == pytest.approx(bone(found.body, "hip_l", "knee_l"), rel=1e-6)


def test_one_side_view_from_any_start() -> None:
    rng = np.random.default_rng(2)
    model = side_view(GENERIC, "r")
    q = np.deg2rad([5.0, 20, 30, 25, 20, 5])
    state = State((view_of(90),), q)
    names = [n for n in JOINTS if n in model.landmarks.names and not n.endswith("_l")]
    found = fit_clicks(model, clicked(model, state, names, rng, 0.5))
    assert np.degrees(np.abs(found.state.q - q)).max() < 8
    assert np.nanmax(found.residual_px) < 3


def test_bad_clicks_are_told() -> None:
    with pytest.raises(InputError, match="tail"):
        fit_clicks(GENERIC, [{"tail": (1, 2)}])
    with pytest.raises(InputError, match="4 clicked"):
        fit_clicks(GENERIC, [{"hip_r": (1, 2)}])
    with pytest.raises(InputError, match="finite"):
        fit_clicks(GENERIC, [dict.fromkeys(JOINTS, (np.nan, 2))])
