"""Rigid motions: round trips, identities and derivatives, at every angle where a formula changes."""

from __future__ import annotations

import numpy as np
import pytest
import pytransform3d.transformations as oracle
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from support.finite_differences import check_jacobian
from support.twins import check_twin
from twistcap import se3

settings.register_profile("twistcap", deadline=None, max_examples=60)
settings.load_profile("twistcap")

ANGLES = [0.0, 1e-9, 1e-6, 1e-4 * 0.999, 1e-4 * 1.001, 1e-3, 0.00999, 0.0101, 0.299, 0.301, 0.999, 1.001, 2.0]
NEAR_PI = [np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9]
UNIT = arrays(float, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 1e-2)
SHIFT = arrays(float, 3, elements=st.floats(-5, 5))
ANGLE = st.one_of(st.sampled_from(ANGLES + NEAR_PI), st.floats(0, np.pi - 1e-9))


@st.composite
def twists(draw: st.DrawFn) -> np.ndarray:
    axis = draw(UNIT)
    return np.concatenate([draw(ANGLE) * axis / np.linalg.norm(axis), draw(SHIFT)])


def twist(angle: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    return np.concatenate([angle * axis / np.linalg.norm(axis), rng.normal(size=3)])


@given(twists())
def test_log_undoes_exp(xi: np.ndarray) -> None:
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, rtol=1e-9, atol=1e-13 + 1e-12 * np.linalg.norm(xi[3:]))


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-6, 1e-4, 1e-3])
def test_small_rotations_keep_their_relative_precision(angle: float) -> None:
    xi = twist(angle)
    np.testing.assert_allclose(se3.log(se3.exp(xi))[:3], xi[:3], rtol=1e-9, atol=0)


@given(twists())
def test_exp_gives_motions_and_agrees_with_the_oracle(xi: np.ndarray) -> None:
    T = se3.exp(xi)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(T @ se3.inverse(T), np.eye(4), atol=1e-13)
    np.testing.assert_allclose(T, oracle.transform_from_exponential_coordinates(xi), atol=2e-9)
    np.testing.assert_allclose(se3.exp_rotation(xi[:3]), T[:3, :3], atol=1e-15)


@given(twists())
def test_a_screw_is_the_power_series(xi: np.ndarray) -> None:
    """exp by its definition, in steps small enough for the series to converge at once."""
    X = np.zeros((4, 4))
    X[:3, :3], X[:3, 3] = se3.hat(xi[:3]), xi[3:]
    small, term = np.eye(4), np.eye(4)
    for n in range(1, 15):
        term = term @ X / 64 / n
        small = small + term
    np.testing.assert_allclose(se3.exp(xi), np.linalg.matrix_power(small, 64), atol=1e-11)


@given(UNIT, SHIFT)
def test_log_of_half_a_turn_gives_the_motion_back(axis: np.ndarray, shift: np.ndarray) -> None:
    """At π the axis' sign is open, the motion is not."""
    n = axis / np.linalg.norm(axis)
    T = se3.transform(2 * np.outer(n, n) - np.eye(3), shift)
    xi = se3.log(T)
    assert abs(np.linalg.norm(xi[:3]) - np.pi) < 1e-9
    np.testing.assert_allclose(se3.exp(xi), T, atol=1e-12)


@given(twists())
def test_log_one_is_log(xi: np.ndarray) -> None:
    T = se3.exp(xi)
    np.testing.assert_allclose(se3.log_one(T), se3.log(T), rtol=1e-12, atol=1e-14)


def test_log_agrees_with_the_oracle() -> None:
    for angle in [1e-3, 0.3, 1.0, 3.0]:
        T = se3.exp(twist(angle, seed=3))
        np.testing.assert_allclose(se3.log(T), oracle.exponential_coordinates_from_transform(T), atol=1e-9)


@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3), (0,)])
def test_batches_are_single_results_stacked(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    xi = rng.normal(size=(*batch, 6))
    for f in (se3.exp, se3.adjoint, se3.left_jacobian):
        x = se3.exp(xi) if f is se3.adjoint else xi
        result = f(x)
        assert result.shape[: len(batch)] == batch
        for i in np.ndindex(batch):
            np.testing.assert_allclose(result[i], f(x[i]), atol=1e-13)
    T = se3.exp(xi)
    assert se3.log(T).shape == (*batch, 6) and se3.inverse(T).shape == (*batch, 4, 4)
    for i in np.ndindex(batch):
        np.testing.assert_allclose(se3.log(T)[i], se3.log(T[i]), atol=1e-14)
        np.testing.assert_allclose(se3.inverse(T)[i], np.linalg.inv(T[i]), atol=1e-13)
        np.testing.assert_allclose(se3.inverse_left_jacobian(xi)[i], se3.inverse_left_jacobian(xi[i]), atol=1e-11)


def test_apply_moves_points_of_each_motion() -> None:
    rng = np.random.default_rng(2)
    T, points = se3.exp(rng.normal(size=(2, 6))), rng.normal(size=(2, 5, 3))
    homogeneous = np.concatenate([points, np.ones((2, 5, 1))], axis=-1)
    np.testing.assert_allclose(se3.apply(T, points), np.einsum("bij,bnj->bni", T, homogeneous)[..., :3], atol=1e-14)


@given(UNIT, SHIFT)
def test_hat_is_the_cross_product_and_vee_its_inverse(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(se3.hat(a) @ b, np.cross(a, b), atol=1e-14)
    np.testing.assert_array_equal(se3.vee(se3.hat(a)), a)


@given(twists(), twists())
def test_adjoint_carries_twists(g: np.ndarray, xi: np.ndarray) -> None:
    G = se3.exp(g)
    carried = G @ se3.exp(xi) @ se3.inverse(G)
    np.testing.assert_allclose(se3.exp(se3.adjoint(G) @ xi), carried, atol=1e-11)
    np.testing.assert_allclose(se3.adjoint(G), oracle.adjoint_from_transform(G, check=False), atol=1e-12)


def test_bracket_is_the_derivative_of_the_adjoint() -> None:
    xi = twist(0.7)
    eye = se3.adjoint(np.eye(4))
    np.testing.assert_allclose((se3.adjoint(se3.exp(1e-7 * xi)) - eye) / 1e-7, se3.bracket_matrix(xi), atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.0999, 0.101, 0.9999, 1.0001, 2.5, np.pi - 1e-3, np.pi])
def test_left_jacobian_is_a_derivative(angle: float) -> None:
    """exp(ξ + δ) exp(−ξ) ≈ exp(J δ); the products stay near the identity, so no angle is special to the check."""
    xi = twist(angle, seed=4)
    back = se3.inverse(se3.exp(xi))
    J = se3.left_jacobian(xi)
    check_jacobian(lambda x: se3.log(se3.exp(x) @ back), J, xi, step=1e-4, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(J, oracle.left_jacobian_SE3(xi), atol=1e-8)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.0999, 0.101, 0.9999, 1.0001, 2.5, np.pi - 1e-3])
def test_inverse_left_jacobian_is_the_derivative_of_log(angle: float) -> None:
    xi = twist(angle, seed=5)
    T = se3.exp(xi)
    inverse = se3.inverse_left_jacobian(xi)
    np.testing.assert_allclose(inverse @ se3.left_jacobian(xi), np.eye(6), atol=1e-11)
    # Short steps: near π the logarithm must not cross its cut, 1e-3 away.
    check_jacobian(lambda d: se3.log(se3.exp(d) @ T), inverse, np.zeros(6), step=1e-4, rtol=1e-5, atol=1e-5)


def test_left_jacobian_has_no_seam_between_series_and_closed_form() -> None:
    below, above = (se3.left_jacobian(twist(a, seed=6)) for a in (1 - 1e-12, 1 + 1e-12))
    np.testing.assert_allclose(below, above, atol=1e-11)


@given(twists(), st.floats(0, 1))
def test_scaling_a_motion_is_going_part_of_the_way(xi: np.ndarray, part: float) -> None:
    """exp(s log T) exp((1 − s) log T) = T, and s and 1 − s commute."""
    whole = se3.log(se3.exp(xi))
    first, second = se3.exp(part * whole), se3.exp((1 - part) * whole)
    np.testing.assert_allclose(first @ second, se3.exp(xi), atol=1e-12)
    np.testing.assert_allclose(second @ first, se3.exp(xi), atol=1e-12)


@given(twists(), arrays(float, (3, 3), elements=st.floats(-1e-3, 1e-3)))
def test_orthonormalised_is_the_nearest_rotation(xi: np.ndarray, noise: np.ndarray) -> None:
    T = se3.exp(xi)
    off = T.copy()
    off[:3, :3] += noise
    back = se3.orthonormalised(off)
    R = back[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(R) > 0
    np.testing.assert_array_equal(back[:3, 3], T[:3, 3])
    np.testing.assert_allclose(R.T @ off[:3, :3], (R.T @ off[:3, :3]).T, atol=1e-12)  # the polar factor's mark
    np.testing.assert_allclose(se3.orthonormalised(T), T, atol=1e-13)


def test_orthonormalised_never_mirrors() -> None:
    mirrored = np.diag([1.0, 1.0, -1e-3, 1.0])
    batch = se3.orthonormalised(np.stack([mirrored, np.eye(4)]))
    np.testing.assert_allclose(np.linalg.det(batch[:, :3, :3]), 1.0)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1e-2, 0.031, 0.032, 0.29, 0.31, 1.0, 3.1])
def test_single_versions_agree_with_the_batched_ones(size: float) -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        turn = rng.normal(size=3)
        xi = np.concatenate([size * turn / np.linalg.norm(turn), rng.normal(size=3)])
        other = se3.exp(rng.normal(size=6))
        motion = check_twin(se3.exp_one, xi, rtol=0, atol=2e-14)
        check_twin(se3.log_one, motion, rtol=0, atol=1e-12)
        check_twin(se3.inverse_one, other, rtol=0, atol=1e-14)
        check_twin(se3.compose_one, motion, other, rtol=0, atol=1e-14)
        check_twin(se3.difference_one, motion @ other, other, rtol=0, atol=1e-12)
        np.testing.assert_allclose(se3.difference_one(motion @ other, other), xi, atol=1e-12)
        check_twin(se3.inverse_left_jacobian_one, xi, rtol=0, atol=1e-11)


def test_composition_brings_a_rotation_back_that_rounding_carried_off() -> None:
    off = se3.exp(np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0])) + 1e-6 * np.random.default_rng(0).normal(size=(4, 4))
    R = se3.compose_one(off, np.eye(4))[:3, :3]
    assert np.abs(R.T @ R - np.eye(3)).max() < 1e-10 < np.abs(off[:3, :3].T @ off[:3, :3] - np.eye(3)).max()
