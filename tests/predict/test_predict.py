"""Predictors: screw motions go on exactly, whatever the time that passes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twistcap import se3
from twistcap.body import Pose
from twistcap.predict.history import Moment, MotionNoise, MotionSpread, Past, constant_velocity
from twistcap.predict.inertia import Inertia

J = 4
XI = np.array([0.9, -1.4, 2.0, 0.8, 0.3, -0.5])
RATE = np.array([1.0, -0.5, 2.0, 0.0])


def on_screw(time: float, xi: np.ndarray = XI, rate: np.ndarray = RATE) -> Pose:
    """Constant spatial twist of the root, constant joint speeds, from a start of no symmetry."""
    start = se3.exp([0.4, 0.2, -1.0, 1.0, 2.0, 0.5])
    return Pose(se3.exp(time * xi) @ start, np.array([0.1, 0.2, -0.3, 0.7]) + time * rate)


def history(*times: float) -> list[Moment]:
    return [Moment(t, on_screw(t)) for t in times]


def assert_same(a: Pose, b: Pose, tolerance: float = 1e-10) -> None:
    assert np.abs(a.minus(b)).max() < tolerance


@given(
    arrays(float, 6, elements=st.floats(-3, 3)),
    arrays(float, J, elements=st.floats(-5, 5)),
    st.floats(0.005, 0.2),
    st.floats(0.005, 0.4),
)
@settings(deadline=None, max_examples=60)
def test_a_screw_motion_goes_on_exactly(xi: np.ndarray, rate: np.ndarray, before: float, after: float) -> None:
    moments = [Moment(t, on_screw(t, xi, rate)) for t in (1.0, 1.0 + before)]
    predicted = constant_velocity(moments, 1.0 + before + after)
    assert_same(predicted, on_screw(1.0 + before + after, xi, rate), 1e-9)


@pytest.mark.parametrize("times, time", [((0.0, 0.02), 0.08), ((0.0, 0.06), 0.08), ((0.0, 0.02, 0.1), 0.12)])
def test_dropped_frames_count_by_their_time(times: tuple[float, ...], time: float) -> None:
    assert_same(constant_velocity(history(*times), time), on_screw(time))


def test_only_the_last_two_moments_count() -> None:
    odd = [Moment(0.0, on_screw(7.0)), *history(0.1, 0.12)]
    assert_same(constant_velocity(odd, 0.14), on_screw(0.14))


def test_hold_holds() -> None:
    moments = history(0.0, 0.02)
    past = Past(tuple(moments), 0.02, True, MotionSpread.usual(MotionNoise()))
    assert Inertia(hold=True).pose(past, 0.5) is moments[-1].pose
    assert np.abs(Inertia().pose(past, 0.04).root - on_screw(0.04).root).max() < 1e-10


def test_one_moment_or_no_time_holds() -> None:
    moments = history(0.0, 0.02)
    assert constant_velocity(moments[:1], 0.3) is moments[0].pose
    assert constant_velocity(moments, 0.02) is moments[1].pose
    assert constant_velocity(moments, 0.01) is moments[1].pose  # a clock that went back is no reason to extrapolate


def test_noise_grows_with_time_as_its_predictor_says() -> None:
    noise, centre = MotionNoise(), np.zeros(3)
    fast = [noise.covariance(6 + J, dt, "constant_velocity", centre)[0] for dt in (0.02, 0.04)]
    np.testing.assert_allclose(fast[1], 16 * fast[0])  # σ = a dt²
    np.testing.assert_allclose(
        np.sqrt(np.diag(fast[0]))[[0, 3, 6]], np.array([noise.turn, noise.shift, noise.joint]) * 0.02**2
    )
    held = [noise.covariance(6 + J, dt, "hold", centre)[0] for dt in (0.02, 0.04)]
    np.testing.assert_allclose(held[1], 4 * held[0])  # σ = v dt
    np.testing.assert_allclose(np.sqrt(np.diag(held[0]))[[0, 3, 6]], np.array([2.0, 1.5, 4.0]) * 0.02)


@pytest.mark.parametrize("predictor", ["constant_velocity", "hold"])
def test_the_root_turns_about_the_bodys_centre(predictor: str) -> None:
    """At the centre only the shift is felt; elsewhere the turn adds its lever."""
    noise, centre, dt = MotionNoise(), np.array([2.0, -1.0, 0.9]), 0.02
    C, information = noise.covariance(6 + J, dt, predictor, centre)
    np.testing.assert_allclose(information @ C, np.eye(6 + J), atol=1e-9)
    np.testing.assert_allclose(C, C.T)
    assert np.linalg.eigvalsh(C).min() > 0

    def at(x: np.ndarray) -> np.ndarray:
        A = np.concatenate([-se3.hat(x), np.eye(3)], axis=1)
        return A @ C[:6, :6] @ A.T

    plain, _ = noise.covariance(6 + J, dt, predictor, np.zeros(3))
    np.testing.assert_allclose(at(centre), plain[3:6, 3:6], atol=1e-12 * plain.max())
    lever = at(centre + np.array([0, 0, 0.5])) - at(centre)
    np.testing.assert_allclose(np.diag(lever), [0.25 * plain[0, 0], 0.25 * plain[0, 0], 0], atol=1e-9 * plain[0, 0])


def test_a_body_that_moves_more_than_usual_is_given_room() -> None:
    noise, dt, centre = MotionNoise(allowance=3.0, memory=0.5), 0.02, on_screw(0.0).root[:3, 3]
    spread, usual = MotionSpread.usual(noise), noise.covariance(6 + J, dt, "constant_velocity", centre)[0]
    still, sigma = on_screw(0.0), noise.joint * dt * dt
    for _ in range(20):  # joints stray as far as usual, the root not at all
        spread = spread.learnt(still, still.retract(np.r_[np.zeros(6), np.full(J, sigma)]), dt, "constant_velocity")
    covariance, information = spread.covariance(6 + J, dt, "constant_velocity", centre)
    np.testing.assert_allclose(covariance[6:, 6:], 9.0 * usual[6:, 6:], rtol=1e-4)
    np.testing.assert_allclose(covariance[:6, :6], usual[:6, :6])
    np.testing.assert_allclose(covariance @ information, np.eye(6 + J), atol=1e-9)
    for _ in range(20):
        spread = spread.learnt(still, still, dt, "constant_velocity")
    np.testing.assert_allclose(spread.covariance(6 + J, dt, "constant_velocity", centre)[0], usual)


def test_the_spread_does_not_depend_on_where_the_world_begins() -> None:
    """A root that turns about the body's own centre has not shifted, wherever it stands."""
    noise, dt, still = MotionNoise(), 0.02, on_screw(0.0)
    centre = still.root[:3, 3]
    turn = np.array([0.1, -0.2, 0.3])
    turned = still.retract(np.r_[turn, -np.cross(turn, centre), np.zeros(J)])
    before = MotionSpread.usual(noise)
    after = before.learnt(still, turned, dt, "constant_velocity")
    np.testing.assert_allclose(turned.root[:3, 3], centre, atol=1e-12)
    here = np.zeros(3)
    found, usual = (s.covariance(6 + J, dt, "constant_velocity", here)[0] for s in (after, before))
    np.testing.assert_allclose(found[3:, 3:], usual[3:, 3:], rtol=1e-6)
    assert np.all(np.diag(found[:3, :3]) > 2.0 * np.diag(usual[:3, :3]))
