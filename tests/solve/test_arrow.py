"""The arrow system: against the dense matrix and against stacked rows."""

from __future__ import annotations

import numpy as np
import pytest

from support.blocks import whole_matrix
from twistcap.errors import InputError
from twistcap.solve import Arrow

Array = np.ndarray


@pytest.mark.parametrize(("frames", "reach"), [(7, 2), (9, 4), (3, 5)])
def test_the_arrow_is_solved_as_the_dense_matrix(frames: int, reach: int) -> None:
    rng = np.random.default_rng(0)
    D, K, N = 4, 3, 9
    arrow = Arrow(frames, D, K, reach)
    for t in range(frames):
        met = tuple(range(t, min(t + reach + 1, frames)))[:: max(1, reach // 2)]
        J = tuple(rng.normal(size=(N, D)) for _ in met)
        arrow.add_rows(met, J, rng.normal(size=(N, K)), rng.uniform(0.1, 1, N), rng.normal(size=N))
        arrow.add_pose(t, rng.normal(size=D), np.eye(D))
    arrow.corner += np.eye(K)
    marginals, inverse = arrow.marginals(), np.linalg.inv(whole_matrix(arrow))
    step = -inverse @ np.concatenate([arrow.pull.ravel(), arrow.shared_pull])
    arrow.longest = arrow.shared_longest = np.inf
    np.testing.assert_allclose(arrow.step(), step, atol=1e-12)
    blocks = [inverse[t * D : (t + 1) * D, t * D : (t + 1) * D] for t in range(frames)]
    np.testing.assert_allclose(marginals.poses, blocks, atol=1e-12)
    np.testing.assert_allclose(marginals.shared, inverse[frames * D :, frames * D :], atol=1e-12)


def test_rounding_does_not_grow_along_a_long_track() -> None:
    """Accelerations over some hundred frames, as in `refine`: variances became negative, and as large as 1e9."""
    rng, (F, D) = np.random.default_rng(2), (300, 4)
    arrow = Arrow(F, D, 1, 2)
    arrow.corner[:] = 1.0
    for t in range(F):
        J = rng.normal(size=(D, D))
        arrow.add_pose(t, np.zeros(D), J.T @ J)
        if t + 2 < F:
            turn = np.linalg.qr(rng.normal(size=(D, D)))[0]
            J = tuple(k * turn for k in (1.0, -2.0, 1.0))
            arrow.add_rows((t, t + 1, t + 2), J, np.zeros((D, 1)), np.full(D, 10.0), np.zeros(D))
    inverse, found = np.linalg.inv(whole_matrix(arrow)), arrow.marginals().poses
    blocks = [inverse[t * D : (t + 1) * D, t * D : (t + 1) * D] for t in range(F)]
    np.testing.assert_allclose(found, blocks, rtol=1e-6, atol=1e-9)


def test_rows_add_up_to_the_least_squares_of_all() -> None:
    """Against stacked rows: signs, order and the coupling of frames and border."""
    rng = np.random.default_rng(1)
    D, K, N = 3, 2, 8
    arrow, rows, right, weights = Arrow(3, D, K, 2), list[Array](), list[Array](), list[Array]()
    for met in ((0,), (0, 1), (0, 2), (0, 1, 2), (1, 2)):
        J = tuple(rng.normal(size=(N, D)) for _ in met)
        S, weight, residual = rng.normal(size=(N, K)), rng.uniform(0.5, 2, N), rng.normal(size=N)
        arrow.add_rows(met, J, S, weight, residual)
        row = np.zeros((N, 3 * D + K))
        for t, j in zip(met, J, strict=True):
            row[:, t * D : (t + 1) * D] = j
        row[:, 3 * D :] = S
        rows, right, weights = [*rows, row], [*right, residual], [*weights, weight]
    A, b, w = np.concatenate(rows), np.concatenate(right), np.sqrt(np.concatenate(weights))
    arrow.longest = arrow.shared_longest = np.inf
    expected = np.linalg.lstsq(w[:, None] * A, -w * b)[0]
    np.testing.assert_allclose(arrow.step(), expected, atol=1e-9)


def test_what_nothing_tells_is_refused() -> None:
    with pytest.raises(InputError, match="do not determine a pose or a length"):
        Arrow(3, 2, 1, 2).marginals()
    assert Arrow(3, 2, 1, 2).step(0.1) is None


def test_long_steps_are_shortened_pose_by_pose() -> None:
    arrow = Arrow(3, 2, 1, 1)
    arrow.band[:, 0], arrow.corner[:], arrow.shared_longest = np.eye(2), 1.0, 0.1
    arrow.pull[:] = [[0.5, -0.2], [4.0, 2.0], [0.0, 1.0]]
    arrow.shared_pull[:] = -3.0
    step = arrow.step()
    assert step is not None
    poses, shared = step[: arrow.pull.size].reshape(arrow.pull.shape), step[arrow.pull.size :]
    np.testing.assert_allclose(poses, [[-0.5, 0.2], [-1.0, -0.5], [0.0, -1.0]])
    np.testing.assert_allclose(shared, 0.1)
