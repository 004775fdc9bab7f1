"""Kernels of the regions against their readable twins."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from support.twins import check_twin
from twistcap.region import lines
from twistcap.region.densities import add_interpolated, heaviside, histograms
from twistcap.region.levelset import nearest_with_normal, signed_distance, zero_crossings
from twistcap.region.matching import relax

H, W, N, HALF = 50, 70, 60, 9
SETTINGS = lines.LineSettings(
    half=HALF, clip=3.0, fraction=0.7, inner=0.3, least_sigma=0.25, surface_sigma=1.3, rho=9.0, prior_mass=3.0,
    floor=4e-4, colour_mass=20.0,
)  # fmt: skip


def random_view(channels: int = 3, seed: int = 0) -> tuple[np.ndarray, lines.VisibleParts, lines.Lines]:
    """Three parts before a background, and lines anywhere, some of them on the border or off the image."""
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(rng.uniform(0, 1, (H, W, channels)).astype(np.float32), (0, 0), 1.5)
    face_index = np.full((H, W), -1, np.int32)
    for f, (top, left) in enumerate(((5, 5), (15, 25), (8, 42), (20, 50))):
        face_index[top : top + 25, left : left + 18] = f
    face_part = np.array([0, 1, 2, 2], np.int32)
    pixels = rng.uniform([-3, -3], [W + 3, H + 3], (N, 2))
    normals = rng.normal(size=(N, 2))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    part = rng.integers(0, 3, N).astype(np.int32)
    return image.reshape(H, W, channels), (face_index, face_part), (
        pixels, normals, part, rng.uniform(size=N) < 0.7, rng.uniform(0.1, 0.6, N),
    )  # fmt: skip


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_lines_are_measured_as_by_the_twins(channels: int) -> None:
    image, visible, view_lines = random_view(channels)
    step = np.random.default_rng(1).uniform(0.25, 1.4, N)
    values, first, last = check_twin(lines.sample_lines, image, visible, view_lines, step, HALF, atol=1e-6)
    assert first.min() == 0 and first.max() == HALF and last.max() == 2 * HALF
    moments = check_twin(lines.line_moments, values.astype(np.float32), first, last, step, rtol=1e-5, atol=1e-5)
    colours = np.random.default_rng(2).uniform(size=(3, 1 + 2 * channels))
    colours[1] = 0.0
    pixels, part = view_lines[0], view_lines[2]
    for group in (part, np.zeros_like(part)):
        check_twin(lines.pooled_gaussians, moments, pixels, group, colours, SETTINGS, rtol=1e-6)
        check_twin(
            lines.measured_lines, image, visible, view_lines, group, colours, 4.0, SETTINGS, rtol=0.02, atol=0.02
        )
    ratio = (4.0 * image[..., 0] - 2.0).astype(np.float32)
    check_twin(lines.ratio_lines, ratio, visible, view_lines, 4.0, SETTINGS, rtol=0.02, atol=0.02)


def test_no_lines_at_all_are_measured_too() -> None:
    image, visible, view_lines = random_view()
    none: Any = tuple(x[:0] for x in view_lines)
    found = lines.measured_lines(image, visible, none, none[2], np.zeros((3, 7)), 4.0, SETTINGS)
    assert [len(x) for x in found] == [0, 0, 0, 0]


def test_a_pixel_that_is_no_number_makes_its_lines_no_numbers() -> None:
    """It must not become an ordinary measurement: the solver is to see it."""
    image, visible, view_lines = random_view()
    group, colours = np.arange(N, dtype=np.int32), np.zeros((N, 7))  # each line for itself
    alone = SETTINGS._replace(rho=1e-3)
    clean, _, _, _ = lines.measured_lines(image, visible, view_lines, group, colours, 4.0, alone)
    image[20:30, 30:40] = np.nan
    step = np.maximum(4.0 / HALF * view_lines[4], 0.25)
    values, _, _ = lines.sample_lines(image, visible, view_lines, step, HALF)
    touched = np.isnan(values).any(axis=(1, 2))
    assert 0 < touched.sum() < N
    found, weight, evidence, target = lines.measured_lines(image, visible, view_lines, group, colours, 4.0, alone)
    assert np.isnan(found[touched]).all() and np.isnan(weight[touched]).all() and np.isnan(target[touched]).all()
    assert not (evidence[touched] > 0.0).any()  # what tells nothing agrees with nothing
    assert np.isfinite(clean).all()


def test_smooth_steps_are_those_of_the_twin() -> None:
    phi = np.linspace(-9, 9, 60).reshape(6, 10).astype(np.float32)
    for width in (0.7, 2.0):
        check_twin(heaviside, phi, width, rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", [0, 1])
def test_contours_of_level_sets_and_partners_are_those_of_the_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blobs = cv2.GaussianBlur(rng.normal(size=(2, 40, 50)).astype(np.float32)[0], (0, 0), 4.0) > 0.0
    points, normals = check_twin(zero_crossings, signed_distance(blobs), rtol=1e-5, atol=1e-5)
    assert len(points) > 50
    others, their_normals = zero_crossings(signed_distance(np.roll(blobs, 3, axis=1)))
    others = others + rng.uniform(-0.1, 0.1, others.shape)  # no two partners are equally near
    _, distance = check_twin(nearest_with_normal, others, their_normals, points, normals, 0.8)
    assert np.isfinite(distance).any()
    _, distance = check_twin(nearest_with_normal, others, their_normals, points[:3], normals[:3], 0.99)
    assert np.isinf(distance).any()
    check_twin(nearest_with_normal, others, their_normals, points[:0], normals[:0], 0.5)
    assert [len(x) for x in check_twin(zero_crossings, np.ones((9, 9), np.float32))] == [0, 0]


@pytest.mark.parametrize("size", [(7, 9), (1, 6), (2, 2)])
def test_fields_are_relaxed_as_by_the_twin(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    field, warped = rng.normal(size=(*size, 2)).astype(np.float32), rng.normal(size=(*size, 3)).astype(np.float32)
    source, weight = rng.normal(size=size).astype(np.float32), (rng.random(size) < 0.7).astype(np.float32)
    check_twin(relax, field, warped, source, weight, 1.5, 5, rtol=1e-4, atol=1e-4)


def test_histograms_are_those_of_the_twins() -> None:
    rng = np.random.default_rng(5)
    values, inside, outside = rng.uniform(size=(3, 20, 30)).astype(np.float32)
    values[0, :2] = 0.0, 1.0
    check_twin(histograms, values, inside, outside, 0.0, 1.0 / 31, 32, rtol=1e-5, atol=1e-5)
    table = rng.normal(size=32).astype(np.float32)
    check_twin(add_interpolated, values, 0.0, 1.0 / 31, table, inside, rtol=1e-4, atol=1e-4)
