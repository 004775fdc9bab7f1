"""Region statistics: boundaries found to a tenth of a pixel, level sets against discs known in closed form."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twistcap.region.densities import blockwise_log_ratio, global_log_ratio, heaviside, local_log_ratio
from twistcap.region.levelset import (
    evolve,
    evolve_reference,
    nearest_with_normal,
    signed_distance,
    zero_crossings,
)
from twistcap.region.lines import (
    boundary_posterior,
    boundary_posterior_reference,
    line_moments,
    pooled_gaussians,
    sample_lines,
)

HALF, FLOOR, CLIP = 12, 4e-4, 3.0
UNKNOWN = np.zeros((8, 7))  # no colours are remembered of any part


def edge_image(normal: np.ndarray, offset: float, noise: float, seed: int = 0) -> np.ndarray:
    """(120, 160, 2) step across the line normal · (x − centre) = offset; every pixel is its area's mean."""
    over = 8
    fine = (np.arange(over) + 0.5) / over - 0.5
    x = (np.arange(160)[:, None] + fine).ravel()
    y = (np.arange(120)[:, None] + fine).ravel()
    outward = (x[None] - 80) * normal[0] + (y[:, None] - 60) * normal[1] > offset
    share = outward.reshape(120, over, 160, over).mean(axis=(1, 3))[..., None]
    inside, outside = np.array([0.3, 0.7]), np.array([0.6, 0.5])
    image = inside + share * (outside - inside)
    return (image + noise * np.random.default_rng(seed).normal(size=image.shape)).astype(np.float32)


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
    values, first, last = sample_lines(
        image, part_at(normal, offset), pixels, normals, part, np.ones(n, dtype=bool), steps, HALF
    )
    assert np.all(first == 0) and np.all(last == 2 * HALF)
    mean, variance = pooled_gaussians(
        line_moments(values, first, last, steps), pixels, part, 20.0, 3.0, FLOOR, UNKNOWN, 0.0
    )
    return boundary_posterior(values, first, last, steps, mean, variance, CLIP)


def errors_at(shift: float, step: float, noise: float) -> np.ndarray:
    """Displacement less `shift` (lines,) over edges of all directions and sub-pixel phases, blurred as by a lens."""
    out, phases = [], np.random.default_rng(0).uniform(-0.5, 0.5, 7)
    for angle, start in zip(np.linspace(0.1, 6.2, 7), phases, strict=True):
        normal = np.array([np.cos(angle), np.sin(angle)])
        image = cv2.GaussianBlur(edge_image(normal, start + shift, noise, seed=int(100 * angle)), (0, 0), 0.7)
        displacement, variance, evidence = measured(image, normal, start, step)
        assert np.all(variance >= 0) and np.all(variance < 1.0) and np.all(evidence > 5)
        out.append(displacement - shift)
    return np.concatenate(out)


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("step", [0.4, 0.7, 1.0])
def test_a_contour_on_its_edge_stays_there(step: float, noise: float) -> None:
    """No bias at rest, which half a pixel wrong anywhere would show as 0.5; lines scatter by half a step at most."""
    error = errors_at(0.0, step, noise)
    assert abs(error.mean()) < 0.06
    assert np.sqrt(np.mean(error**2)) < 0.5 * step + 0.05


@pytest.mark.parametrize("shift", [0.25, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("step", [0.4, 0.7])
def test_in_and_out_are_measured_alike(step: float, shift: float) -> None:
    """Both ways with the same error, which stays below half a sample and what the wrong side's pixels hold back."""
    out, inward = errors_at(shift, step, 0.03).mean(), errors_at(-shift, step, 0.03).mean()
    assert abs(out + inward) < 0.1
    assert max(abs(out), abs(inward)) < 0.5 * step + 0.3 * shift


@pytest.mark.parametrize("shift", [3.3, -3.3, 5.0, -5.0, 0.6, -0.6])
def test_a_step_edge_is_reached_in_a_few_rounds(shift: float) -> None:
    """Off the edge the wrong side's pixels blur the statistics; each round of measuring and moving mends them.

    Lines of one direction and step know the edge to half a sample: that is how near the rounds come.
    """
    normal = np.array([np.cos(0.5), np.sin(0.5)])
    image, at = cv2.GaussianBlur(edge_image(normal, shift, 0.02), (0, 0), 0.7), 0.0
    for _ in range(8):
        at += measured(image, normal, at)[0].mean()
    assert abs(at - shift) < 0.5 * 0.7


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
    displacement, spread, _ = boundary_posterior(*lines, CLIP)
    expected, expected_spread = boundary_posterior_reference(*lines, CLIP)
    np.testing.assert_allclose(displacement, expected, atol=5e-3)
    np.testing.assert_allclose(spread, expected_spread, rtol=2e-2, atol=5e-3)
    assert displacement.std() > 1


def test_evidence_is_the_best_place_against_no_boundary() -> None:
    values, first, last, step, mean, variance = random_lines(1)
    _, _, evidence = boundary_posterior(values, first, last, step, mean, variance, CLIP)
    for n in range(len(values)):
        v = values[n, first[n] : last[n] + 1, None]
        log_p = -0.5 * ((v - mean[n]) ** 2 / variance[n] + np.log(variance[n])).sum(axis=-1)
        ratio = np.clip(log_p[:, 0] - log_p[:, 1], -CLIP, CLIP) * step[n]
        score = np.concatenate([[0], np.cumsum(ratio)])
        assert evidence[n] == pytest.approx(score.max() - max(score[0], score[-1]), abs=1e-4)


def test_line_samples_are_bilinear_and_lie_on_the_line() -> None:
    """On a bilinear image bilinear sampling is exact: a shift by any part of a pixel shows."""
    y, x = np.mgrid[:60, :80].astype(float)
    image = np.stack([0.01 * x + 0.002 * y, 1e-4 * x * y], axis=-1).astype(np.float32)
    pixels, normals = np.array([[40.3, 30.8]]), np.array([[0.6, -0.8]])
    step = np.array([0.9])
    part = np.where(30.8 + (x - 40.3) * 0.75 < y, 0, -1).astype(np.int32)
    values, first, last = sample_lines(image, part, pixels, normals, np.zeros(1, np.int32), np.ones(1, bool), step, 8)
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
    _, first, last = sample_lines(
        image, parts, np.array([[39.5, 20.0]]), np.array([[1.0, 0.0]]), np.ones(1, np.int32), np.array([outer]),
        np.ones(1), 30,
    )  # fmt: skip
    return first[0] - 30, last[0] - 30


def test_lines_keep_to_their_own_part_and_off_the_body() -> None:
    inward, outward = run_of(outer=True)
    assert -20 <= inward <= -19 and 3 <= outward <= 4
    assert run_of(outer=False)[1] == 30  # before another part, that part is what lies outside


def test_lines_end_at_the_images_border() -> None:
    parts, image = np.zeros((40, 40), np.int32), np.zeros((40, 40, 1), np.float32)
    parts[:, 35:] = -1
    one = np.ones(1)
    _, first, last = sample_lines(
        image, parts, np.array([[34.5, 20.0]]), np.array([[1.0, 0]]), np.zeros(1, np.int32), np.ones(1, bool), one, 10
    )
    assert first[0] == 0 and last[0] == 10 + 4  # 38.5 is the last place with pixels on both sides


def test_line_moments_and_pooled_gaussians_are_weighted_statistics() -> None:
    values, first, last, step, _, _ = random_lines(2)
    n, rho, prior = len(values), 9.0, 3.0
    rng = np.random.default_rng(3)
    pixels, part = rng.uniform(0, 30, (n, 2)), rng.integers(0, 2, n).astype(np.int32)
    mean, variance = pooled_gaussians(
        line_moments(values, first, last, step), pixels, part, rho, prior, FLOOR, UNKNOWN, 0.0
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
    mean, variance = pooled_gaussians(moments, pixels, part, 9.0, 3.0, FLOOR, UNKNOWN, 0.0)
    everything = moments[:, 1].sum(axis=0)
    np.testing.assert_allclose(mean[0, 1], everything[1:4] / everything[0], rtol=1e-9)
    assert np.all(np.isfinite(variance)) and variance.min() >= FLOOR


def test_remembered_colours_take_the_place_of_the_parts_own() -> None:
    values, first, last, step, _, _ = random_lines(5)
    part, pixels = np.zeros(len(values), np.int32), np.random.default_rng(1).uniform(0, 30, (len(values), 2))
    moments = line_moments(values, first, last, step)
    colours = np.zeros((1, 7))
    colours[0] = [0.5, 0.1, 0.2, 0.3, 0.1**2 + 1e-3, 0.2**2 + 1e-3, 0.3**2 + 1e-3]
    mean, variance = pooled_gaussians(moments, pixels, part, 9.0, 3.0, FLOOR, colours, 2e9)
    np.testing.assert_allclose(mean[:, 0], np.tile(colours[0, 1:4], (len(values), 1)), atol=1e-5)
    np.testing.assert_allclose(variance[:, 0], 1e-3 + FLOOR, atol=1e-5)
    plain, _ = pooled_gaussians(moments, pixels, part, 9.0, 3.0, FLOOR, UNKNOWN, 0.0)
    np.testing.assert_array_equal(mean[:, 1], plain[:, 1])  # the background has no memory
    halved, _ = pooled_gaussians(moments, pixels, part, 1e-6, 3.0, FLOOR, colours, 2.0 * moments[0, 0, 0])
    np.testing.assert_allclose(halved[0, 0, 0], 0.5 * (moments[0, 0, 1] / moments[0, 0, 0] + 0.1), rtol=1e-6)


# ---- level sets ------------------------------------------------------------------------------------------------

SIZE = (101, 121)


def disc_distance(centre: tuple[float, float], radius: float) -> np.ndarray:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    return radius - np.hypot(x - centre[0], y - centre[1])


def test_signed_distance_of_discs() -> None:
    """Right to half a pixel at each place, and without bias at the outline, on discs of all sizes and phases."""
    rng, means = np.random.default_rng(0), []
    for _ in range(20):
        true = disc_distance((60 + rng.uniform(-2, 2), 50 + rng.uniform(-2, 2)), rng.uniform(20, 35))
        error = signed_distance(true > 0) - true
        assert np.abs(error[np.abs(true) < 12]).max() < 0.5 + 0.02 * 12
        means.append(error[np.abs(true) < 3].mean())
    assert abs(np.mean(means)) < 0.03 and np.abs(means).max() < 0.1


@pytest.mark.parametrize("centre, radius", [((60.0, 50.0), 30.0), ((61.3, 48.8), 25.4)])
def test_zero_crossings_of_a_circle(centre: tuple[float, float], radius: float) -> None:
    points, normals = zero_crossings(disc_distance(centre, radius).astype(np.float32))
    out = points - centre
    r = np.linalg.norm(out, axis=1)
    assert len(points) > 4 * radius
    np.testing.assert_allclose(r, radius, atol=0.01)
    assert np.sum(out / r[:, None] * normals, axis=1).min() > np.cos(np.deg2rad(1))
    turn = np.sort(np.arctan2(out[:, 1], out[:, 0]))
    assert np.diff(turn).max() * radius < 2  # all the way round


def test_zero_crossings_of_a_plain_field_are_none() -> None:
    points, normals = zero_crossings(np.ones((20, 20), np.float32))
    assert points.shape == normals.shape == (0, 2)


def two_discs(noise: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Channels of a disc, its true distance, and the level set of a wrong one beside it."""
    true = disc_distance((62.0, 51.0), 24.0)
    smooth = heaviside(true.astype(np.float32), 0.6)[..., None]
    channels = np.array([0.7, 0.4]) * smooth + np.array([0.3, 0.5]) * (1 - smooth)
    channels = channels + noise * np.random.default_rng(0).normal(size=channels.shape)
    return channels.astype(np.float32), true, disc_distance((58.0, 48.5), 22.0).astype(np.float32)


def test_evolution_agrees_with_its_twin() -> None:
    rng = np.random.default_rng(1)
    phi0 = cv2.GaussianBlur(rng.normal(size=(40, 50)).astype(np.float32), (0, 0), 3) * 40
    ratio = (3 * rng.normal(size=phi0.shape)).astype(np.float32)
    settings = (6, 1.2, 0.5, 0.05, 2.0, 3.0)
    expected = evolve_reference(phi0, ratio, *settings)
    np.testing.assert_allclose(evolve(phi0, ratio, *settings), expected, atol=2e-3)
    assert np.abs(expected - phi0).max() > 0.5 and np.any(np.abs(phi0) > 8)


@pytest.mark.parametrize("density", ["global", "local"])
def test_evolution_moves_a_wrong_disc_onto_the_images(density: str) -> None:
    channels, _, phi0 = two_discs()
    inside, width = heaviside(phi0, 0.7), 3.0
    if density == "global":
        ratio = global_log_ratio(channels, inside, FLOOR)
    else:
        ratio = local_log_ratio(channels, inside, 12.0, FLOOR, 0.02)
    phi = evolve(phi0, ratio, 60, 1.5 * width, 0.5, 0.05 / width, width, CLIP)
    before = radial_error(phi0)
    after = radial_error(phi)
    assert np.abs(before).mean() > 3
    on_disc = np.abs(after) < 3.0  # where local densities meet noise far from the edge, islands of a few pixels stay
    assert on_disc.mean() > (0.999 if density == "global" else 0.85)
    # Local densities, estimated across the wrong contour, lag a little behind it.
    tolerance, bias = (0.4, 0.15) if density == "global" else (0.6, 0.3)
    assert np.abs(after[on_disc]).mean() < tolerance and abs(after[on_disc].mean()) < bias


def radial_error(phi: np.ndarray) -> np.ndarray:
    points, _ = zero_crossings(phi)
    return np.linalg.norm(points - [62.0, 51.0], axis=1) - 24.0


def test_the_shape_prior_holds_the_contour() -> None:
    """Without evidence and length the shape stays; the stronger λ, the less the image moves it."""
    channels, _, phi0 = two_discs()
    nothing = np.zeros_like(phi0)
    np.testing.assert_allclose(evolve(phi0, nothing, 20, 1.0, 0.0, 0.1, 3.0, CLIP), phi0, atol=1e-5)
    ratio = global_log_ratio(channels, heaviside(phi0, 0.7), FLOOR)
    moved = [np.abs(evolve(phi0, ratio, 30, 1.0, 0.5, lam, 3.0, CLIP) - phi0).mean() for lam in (0.0, 0.02, 0.2)]
    assert moved[0] > moved[1] > moved[2] > 0


def test_the_length_term_shrinks_a_disc_at_the_rate_of_its_curvature() -> None:
    phi0 = disc_distance((60.0, 50.0), 15.0).astype(np.float32)
    width, nu, tau, steps = 3.0, 1.0, 0.5, 40
    points, _ = zero_crossings(evolve(phi0, np.zeros_like(phi0), steps, tau, nu, 0.0, width, CLIP))
    top = 1 / (np.sqrt(2 * np.pi) * width)
    shrink = 15.0 - np.linalg.norm(points - [60, 50], axis=1).mean()
    assert shrink == pytest.approx(steps * tau * nu * top / 15.0, rel=0.1)


def test_heaviside_is_a_step_as_wide_as_asked() -> None:
    phi = np.linspace(-20, 20, 4001, dtype=np.float32)
    h = heaviside(phi, 2.0).astype(float)
    density = np.gradient(h, phi.astype(float))
    assert h[0] < 1e-6 and h[-1] > 1 - 1e-6 and h[2000] == pytest.approx(0.5, abs=1e-6)
    assert np.sqrt((density * phi**2).sum() * 0.01) == pytest.approx(2.0, rel=1e-3)


def gaussian_ratio(v: np.ndarray, inside: tuple, outside: tuple) -> np.ndarray:
    log_p = [-0.5 * ((v - mu) ** 2 / var + np.log(var)) for mu, var in (inside, outside)]
    return log_p[0] - log_p[1]


def weighted(v: np.ndarray, w: np.ndarray) -> tuple[float, float]:
    mu = (w * v).sum() / w.sum()
    return mu, (w * (v - mu) ** 2).sum() / w.sum() + FLOOR


def test_global_ratio_is_that_of_two_gaussians() -> None:
    channels, _, phi0 = two_discs()
    inside = heaviside(phi0, 0.7)
    expected = sum(
        gaussian_ratio(v, weighted(v, inside.astype(float)), weighted(v, 1.0 - inside))
        for v in np.moveaxis(channels.astype(float), 2, 0)
    )
    np.testing.assert_allclose(global_log_ratio(channels, inside, FLOOR), expected, rtol=1e-3, atol=1e-3)


def local_ratio_reference(
    channels: np.ndarray, inside: np.ndarray, rho: float, prior: float, at: list[tuple[int, int]]
) -> list[float]:
    """Brute-force twin at single pixels: cut the window out and take weighted statistics, the global ones mixed in."""
    reach = max(3, 2 * round(rho * np.sqrt(3)) + 1) // 2
    out = []
    for r, c in at:
        total = 0.0
        for v in np.moveaxis(channels.astype(float), 2, 0):
            window = np.pad(v, reach, mode="reflect")[r : r + 2 * reach + 1, c : c + 2 * reach + 1]
            sides = []
            for w in (inside.astype(float), 1.0 - inside):
                share = np.pad(w, reach, mode="reflect")[r : r + 2 * reach + 1, c : c + 2 * reach + 1]
                share = share / share.size
                mu0, var0 = weighted(v, w)
                mu = ((share * window).sum() + prior * mu0) / (share.sum() + prior)
                second = (share * window**2).sum() + prior * (var0 - FLOOR + mu0**2)  # the floor is added once, below
                sides.append((mu, second / (share.sum() + prior) - mu**2 + FLOOR))
            total += gaussian_ratio(v[r, c], *sides)
        out.append(float(total))
    return out


def test_local_ratio_agrees_with_its_brute_force_twin() -> None:
    channels, _, phi0 = two_discs()
    inside = heaviside(phi0, 0.7)
    places = [(0, 0), (50, 60), (48, 36), (48, 37), (3, 118), (74, 62), (50, 90), (100, 120)]
    found = local_log_ratio(channels, inside, 7.0, FLOOR, 0.05)
    expected = local_ratio_reference(channels, inside, 7.0, 0.05, places)
    np.testing.assert_allclose([found[p] for p in places], expected, rtol=2e-2, atol=5e-3)
    assert np.ptp(expected) > 1


def test_blockwise_ratio_is_the_local_one() -> None:
    rng = np.random.default_rng(3)
    channels = cv2.GaussianBlur(rng.uniform(0, 1, (91, 120, 3)).astype(np.float32), (0, 0), 2.0)
    inside = heaviside(disc_distance((60.0, 45.0), 25.0)[:91, :120].astype(np.float32), 0.7)
    exact = local_log_ratio(channels, inside, 12.0, FLOOR, 0.02)
    blocks = blockwise_log_ratio(channels, inside, 12.0, FLOOR, 0.02)
    assert np.abs(blocks - exact).mean() < 0.1 * exact.std()
    alone = blockwise_log_ratio(channels, inside, 12.0, FLOOR, 0.02, block=1)
    np.testing.assert_allclose(alone, exact, atol=5e-3)


def test_local_ratio_copes_where_the_global_one_cannot() -> None:
    """A background brighter than the object on one side and darker on the other has the object's own mean."""
    true = disc_distance((60.0, 50.0), 25.0)
    x = np.broadcast_to(np.arange(SIZE[1]), SIZE)
    image = np.where(true > 0, 0.5, np.where(x < 60, 0.3, 0.7)) + 0.03 * np.random.default_rng(0).normal(size=SIZE)
    channels, inside = image.astype(np.float32)[..., None], heaviside(true.astype(np.float32), 0.7)
    ratio = local_log_ratio(channels, inside, 8.0, FLOOR, 0.02)
    ring = (np.abs(true) > 1.5) & (np.abs(true) < 8) & (np.abs(x - 60) > 12)
    assert np.mean((ratio[ring] > 0) == (true[ring] > 0)) > 0.97


def test_nearest_partner_agrees_with_brute_force() -> None:
    rng = np.random.default_rng(5)

    def normals(n: int) -> np.ndarray:
        angle = rng.uniform(0, 2 * np.pi, n)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    points, candidates = rng.uniform(0, 50, (40, 2)), rng.uniform(0, 50, (60, 2))
    n, m = normals(40), normals(60)
    partner, distance = nearest_with_normal(points, n, candidates, m, 0.5)
    all_distances = np.linalg.norm(points[:, None] - candidates, axis=2)
    all_distances[n @ m.T < 0.5] = np.inf
    np.testing.assert_allclose(distance, all_distances.min(axis=1))
    np.testing.assert_array_equal(partner, candidates[all_distances.argmin(axis=1)])
    assert np.any(all_distances.argmin(axis=1) != np.linalg.norm(points[:, None] - candidates, axis=2).argmin(axis=1))


def test_points_without_an_agreeing_partner_are_infinitely_far() -> None:
    one, right, left = np.zeros((1, 2)), np.array([[1.0, 0.0]]), np.array([[-1.0, 0.0]])
    assert nearest_with_normal(one, right, one + 3, left, 0.5)[1][0] == np.inf
    assert nearest_with_normal(one, right, np.zeros((0, 2)), np.zeros((0, 2)), 0.5)[1][0] == np.inf
