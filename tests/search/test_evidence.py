"""Absolute evidence: kernels against readable twins, and the truth against other poses."""

from __future__ import annotations

import numpy as np
import pytest

from support.twins import check_twin
from twistcap.arrays import Float, Float32, Int
from twistcap.camera import Camera
from twistcap.search.backdrop import (
    Backdrop,
    Background,
    background_of,
    over_time,
    small_camera,
    small_features,
    with_lesson,
)
from twistcap.search.evidence import (
    covered_evidence,
    covered_evidence_reference,
    evidence_maps,
    evidence_maps_reference,
    sampled_evidence,
    sampled_evidence_reference,
)
from twistcap.search.placing import moved_evidence, points_evidence


def _scene(rng: np.random.Generator) -> tuple[Float32, Background, Float, Int]:
    features = rng.random((14, 18, 3)).astype(np.float32)
    mean, variance = rng.random((7, 9, 3)).astype(np.float32), rng.uniform(0.001, 0.1, (7, 9, 3)).astype(np.float32)
    known = rng.random((7, 9)) < 0.7
    moments = rng.random((4, 3))
    colours = np.concatenate([rng.random((4, 1)), moments, moments**2 + rng.uniform(0, 0.1, (4, 3))], axis=1)
    part = rng.integers(-1, 4, (14, 18)).astype(np.int32)
    return features, background_of(mean, variance, known), colours, part


def test_kernels_are_their_readable_twins() -> None:
    rng = np.random.default_rng(0)
    features, background, colours, part = _scene(rng)
    small = np.ascontiguousarray(features[::2, ::2])
    weights = rng.random(5)
    palette = weights / weights.sum(), rng.random((5, 3)), rng.uniform(0.01, 0.1, (5, 3))
    maps = evidence_maps(small, background, palette, colours, 3.0)
    np.testing.assert_allclose(maps, evidence_maps_reference(small, background, palette, colours, 3.0), atol=1e-4)
    grid = (2, 1, 0.45, 2)
    for beside in (True, False):
        now = sampled_evidence(features, part, grid, background, palette, colours, 3.0, beside)
        twin = sampled_evidence_reference(features, part, grid, background, palette, colours, 3.0, beside)
        for a, b in zip(now, twin, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-4)
        assert now[0][:2].any() and now[0][2].any() == now[1].any() == beside
    P = np.concatenate([np.diag([4.0, 4.0, 1.0]), np.array([[5.0], [3.0], [2.0]])], axis=1)
    points, of, offsets = rng.normal(size=(30, 3)), rng.integers(0, 4, 30).astype(np.int32), rng.normal(size=(6, 3))
    check_twin(moved_evidence, maps, P, points, of, offsets, 0.5, rtol=1e-5)
    close = points * [1e-3, 1e-3, 0.0] + [0.0, 0.0, 1e-3 - P[2, 3]]  # a thousandth of a metre from the camera
    at_most = 4.0 * np.abs(maps).max() * len(points)
    assert np.abs(moved_evidence(maps, P, close, of, np.zeros((1, 3)), 0.5)).max() <= at_most
    check_twin(points_evidence, maps, P, points.reshape(3, 10, 3), of[:10], rtol=1e-5)
    labels = np.ascontiguousarray(part[::2, ::2])
    for a, b in zip(covered_evidence(maps, labels), covered_evidence_reference(maps, labels), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5)


def test_a_lesson_and_what_it_says_are_their_readable_twins() -> None:
    rng = np.random.default_rng(1)
    features, off = rng.random((9, 11, 3)).astype(np.float32), rng.random((9, 11)) < 0.6
    sums = np.zeros((9, 11, 7), np.float32)
    for _ in range(3):
        sums = check_twin(
            with_lesson, sums, features + rng.normal(0, 0.01, features.shape).astype(np.float32), off, 0.9
        )
    mean, variance = check_twin(over_time, sums, atol=1e-6)
    np.testing.assert_array_equal(mean[sums[..., 0] == 0], 0.0)
    check_twin(background_of, mean, variance + np.float32(4e-4), off, rtol=1e-5)


@pytest.mark.parametrize("size", [(480, 360), (317, 239), (98, 220), (1001, 333)])
def test_small_images_have_the_size_of_what_was_learnt(size: tuple[int, int]) -> None:
    """The kernels take both for equally large; a row less was read from beyond the image."""
    for fx in np.linspace(300.0, 1500.0, 40):
        seen = camera(size, fx)
        first = small_camera(seen, Backdrop.blank(), np.array([0.0, 0.0, 4.0]))
        image = np.zeros((*size[::-1], 3), np.uint8)
        features = small_features(image, first.size, "lab")
        learnt = Backdrop.blank().learnt(features, np.ones(features.shape[:2], np.bool_))
        again = small_camera(seen, learnt, np.array([0.0, 0.0, 7.0]))
        assert again.size == learnt.size == first.size
        assert small_features(image, again.size, "lab").shape[:2] == learnt.known.shape


def camera(size: tuple[int, int], fx: float) -> Camera:
    K = np.array([[fx, 0.0, size[0] / 2], [0.0, fx, size[1] / 2], [0.0, 0.0, 1.0]])
    return Camera("cam", K, np.eye(4), size)


def test_a_colour_that_is_like_neither_speaks_for_neither() -> None:
    """As a black picture: it is far from every part, and from what is behind."""
    one = np.full((1, 1, 3), 0.5, np.float32)
    background = background_of(one, np.full((1, 1, 3), 0.01, np.float32), np.ones((1, 1), np.bool_))
    colours = np.array([[1.0, *[0.2] * 3, *[0.2**2 + 0.01 - 4e-4] * 3]])
    palette = np.ones(1), np.full((1, 3), 0.5), np.ones((1, 3))
    far = evidence_maps(np.full((1, 1, 3), 9.0, np.float32), background, palette, colours, 3.0)
    near = evidence_maps(np.full((1, 1, 3), 0.2, np.float32), background, palette, colours, 3.0)
    np.testing.assert_allclose(far, 0.0, atol=1e-3)
    assert near[0, 0, 0] == 3.0
