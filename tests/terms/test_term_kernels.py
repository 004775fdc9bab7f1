"""Kernels of the terms against their readable twins."""

from __future__ import annotations

import numpy as np
import pytest

from support.shapes import camera_at
from support.twins import check_twin
from twistcap import se3
from twistcap.terms import accumulate, photometric, points
from twistcap.terms.robust import weighted_cauchy

P = camera_at((2.8, 0.7, 0.4)).P
S, N, K = 5, 40, 3


def surface(seed: int = 0) -> tuple[np.ndarray, ...]:
    """Points on five segments; some have fewer than three, some lie far off the image and some behind the camera."""
    rng = np.random.default_rng(seed)
    segments = np.argsort(rng.uniform(size=(N, S)), axis=1)[:, :K].astype(np.int32)
    weights = rng.dirichlet(np.ones(K), N)
    weights[::4, 1:], weights[::4, 0] = 0.0, 1.0
    local = rng.uniform(-0.5, 0.5, (N, 3))
    local[::7] *= 6.0
    local[3] = [6.0, 1.5, 0.9]
    return se3.exp(0.1 * rng.normal(size=(S, 6))), segments, weights, local


def row_weights(count: int) -> np.ndarray:
    weight = np.random.default_rng(3).uniform(0.2, 3.0, count)
    weight[::5] = 0.0
    return weight


def image() -> np.ndarray:
    return np.random.default_rng(4).uniform(size=(240, 320)).astype(np.float32)


@pytest.mark.parametrize("turns", [1, 2])
def test_rows_are_summed_as_by_the_twin(turns: int) -> None:
    rng = np.random.default_rng(1)
    gradient, residual, weight = rng.normal(size=(turns * N, 3)), rng.normal(size=turns * N), row_weights(turns * N)
    gradient[weight == 0.0] = np.nan
    beside = rng.normal(size=(turns * N, 4))
    blocks, vector, cross = np.zeros((S, S, 6, 8)), np.ones((S, 6)), np.zeros((S, 6, 4))  # sums go on
    check_twin(accumulate.accumulate, surface(), gradient, residual, weight, blocks, vector)
    check_twin(accumulate.accumulate_beside, surface(), gradient, weight, beside, cross)
    accumulate.accumulate(surface(), gradient, residual, weight, blocks, vector)
    assert np.abs(blocks).max() > 1


def test_points_are_carried_and_projected_as_by_the_twins() -> None:
    behind = 0
    for n in range(N):
        check_twin(accumulate.skinned_point, *surface(), n)
        behind += check_twin(accumulate.projected_point, P, *surface(), n)[2] == 0.0
    assert 0 < behind < N


@pytest.mark.parametrize("x", [-1.0, 0.99, 1.0, 7.3, 160.0, 317.99, 318.0, 400.0, np.nan])
@pytest.mark.parametrize("y", [1.0, 100.6, 237.99, 238.0])
def test_images_are_read_as_by_the_twin(x: float, y: float) -> None:
    check_twin(photometric.sample, image(), x, y, atol=1e-6)
    check_twin(photometric.brightness_at, image(), x, y, atol=1e-6)


@pytest.mark.parametrize("spoilt", [False, True])
def test_brightness_is_compared_as_by_the_twins(spoilt: bool) -> None:
    """Off the image, behind the camera, without weight, and with NaN in the image."""
    rng, picture, exposure = np.random.default_rng(5), image(), np.array([0.1, -0.02])
    if spoilt:
        picture[110:130] = np.nan
    value, gradient, weight, scale = rng.uniform(size=N), rng.normal(size=(N, 2)), row_weights(N), rng.uniform(size=N)
    seen = (surface(), P, picture, value)
    residual = check_twin(photometric.photometric_residuals, *seen, exposure, rtol=1e-5, atol=1e-6)
    check_twin(photometric.photometric_rows, *seen, gradient, exposure, weight, rtol=1e-4, atol=1e-5)
    check_twin(photometric.photometric_energy, *seen, exposure, weight, scale + 0.1, rtol=1e-5)
    assert 0 < np.isnan(residual).sum() < N


def test_contour_rows_and_energies_are_those_of_the_twins() -> None:
    rng, weight = np.random.default_rng(6), row_weights(N)
    world = rng.uniform(-0.5, 0.5, (N, 3))
    world[3] = [6.0, 1.5, 0.9]
    normal, direction = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (world[:, :2], rng.normal(size=(N, 3))))
    moment, target = np.cross(world + 0.03 * rng.normal(size=(N, 3)), direction), rng.uniform(0, 300, (N, 2))
    rays = (direction, moment, rng.uniform(80, 130, N), weight, 3.0)
    residual, _ = check_twin(points.projected_rows, P, world, normal, target)
    assert residual[3] == 0.0  # behind the camera
    check_twin(points.ray_rows, world, *rays)
    check_twin(points.normal_energy, surface(), P, normal, target, weight, 3.0)
    check_twin(points.ray_energy, surface(), *rays)


def test_cauchys_loss_is_that_of_the_twin() -> None:
    residual, weight = np.random.default_rng(7).normal(size=N), row_weights(N)
    residual[weight == 0.0] = np.nan
    check_twin(weighted_cauchy, residual, weight, 0.5)
    residual[1] = np.nan
    assert np.isnan(weighted_cauchy(residual, weight, 0.5)[0])
