"""Statistics along the contour's normals: boundaries found to a fraction of a pixel, kernels against their twins."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twistcap.region.lines import (
    LineSettings,
    boundary_posterior,
    edge_shift,
    line_moments,
    pooled_gaussians,
    sample_lines,
)
from twistcap.region.lines_reference import boundary_posterior_reference, edge_shift_reference

HALF, FLOOR, CLIP = 12, 4e-4, 3.0
UNKNOWN = np.zeros((8, 7))  # no colours are remembered of any part


def how(rho: float, prior_mass: float, colour_mass: float) -> LineSettings:
    return LineSettings(HALF, CLIP, 1.0, 1.0, 0.25, 0.0, rho, prior_mass, FLOOR, float(colour_mass))


def edge_image(
    normal: np.ndarray, offset: float, noise: float, seed: int = 0, textures: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """(120, 160, 2) step across the line normal · (x − centre) = offset; every pixel is its area's mean.

    Each side has a texture of patches about two pixels wide, of a standard deviation inside and outside.
    """
    over, rng = 8, np.random.default_rng(seed)
    fine = (np.arange(over) + 0.5) / over - 0.5
    x = (np.arange(160)[:, None] + fine).ravel()
    y = (np.arange(120)[:, None] + fine).ravel()
    outward = (x[None] - 80) * normal[0] + (y[:, None] - 60) * normal[1] > offset
    share = outward.reshape(120, over, 160, over).mean(axis=(1, 3))[..., None]
    inside, outside = np.array([0.3, 0.7]), np.array([0.6, 0.5])
    cloth, wall = (sigma * _patches(rng) for sigma in textures)
    image = inside + cloth + share * (outside + wall - inside - cloth)
    return (image + noise * np.random.default_rng(seed).normal(size=image.shape)).astype(np.float32)


def _patches(rng: np.random.Generator) -> np.ndarray:
    """(120, 160, 2) of unit variance."""
    smooth = cv2.GaussianBlur(rng.normal(size=(120, 160, 2)), (0, 0), 1.0)
    return smooth / smooth.std()


def lines_across(normal: np.ndarray, offset: float, n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Contour points (n, 2) on the line at `offset`, at all sub-pixel phases, and their normals."""
    along = np.linspace(-38, 38, n)[:, None] * np.array([-normal[1], normal[0]])
    pixels = np.array([80.0, 60.0]) + along + offset * normal
    return pixels, np.tile(normal, (n, 1))


def part_at(normal: np.ndarray, offset: float) -> np.ndarray:
    y, x = np.mgrid[:120, :160]
    return np.where((x - 80) * normal[0] + (y - 60) * normal[1] <= offset, 0, -1).astype(np.int32)


def measured(
    image: np.ndarray, normal: np.ndarray, offset: float, step: float = 0.7
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement, variance and evidence of lines across a contour projected at `offset`."""
    pixels, normals = lines_across(normal, offset)
    n = len(pixels)
    steps, part = np.full(n, step), np.zeros(n, np.int32)
    lines = (pixels, normals, part, np.ones(n, dtype=bool), np.ones(n))
    values, first, last = sample_lines(image, (part_at(normal, offset), np.arange(1)), lines, steps, HALF)
    assert np.all(first == 0) and np.all(last == 2 * HALF)
    mean, variance = pooled_gaussians(
        line_moments(values, first, last, steps), pixels, part, UNKNOWN, how(20.0, 3.0, 0.0)
    )
    seen = values, first, last, steps, mean, variance
    displacement, spread, evidence = boundary_posterior(*seen, CLIP)
    return displacement + edge_shift(*seen, displacement, CLIP), spread, evidence


def errors_at(
    shift: float, step: float, noise: float, textures: tuple[float, float] = (0.0, 0.0), blur: float = 0.7
) -> np.ndarray:
    """Displacement less `shift` (lines,) over edges of all directions and sub-pixel phases, blurred as by a lens."""
    out, phases = [], np.random.default_rng(0).uniform(-0.5, 0.5, 7)
    for angle, start in zip(np.linspace(0.1, 6.2, 7), phases, strict=True):
        normal = np.array([np.cos(angle), np.sin(angle)])
        sharp = edge_image(normal, start + shift, noise, int(100 * angle), textures)
        image = cv2.GaussianBlur(sharp, (0, 0), blur)
        displacement, variance, evidence = measured(image, normal, start, step)
        assert np.all(variance >= 0) and np.all(variance < 1.0) and np.all(evidence > 5)
        out.append(displacement - shift)
    return np.concatenate(out)


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("step", [0.4, 0.7, 1.0])
def test_a_contour_on_its_edge_stays_there(step: float, noise: float) -> None:
    """No bias at rest, which half a pixel wrong anywhere would show as 0.5, and little scatter."""
    error = errors_at(0.0, step, noise)
    assert abs(error.mean()) < 0.06
    assert np.sqrt(np.mean(error**2)) < 0.25


@pytest.mark.parametrize("textures", [(0.01, 0.1), (0.1, 0.01)])
@pytest.mark.parametrize("blur", [0.2, 0.7])
@pytest.mark.parametrize("step", [0.48, 1.0, 1.65])
def test_an_edge_between_unlike_textures_is_found(step: float, blur: float, textures: tuple[float, float]) -> None:
    """A pixel of both sides lies in the wider density of the two; taken for that side alone it moves the edge."""
    error = errors_at(0.0, step, 0.005, textures, blur)
    assert abs(error.mean()) < 0.15
    assert np.median(np.abs(error)) < 0.25


@pytest.mark.parametrize("shift", [0.25, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("step", [0.4, 0.7])
def test_in_and_out_are_measured_alike(step: float, shift: float) -> None:
    """Both ways with the same error, which is what the wrong side's pixels hold back."""
    out, inward = errors_at(shift, step, 0.03).mean(), errors_at(-shift, step, 0.03).mean()
    assert abs(out + inward) < 0.1
    assert max(abs(out), abs(inward)) < 0.05 + 0.3 * shift


@pytest.mark.parametrize("shift", [3.3, -3.3, 5.0, -5.0, 0.6, -0.6])
def test_a_step_edge_is_reached_in_a_few_rounds(shift: float) -> None:
    """Off the edge the wrong side's pixels blur the statistics; each round of measuring and moving mends them."""
    normal = np.array([np.cos(0.5), np.sin(0.5)])
    image, at = cv2.GaussianBlur(edge_image(normal, shift, 0.02), (0, 0), 0.7), 0.0
    for _ in range(8):
        at += measured(image, normal, at)[0].mean()
    assert abs(at - shift) < 0.04


def test_no_edge_gives_little_evidence_and_a_wide_posterior() -> None:
    image = 0.5 + 0.03 * np.random.default_rng(0).normal(size=(120, 160, 2)).astype(np.float32)
    _, variance, evidence = measured(image, np.array([1.0, 0.0]), 0.0)
    _, sharp, sure = measured(edge_image(np.array([1.0, 0.0]), 0.0, 0.03), np.array([1.0, 0.0]), 0.0)
    assert np.median(evidence) < 0.1 * np.median(sure)
    assert np.median(variance) > 10 * np.median(sharp)


def random_lines(seed: int = 0) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    n = 30
    values = rng.uniform(0, 1, (n, 2 * HALF + 1, 3)).astype(np.float32)
    first, last = rng.integers(0, HALF, n).astype(np.int32), rng.integers(HALF, 2 * HALF + 1, n).astype(np.int32)
    mean, variance = rng.uniform(0, 1, (n, 2, 3)), rng.uniform(0.01, 0.3, (n, 2, 3))
    return values, first, last, rng.uniform(0.3, 2.0, n), mean, variance


def test_posterior_agrees_with_its_twin() -> None:
    lines = random_lines()
    displacement, spread, evidence = boundary_posterior(*lines, CLIP)
    expected, expected_spread, expected_evidence = boundary_posterior_reference(*lines, CLIP)
    np.testing.assert_allclose(evidence, expected_evidence, atol=1e-4)
    np.testing.assert_allclose(displacement, expected, atol=5e-3)
    np.testing.assert_allclose(spread, expected_spread, rtol=2e-2, atol=5e-3)
    assert displacement.std() > 1
    shift, expected_shift = edge_shift(*lines, expected, CLIP), edge_shift_reference(*lines, expected, CLIP)
    np.testing.assert_allclose(shift, expected_shift, atol=2e-3)
    assert np.ptp(shift) > 0.5


def test_line_samples_are_bilinear_and_lie_on_the_line() -> None:
    """On a bilinear image bilinear sampling is exact: a shift by any part of a pixel shows."""
    y, x = np.mgrid[:60, :80].astype(float)
    image = np.stack([0.01 * x + 0.002 * y, 1e-4 * x * y], axis=-1).astype(np.float32)
    pixels, normals = np.array([[40.3, 30.8]]), np.array([[0.6, -0.8]])
    step = np.array([0.9])
    part = np.where(30.8 + (x - 40.3) * 0.75 < y, 0, -1).astype(np.int32)
    lines = (pixels, normals, np.zeros(1, np.int32), np.ones(1, bool), np.ones(1))
    values, first, last = sample_lines(image, (part, np.arange(1)), lines, step, 8)
    k = np.arange(first[0], last[0] + 1)
    d = (k - 8)[:, None] * 0.9
    at = pixels + d * normals
    np.testing.assert_allclose(values[0, k, 0], 0.01 * at[:, 0] + 0.002 * at[:, 1], atol=1e-6)
    np.testing.assert_allclose(values[0, k, 1], 1e-4 * at[:, 0] * at[:, 1], atol=1e-6)
    assert first[0] == 0 and last[0] == 16


def run_of(outer: bool) -> tuple[int, int]:
    """The usable run of a line out of part 1 (columns 20-39), which ends 4 px before part 2 (columns 44-)."""
    parts = np.full((40, 80), -1, np.int32)
    parts[:, 20:40], parts[:, 44:] = 1, 2
    image = np.zeros((40, 80, 1), np.float32)
    one = np.ones(1)
    lines = (np.array([[39.5, 20.0]]), np.array([[1.0, 0.0]]), np.ones(1, np.int32), np.array([outer]), one)
    _, first, last = sample_lines(image, (parts, np.arange(3)), lines, one, 30)
    return first[0] - 30, last[0] - 30


def test_lines_keep_to_their_own_part_and_off_the_body() -> None:
    inward, outward = run_of(outer=True)
    assert -20 <= inward <= -19 and 3 <= outward <= 4
    assert run_of(outer=False)[1] == 30  # before another part, that part is what lies outside


def test_lines_end_at_the_images_border() -> None:
    parts, image = np.zeros((40, 40), np.int32), np.zeros((40, 40, 1), np.float32)
    parts[:, 35:] = -1
    one = np.ones(1)
    lines = (np.array([[34.5, 20.0]]), np.array([[1.0, 0]]), np.zeros(1, np.int32), np.ones(1, bool), one)
    _, first, last = sample_lines(image, (parts, np.arange(1)), lines, one, 10)
    assert first[0] == 0 and last[0] == 10 + 4  # 38.5 is the last place with pixels on both sides


def test_line_moments_and_pooled_gaussians_are_weighted_statistics() -> None:
    values, first, last, step, _, _ = random_lines(2)
    n, rho, prior = len(values), 9.0, 3.0
    rng = np.random.default_rng(3)
    pixels, part = rng.uniform(0, 30, (n, 2)), rng.integers(0, 2, n).astype(np.int32)
    mean, variance = pooled_gaussians(
        line_moments(values, first, last, step), pixels, part, UNKNOWN, how(rho, prior, 0.0)
    )
    for i in range(n):
        for side in range(2):
            samples, weights, whole = [], [], []
            for m in np.flatnonzero(part == part[i]):
                k = np.arange(first[m], last[m] + 1)
                k = k[(np.abs(k - HALF) * step[m] >= 1.0) & ((k < HALF) if side == 0 else (k >= HALF))]
                d = np.linalg.norm(pixels[m] - pixels[i])
                samples.append(values[m, k])
                weights.append(np.full(len(k), max(1.0 - (d / (2.5 * rho)) ** 2, 0.0) ** 3))
                whole.append(len(k))
            v = np.concatenate(samples).astype(float)
            w = np.concatenate(weights) + prior / sum(whole)
            mu = np.average(v, axis=0, weights=w)
            np.testing.assert_allclose(mean[i, side], mu, atol=1e-6)
            expected = np.average((v - mu) ** 2, axis=0, weights=w) + FLOOR
            np.testing.assert_allclose(variance[i, side], expected, atol=2e-3)


def test_a_part_without_samples_outside_takes_those_of_the_whole_body() -> None:
    values, first, last, step, _, _ = random_lines(4)
    part = np.zeros(len(values), np.int32)
    part[0], last[0] = 1, HALF  # nothing usable outward
    pixels = np.random.default_rng(0).uniform(0, 30, (len(values), 2))
    moments = line_moments(values, first, last, step)
    mean, variance = pooled_gaussians(moments, pixels, part, UNKNOWN, how(9.0, 3.0, 0.0))
    everything = moments[:, 1].sum(axis=0)
    np.testing.assert_allclose(mean[0, 1], everything[1:4] / everything[0], rtol=1e-9)
    assert np.all(np.isfinite(variance)) and variance.min() >= FLOOR


def test_remembered_colours_take_the_place_of_the_parts_own() -> None:
    values, first, last, step, _, _ = random_lines(5)
    part, pixels = np.zeros(len(values), np.int32), np.random.default_rng(1).uniform(0, 30, (len(values), 2))
    moments = line_moments(values, first, last, step)
    colours = np.zeros((1, 7))
    colours[0] = [0.5, 0.1, 0.2, 0.3, 0.1**2 + 1e-3, 0.2**2 + 1e-3, 0.3**2 + 1e-3]
    mean, variance = pooled_gaussians(moments, pixels, part, colours, how(9.0, 3.0, 2e9))
    np.testing.assert_allclose(mean[:, 0], np.tile(colours[0, 1:4], (len(values), 1)), atol=1e-5)
    np.testing.assert_allclose(variance[:, 0], 1e-3 + FLOOR, atol=1e-5)
    plain, _ = pooled_gaussians(moments, pixels, part, UNKNOWN, how(9.0, 3.0, 0.0))
    np.testing.assert_array_equal(mean[:, 1], plain[:, 1])  # the background has no memory
    halved, _ = pooled_gaussians(moments, pixels, part, colours, how(1e-6, 3.0, 2.0 * moments[0, 0, 0]))
    np.testing.assert_allclose(halved[0, 0, 0], 0.5 * (moments[0, 0, 1] / moments[0, 0, 0] + 0.1), rtol=1e-6)
