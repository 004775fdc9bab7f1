"""The differential tracker's geometry and equations."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.finite_differences import check_jacobian, numeric_jacobian
from support.readable import stacked_view_rows
from twistcap import se3
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, look_at
from twistcap.camera.scaled import ROOT, ScaledView
from twistcap.differential.model import DifferentialModel
from twistcap.differential.state import State
from twistcap.errors import InputError
from twistcap.render import render
from twistcap.solve import BlockProblem
from twistcap.terms.photometric import Samples
from twistcap.terms.scaled import image_motion, normal_equations

BODY = humanoid()
SIZE = (200, 260)


def a_state(views: int = 1) -> State:
    rng = np.random.default_rng(3)
    facing = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # z up, seen from the front
    made = tuple(
        ScaledView(se3.exp_rotation(rng.normal(0, 0.4, 3)) @ facing, 110.0, np.array([100.3, 120.8]), size=SIZE)
        for _ in range(views)
    )
    return State(made, np.clip(rng.normal(0, 0.4, len(BODY.coordinate_names)), *BODY.limits.T))


def some_points(state: State):
    seen = render(state.posed(BODY), state.views[0])
    rows, columns = np.nonzero(seen.inside > 2)
    pick = np.random.default_rng(0).permutation(len(rows))[:300]
    return seen.surface_points(rows[pick].astype(np.int32), columns[pick].astype(np.int32)), rows[pick], columns[pick]


def test_surface_points_lie_at_their_pixels_and_are_visible() -> None:
    state = a_state()
    points, rows, columns = some_points(state)
    np.testing.assert_allclose(
        state.views[0].pixels(points.at(state.posed(BODY))), np.stack([columns, rows], 1), atol=0.3
    )
    visible, pixels = render(state.posed(BODY), state.views[0]).visible(points, 0.02)
    assert visible.all()
    np.testing.assert_array_equal(np.rint(pixels), np.stack([columns, rows], 1))


def test_what_lies_behind_is_not_visible() -> None:
    state = a_state()
    points, *_ = some_points(state)
    front = state.views[0]
    back = replace(front, rotation=se3.exp_rotation([0, np.pi, 0]) @ front.rotation)
    assert render(state.posed(BODY), back).visible(points, 0.02)[0].mean() < 0.02


def test_image_motion_is_the_derivative_of_the_rendered_motion_field() -> None:
    """Every pixel of the body moves with the view's twist and the joints as H and J say."""
    state = a_state()
    points, *_ = some_points(state)
    J = image_motion(state.posed(BODY), state.views[0], points)

    def pixels(delta):
        moved = state.retract(delta)
        return moved.views[0].pixels(points.at(moved.posed(BODY)))

    check_jacobian(pixels, J, np.zeros(BODY.dof), rtol=1e-6, atol=1e-5)


def test_retract_and_minus_are_inverse() -> None:
    state = a_state(3)
    delta = np.random.default_rng(5).normal(0, 0.2, 3 * ROOT + len(BODY.coordinate_names))
    np.testing.assert_allclose(state.retract(delta).minus(state), delta, atol=1e-9)


def test_a_far_pinhole_is_a_scaled_view_and_back() -> None:
    camera = Camera(
        "far", np.array([[8e4, 0, 500], [0, 8e4, 400], [0, 0, 1.0]]), look_at([400, 30, 1], [0, 0, 1]), (1000, 800)
    )
    root = se3.transform(se3.exp_rotation([0.2, -0.1, 0.7]), [0.4, -0.3, 1.1])
    view = ScaledView.of(camera, root)
    points = BODY.vertices[::50]
    there = camera.project(se3.apply(root, points))[0]
    assert np.abs(view.pixels(points) - there).max() < 0.5  # of 350 px
    np.testing.assert_allclose(view.root(camera), root, atol=1e-6)


def near_view() -> tuple[Camera, np.ndarray, ScaledView]:
    """A pinhole 3 m off, beside its axis, a pose before it, and its own view."""
    K = np.array([[300.0, 0, 100], [0, 300.0, 130], [0, 0, 1.0]])
    camera, root = (
        Camera("near", K, look_at([3, 0.5, 1], [0, 0, 0.2]), SIZE),
        se3.transform(se3.exp_rotation([0, 0.1, 0.7]), [0.2, -0.3, 0.1]),
    )
    return camera, root, ScaledView.of(camera, root, perspective=True)


def test_a_perspective_view_is_the_pinholes_own() -> None:
    camera, root, view = near_view()
    points = BODY.vertices[::50]
    there = camera.project(se3.apply(root, points))[0]
    np.testing.assert_allclose(view.pixels(points), there, atol=1e-9)
    homogeneous = points @ view.P[:, :3].T + view.P[:, 3]
    np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], there, atol=1e-9)
    np.testing.assert_allclose(view.scaled(0.5).pixels(points), 0.5 * there - 0.25, atol=1e-9)
    np.testing.assert_allclose(view.root(camera), root, atol=1e-12)
    assert np.abs(replace(view, K=None).pixels(points) - there).max() > 3.0


def test_a_body_behind_the_camera_is_told() -> None:
    camera, root, _ = near_view()
    behind = se3.transform(root[:3, :3], camera.centre + 0.1 * camera.T_cam_world[2, :3])
    with pytest.raises(InputError, match="behind a camera"):
        ScaledView.of(camera, behind, perspective=True).pixels(BODY.vertices)


def test_surface_points_of_a_perspective_view_lie_at_their_pixels() -> None:
    state = State((near_view()[2],), np.zeros(len(BODY.coordinate_names)))
    points, rows, columns = some_points(state)
    pixels = state.views[0].pixels(points.at(state.posed(BODY)))
    np.testing.assert_allclose(pixels, np.stack([columns, rows], 1), atol=1e-6)


def test_the_step_of_a_perspective_view_is_the_derivative_of_its_pixels() -> None:
    state = State((near_view()[2],), a_state().q)
    points, *_ = some_points(state)
    posed = state.posed(BODY)

    def pixels(delta):
        moved = state.retract(delta)
        return moved.views[0].pixels(points.at(moved.posed(BODY)))

    J = image_motion(posed, state.views[0], points)
    check_jacobian(pixels, J, np.zeros(BODY.dof), rtol=1e-6, atol=1e-5)
    rng = np.random.default_rng(1)
    samples = Samples(points, rng.random(len(points)), rng.normal(size=(len(points), 2)))
    args = (posed, state.views[0], samples, textured(rng), np.array([0.1, -0.05]), rng.random(len(points)))
    for fast, slow in zip(normal_equations(*args), stacked_view_rows(*args), strict=True):
        np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-9 * np.abs(slow).max())


def textured(rng) -> np.ndarray:
    return cv2.GaussianBlur(rng.random((SIZE[1], SIZE[0])).astype(np.float32), (0, 0), 2.0)


def test_normal_equations_equal_their_twin() -> None:
    rng, state = np.random.default_rng(1), a_state()
    points, *_ = some_points(state)
    samples = Samples(points, rng.random(len(points)), rng.normal(size=(len(points), 2)))
    args = (state.posed(BODY), state.views[0], samples, textured(rng), np.array([0.1, -0.05]), rng.random(len(points)))
    for fast, slow in zip(normal_equations(*args), stacked_view_rows(*args), strict=True):
        np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-9 * np.abs(slow).max())


def test_points_without_weight_may_be_of_unknown_brightness() -> None:
    """As those are that a level of the pyramid does not show."""
    rng, state = np.random.default_rng(1), a_state()
    points, *_ = some_points(state)
    samples = Samples(points, rng.random(len(points)), rng.normal(size=(len(points), 2)))
    weight = np.where(np.arange(len(points)) % 3 == 0, 0.0, 1.0)
    unknown = Samples(points, np.where(weight > 0, samples.value, np.nan), samples.gradient)
    posed, view, image, lit = state.posed(BODY), state.views[0], textured(rng), np.zeros(2)
    found = normal_equations(posed, view, unknown, image, lit, weight)
    for a, b in zip(found, normal_equations(posed, view, samples, image, lit, weight), strict=True):
        np.testing.assert_array_equal(a, b)


def test_gradient_is_that_of_the_energy() -> None:
    """On a picture that is a plane, where sampled values have exact gradients."""
    rng, state = np.random.default_rng(1), a_state()
    points, *_ = some_points(state)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    image = (0.002 * x + 0.003 * y).astype(np.float32)
    samples = Samples(points, rng.random(len(points)), np.tile([0.002, 0.003], (len(points), 1)))
    weight, exposure = rng.random(len(points)), np.array([0.1, -0.05])

    def energy(delta):
        moved = state.retract(delta[:-2])
        r = samples.residuals(moved.posed(BODY), moved.views[0].P, image, exposure + delta[-2:])
        return 0.5 * np.sum(weight * r**2)

    g, _ = normal_equations(state.posed(BODY), state.views[0], samples, image, exposure, weight)
    np.testing.assert_allclose(g, numeric_jacobian(energy, np.zeros(BODY.dof + 2), 1e-4), rtol=2e-3, atol=2e-3)


def test_the_gradient_of_the_priors_is_that_of_their_energy() -> None:
    model = DifferentialModel(BODY)
    guess = model.variables(a_state(2))
    step = np.random.default_rng(4).normal(0, 0.1, guess.dof)
    x, problem = guess.retract(step), BlockProblem(model.priors(guess))
    inside = ~x.held(np.ones(x.dof)) & ~x.held(-np.ones(x.dof))
    slope = numeric_jacobian(lambda d: sum(problem.energies(x.retract(d)).values()), np.zeros(x.dof), 1e-6)
    np.testing.assert_allclose(problem.dense(x).gradient[inside], slope[inside], rtol=1e-5, atol=1e-3)
    assert inside.sum() > 2 * ROOT and sum(problem.energies(guess).values()) == 0.0
