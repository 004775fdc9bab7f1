"""Terms of the least-squares system: every gradient against its energy, every Hessian against its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from support.finite_differences import check_jacobian, numeric_jacobian
from support.readable import stacked_rows
from support.shapes import camera_at
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.render import SurfacePoints
from twistcap.render.view import surface_points
from twistcap.terms import (
    GaussianTerm,
    KeypointTerm,
    LimitTerm,
    PhotometricTerm,
    PointNormalTerm,
    PointRayTerm,
    Quadratic,
    RestTerm,
    Term,
    photometric,
)
from twistcap.terms.accumulate import PointTerm, Rows, normal_equations
from twistcap.terms.photometric import EXPOSURE, Samples, sample
from twistcap.terms.points import projected_rows, projected_rows_reference
from twistcap.terms.robust import cauchy, huber

Array = np.ndarray
CAMERA = camera_at((2.8, 0.7, 0.4))
N = 80


def random_pose(body: Body, seed: int = 0, size: float = 0.4) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(se3.exp(size * rng.normal(size=6)), size * rng.normal(size=body.dof - 6))


BODY = humanoid()
POSED = Posed(BODY, random_pose(BODY))


def places(n: int = N, seed: int = 1) -> SurfacePoints:
    """Points all over the surface, on blended skin as well."""
    rng = np.random.default_rng(seed)
    corners = BODY.faces[rng.integers(len(BODY.faces), size=n)]
    return surface_points(BODY, corners, rng.dirichlet(np.ones(3), n))


def units(shape: tuple[int, ...], seed: int = 2) -> Array:
    x = np.random.default_rng(seed).normal(size=shape)
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def sampled(image: Array, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Brightness, ∂x, ∂y and validity (0/1), each (N,), of `sample` at every point."""
    value, gx, gy, valid = np.array([sample(image, u, v) for u, v in zip(x, y, strict=True)], dtype=float).T
    return value, gx, gy, valid


def weights(n: int = N) -> Array:
    w = np.random.default_rng(3).uniform(0.2, 3.0, n)
    w[::9] = 0.0
    return w


def off_target(size: float = 3.0) -> Array:
    """(N, 2) px somewhat beside where the points project."""
    return CAMERA.project(places().at(POSED))[0] + size * np.random.default_rng(4).normal(size=(N, 2))


def normal_term() -> PointNormalTerm:
    return PointNormalTerm(CAMERA.P, places(), off_target(), units((N, 2)), weights(), 3.0)


def ray_term() -> PointRayTerm:
    direction, moment = CAMERA.rays(off_target())
    return PointRayTerm(places(), direction, moment, np.random.default_rng(5).uniform(80, 130, N), weights(), 3.0)


def keypoint_term() -> KeypointTerm:
    marks = BODY.landmarks
    points = SurfacePoints(marks.segments[:, None], np.ones((len(marks.names), 1)), marks.points)
    target = CAMERA.project(POSED.landmarks)[0] + 6 * np.random.default_rng(6).normal(size=(len(points), 2))
    return KeypointTerm(CAMERA.P, points, target, weights(len(points)), 5.0)


def photometric_term(offset: float = 0.02) -> PhotometricTerm:
    """On an image linear in x, y and xy, bilinear sampling and central differences are exact."""
    y, x = np.mgrid[:240, :320].astype(float)
    image = (0.2 + 1.1e-3 * x + 0.7e-3 * y + 3e-6 * x * y).astype(np.float32)
    u, v = CAMERA.project(places().at(POSED))[0].T
    value, gx, gy, _ = sampled(image, u, v)
    template = value - offset * np.random.default_rng(7).normal(size=N)
    information = np.random.default_rng(3).uniform(0.2, 3.0, N) * 1e4
    samples = Samples(places(), template, np.stack([gx, gy], axis=1))
    return PhotometricTerm(CAMERA.P, samples, image, information, np.linspace(0.03, 0.07, N), np.array([0.1, -0.03]))


def limit_term() -> LimitTerm:
    return LimitTerm(sigma=0.1)


def rest_term() -> RestTerm:
    return RestTerm(0.3)


def gaussian_term(seed: int = 8, size: float = 0.4) -> GaussianTerm:
    A = np.random.default_rng(9).normal(size=(BODY.dof, BODY.dof))
    return GaussianTerm(random_pose(BODY, seed, size), A @ A.T + np.eye(BODY.dof))


TERMS: list[Callable[[], Term]] = [
    normal_term, ray_term, keypoint_term, photometric_term, limit_term, rest_term, gaussian_term,
]  # fmt: skip


def moved(posed: Posed, delta: Array) -> Posed:
    return Posed(posed.body, posed.pose.retract(delta))


@pytest.mark.parametrize("make", TERMS, ids=lambda f: f.__name__)
def test_gradient_is_the_derivative_of_the_energy(make: Callable[[], Term]) -> None:
    term = make()
    posed = Posed(BODY, random_pose(BODY, size=1.0)) if make is limit_term else POSED
    quadratic = term.linearize(posed)
    assert quadratic.value == pytest.approx(term.energy(posed), rel=1e-12) and quadratic.value > 0.1
    scale = np.abs(quadratic.gradient).max()
    check_jacobian(
        lambda d: np.array(term.energy(moved(posed, d))),
        quadratic.gradient,
        np.zeros(BODY.dof),
        step=1e-6,
        rtol=1e-3,
        atol=(2e-3 if make is photometric_term else 1e-5) * scale,
    )


@pytest.mark.parametrize("size", [1e-6, 0.2, 1.0, 1.7])
def test_gaussian_gradient_holds_far_from_its_mean(size: float) -> None:
    term = gaussian_term(size=size)
    quadratic = term.linearize(POSED)
    check_jacobian(
        lambda d: np.array(term.energy(moved(POSED, d))), quadratic.gradient, np.zeros(BODY.dof), rtol=1e-5, atol=1e-4
    )


@pytest.mark.parametrize("make", TERMS, ids=lambda f: f.__name__)
def test_hessian_is_symmetric_and_positive(make: Callable[[], Term]) -> None:
    H = make().linearize(Posed(BODY, random_pose(BODY, size=1.0)) if make is limit_term else POSED).hessian
    assert H.shape == (BODY.dof, BODY.dof) and np.abs(H).max() > 0
    np.testing.assert_allclose(H, H.T, atol=1e-9 * np.abs(H).max())
    assert np.linalg.eigvalsh(0.5 * (H + H.T)).min() > -1e-9 * np.abs(H).max()


def gauss_newton(residual: Callable[[Array], Array], weight: Array) -> Array:
    J = numeric_jacobian(residual, np.zeros(BODY.dof), 1e-6)
    return J.T @ (weight[:, None] * J)


def check_hessian(term: Term, residual: Callable[[Posed], Array], weight: Array, rtol: float = 1e-5) -> None:
    expected = gauss_newton(lambda d: residual(moved(POSED, d)), weight)
    np.testing.assert_allclose(term.linearize(POSED).hessian, expected, rtol=rtol, atol=rtol * np.abs(expected).max())


def test_hessian_of_normals_is_that_of_its_residuals() -> None:
    term = normal_term()

    def residual(posed: Posed) -> Array:
        return np.sum(term.normal * (CAMERA.project(term.points.at(posed))[0] - term.target), axis=1)

    check_hessian(term, residual, term.weight * cauchy(residual(POSED), 3.0)[1])


def test_hessian_of_keypoints_is_that_of_its_residuals() -> None:
    term = keypoint_term()

    def residual(posed: Posed) -> Array:
        return (CAMERA.project(posed.landmarks)[0] - term.target).T.ravel()

    check_hessian(term, residual, np.tile(term.weight, 2) * cauchy(residual(POSED), 5.0)[1])


def test_hessian_of_rays_is_that_of_all_three_components() -> None:
    """x × n − m has rank 2: the term's two rows must hold what three do."""
    term = ray_term()

    def residual(posed: Posed) -> Array:
        return (term.scale[:, None] * (np.cross(term.points.at(posed), term.direction) - term.moment)).ravel()

    length = np.linalg.norm(residual(POSED).reshape(-1, 3), axis=1)
    assert np.any(length > 3.0) and np.any(length < 3.0)  # both branches of Huber's loss
    check_hessian(term, residual, np.repeat(term.weight * huber(length, 3.0)[1], 3))


def test_hessian_of_brightness_is_that_of_its_residuals() -> None:
    term = photometric_term()

    def residual(posed: Posed) -> Array:
        u, v = CAMERA.project(term.points.at(posed))[0].T
        return sampled(term.image, u, v)[0] - (1.0 + term.exposure[0]) * term.samples.value - term.exposure[1]

    check_hessian(term, residual, term.weight * cauchy(residual(POSED), term.scale)[1], rtol=5e-3)


def test_gaussian_at_its_mean_is_its_information() -> None:
    term = gaussian_term()
    quadratic = term.linearize(Posed(BODY, term.mean))
    np.testing.assert_allclose(quadratic.hessian, term.information, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(quadratic.gradient, 0, atol=1e-9)
    assert quadratic.value == pytest.approx(0, abs=1e-12)


# ---- rows and their sums -----------------------------------------------------------------------------------------


def test_normal_equations_agree_with_their_twin() -> None:
    rng = np.random.default_rng(10)
    rows = Rows(rng.normal(size=(N, 3)), rng.normal(size=N), weights())
    for beside in (None, np.random.default_rng(12).normal(size=(len(rows.residual), 3))):
        found = normal_equations(POSED, places(), rows, beside)
        for fast, slow in zip(found, stacked_rows(POSED, places(), rows, beside), strict=True):
            np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("make", [normal_term, ray_term, photometric_term], ids=lambda f: f.__name__)
def test_energy_kernels_agree_with_the_rows(make: Callable[[], PointTerm]) -> None:
    term = make()
    assert term.energy(POSED) == pytest.approx(term.rows(POSED)[0], rel=1e-12)


def test_point_jacobian_is_the_derivative_of_the_points() -> None:
    p = places(20)
    J = POSED.point_jacobian(p.segments, p.weights, p.local)
    check_jacobian(lambda d: p.at(moved(POSED, d)), J, np.zeros(BODY.dof), atol=1e-7)


def test_no_points_give_nothing() -> None:
    none = places()[np.zeros(N, dtype=bool)]
    term = PointNormalTerm(CAMERA.P, none, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    quadratic = term.linearize(POSED)
    assert quadratic.value == 0 and not np.any(quadratic.hessian) and quadratic.gradient.shape == (BODY.dof,)


def test_projected_rows_agree_with_their_twin_and_with_the_camera() -> None:
    X, direction, target = places().at(POSED), units((N, 2)), off_target()
    residual, gradient = projected_rows(CAMERA.P, X, direction, target)
    expected, expected_gradient = projected_rows_reference(CAMERA.P, X, direction, target)
    np.testing.assert_allclose(residual, expected, atol=1e-10)
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(residual, np.sum(direction * (CAMERA.project(X)[0] - target), axis=1), atol=1e-9)
    check_jacobian(
        lambda x: projected_rows(CAMERA.P, x[None], direction[:1], target[:1])[0][0], gradient[0], X[0], atol=1e-4
    )


def test_points_behind_the_camera_have_no_say() -> None:
    behind = CAMERA.centre[None] + np.array([[3.0, 0.5, 0.2]])
    residual, gradient = projected_rows(CAMERA.P, behind, np.array([[1.0, 0]]), np.zeros((1, 2)))
    assert residual[0] == 0 and not np.any(gradient)


def test_a_rays_residual_is_its_pixel_distance() -> None:
    """Beside a pixel by d px, a point is d px off that pixel's ray when the scale is f/z."""
    X = places().at(POSED)
    pixels, depth = CAMERA.project(X)
    offset = 2.0 * units((N, 2), seed=11)
    direction, moment = CAMERA.rays(pixels + offset)
    term = PointRayTerm(places(), direction, moment, CAMERA.K[0, 0] / depth, np.ones(N), huber_px=1e9)
    distance = np.linalg.norm(term.rows(POSED)[2].residual.reshape(2, -1), axis=0)
    # f differs by 3 % between x and y, and off the axis a ray is up to 1/cos farther from z: 0.87 here.
    np.testing.assert_allclose(distance, 2.0, rtol=0.14)
    central = np.linalg.norm(pixels - CAMERA.K[:2, 2], axis=1) < 40
    np.testing.assert_allclose(distance[central], 2.0, rtol=0.05)
    assert central.sum() > 5
    assert term.energy(POSED) == pytest.approx(0.5 * np.sum(distance**2))


def test_rays_and_normals_pull_alike() -> None:
    """For the same partners along the normals both terms want nearly the same first step."""
    n = 600
    points = places(n)
    pixels, depth = CAMERA.project(points.at(POSED))
    normals = units((n, 2), seed=12)
    shift = pixels + np.array([1.5, -0.7])
    direction, moment = CAMERA.rays(shift)
    ray = PointRayTerm(points, direction, moment, CAMERA.K[0, 0] / depth, np.ones(n), 1e9)
    normal = PointNormalTerm(CAMERA.P, points, shift, normals, np.ones(n), 1e9)
    steps = []
    for term in (ray, normal):
        q = term.linearize(POSED)
        steps.append(-np.linalg.solve(q.hessian + 1e-3 * np.diag(np.diag(q.hessian)), q.gradient))
    for step in steps:
        after = CAMERA.project(points.at(moved(POSED, step)))[0]
        assert np.linalg.norm(after - shift, axis=1).mean() < 0.3 * np.linalg.norm([1.5, -0.7])


# ---- brightness --------------------------------------------------------------------------------------------------


def wave() -> Array:
    y, x = np.mgrid[:240, :320].astype(float)
    return (0.5 + 0.2 * np.sin(x / 9) * np.cos(y / 11)).astype(np.float32)


def test_samples_are_those_of_the_analytic_image() -> None:
    rng = np.random.default_rng(13)
    x, y = rng.uniform(5, 310, 200), rng.uniform(5, 230, 200)
    value, gx, gy, valid = sampled(wave(), x, y)
    assert np.all(valid == 1)
    np.testing.assert_allclose(value, 0.5 + 0.2 * np.sin(x / 9) * np.cos(y / 11), atol=1e-3)
    np.testing.assert_allclose(gx, 0.2 / 9 * np.cos(x / 9) * np.cos(y / 11), atol=2e-4)
    np.testing.assert_allclose(gy, -0.2 / 11 * np.sin(x / 9) * np.sin(y / 11), atol=2e-4)


def test_samples_off_the_image_are_not_valid() -> None:
    x, y = np.array([-1e6, 0.5, 318.5, 50.0, 50.0, 50.0]), np.array([50.0, 50.0, 50.0, 0.5, 238.5, 50.0])
    assert sampled(wave(), x, y)[3].tolist() == [0, 0, 0, 0, 0, 1]


def test_samples_at_many_pixels_are_those_at_each() -> None:
    rng = np.random.default_rng(13)
    pixels = np.stack([rng.uniform(-5, 330, 300), rng.uniform(-5, 250, 300)], axis=1)
    value, gradient = photometric.sampled(wave(), pixels)
    expected, gx, gy, valid = sampled(wave(), *pixels.T)
    assert 0.5 < valid.mean() < 1.0
    np.testing.assert_array_equal(value, np.where(valid, expected, np.nan))
    np.testing.assert_array_equal(gradient, np.stack([gx, gy], axis=1))


def test_mean_of_both_gradients_is_right_to_second_order() -> None:
    """Going back to the template's place changes brightness by what the mean gradient says, with error O(d³)."""
    X = places().at(POSED)
    u, v = CAMERA.project(X)[0].T
    template, gx, gy, _ = sampled(wave(), u, v)
    step = np.array([0.02, -0.03, 0.025])
    there = moved(POSED, np.concatenate([np.zeros(3), step, np.zeros(BODY.dof - 6)]))
    here = np.stack(sampled(wave(), *CAMERA.project(X + step)[0].T)[1:3], axis=1)
    same, one = np.zeros(EXPOSURE), np.ones(N)
    first = np.stack([gx, gy], axis=1)
    mean = Samples(places(), template, first).rows(there, CAMERA.P, wave(), same, one)
    own = Samples(places(), template, here).rows(there, CAMERA.P, wave(), same, one)
    assert np.abs(mean.residual).mean() > 0.02
    error_of_mean, error_of_one = (np.abs(rows.gradient @ step - rows.residual) for rows in (mean, own))
    assert error_of_mean.mean() < 0.35 * error_of_one.mean()


def test_photometric_energy_is_zero_where_the_template_was_taken() -> None:
    term = replace(photometric_term(offset=0.0), exposure=np.zeros(EXPOSURE))
    assert term.energy(POSED) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(term.linearize(POSED).gradient, 0, atol=1e-6)


# ---- priors, losses, sums ----------------------------------------------------------------------------------------


def test_limits_cost_nothing_inside_and_one_sigma_costs_a_half() -> None:
    pose = Pose.rest(BODY)
    assert LimitTerm().energy(Posed(BODY, pose)) == 0
    k = BODY.coordinate("elbow_flex_r")
    pose.q[k] = BODY.limits[k, 1] + LimitTerm().sigma
    quadratic = LimitTerm().linearize(Posed(BODY, pose))
    assert quadratic.value == pytest.approx(0.5)
    assert quadratic.gradient[6 + k] > 0 and np.count_nonzero(quadratic.gradient) == 1
    pose.q[k] = BODY.limits[k, 0] - LimitTerm().sigma
    assert LimitTerm().linearize(Posed(BODY, pose)).gradient[6 + k] < 0


@pytest.mark.parametrize("loss", [huber, cauchy])
def test_robust_losses_start_as_squares_and_their_weight_is_the_slope(loss: Callable) -> None:
    r = np.linspace(-8, 8, 81)
    energy, weight = loss(r, 2.0)
    slope = (loss(r + 1e-6, 2.0)[0] - loss(r - 1e-6, 2.0)[0]) / 2e-6
    np.testing.assert_allclose(weight * r, slope, atol=1e-6)
    np.testing.assert_allclose(loss(np.array([1e-4]), 2.0)[0], 0.5e-8, rtol=1e-6)
    assert np.all(np.diff(energy[r >= 0]) > 0) and np.all((weight > 0) & (weight <= 1)) and weight[0] < 0.3


def test_quadratics_add() -> None:
    a, b = normal_term().linearize(POSED), gaussian_term().linearize(POSED)
    total = Quadratic.zero(BODY.dof) + a + b
    assert total.value == pytest.approx(a.value + b.value)
    np.testing.assert_allclose(total.gradient, a.gradient + b.gradient)
    np.testing.assert_allclose(total.hessian, a.hessian + b.hessian)
