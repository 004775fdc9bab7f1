"""Filters of angles: the cutoff where spectrum and noise meet, the smoother's gain, and less noise in walks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.evaluate.filters import BOUNDS, Filter, Kind, Motion, filtered, in_words, noise_cutoff, smoothed
from twistcap.io.coordinates import coordinates_of
from twistcap.studio.motion import gait as walk

FPS, N = 60.0, 300
BODY = humanoid()
KNOWN = np.ones(N, bool)
KNEE = BODY.coordinate("knee_angle_r")


def motion(poses: list[Pose], sigma: float, known: Float | None = None) -> Motion:
    covariances = np.tile(np.eye(BODY.dof) * sigma**2, (len(poses), 1, 1))
    return Motion(BODY, np.arange(len(poses)) / FPS, poses, covariances, KNOWN if known is None else known)


def noisy_walk(seed: int, sigma: float) -> tuple[list[Pose], Motion]:
    rng = np.random.default_rng(seed)
    poses = walk(BODY, fps=FPS, frames=N, speed=rng.uniform(0.8, 1.6), phase=rng.uniform())
    noisy = [Pose(p.root, p.q + rng.normal(0.0, sigma, len(p.q))) for p in poses]
    return poses, motion(noisy, sigma)


@pytest.mark.parametrize("meeting", [4.0, 6.0, 9.0])
def test_the_cutoff_is_where_spectrum_and_noise_meet(meeting: float) -> None:
    """Motion of a density that falls with f⁻⁴, and white noise that is as strong as it at one frequency."""
    count, sigma, rng = 6000, 1.0, np.random.default_rng(100)
    hertz = np.fft.rfftfreq(count, 1 / FPS)
    level = sigma * np.sqrt(count / 2)  # of the white noise's Fourier coefficients
    gains = level * np.minimum((meeting / np.maximum(hertz, 1e-9)) ** 2, 50.0)
    waves = gains * (rng.normal(size=len(hertz)) + 1j * rng.normal(size=len(hertz)))
    values = np.fft.irfft(waves, count) + rng.normal(0.0, sigma, count)
    known = np.ones(count, bool)
    assert noise_cutoff(values, np.full(count, sigma), FPS, known) == pytest.approx(meeting, abs=1.0)


def test_the_cutoff_keeps_within_bounds() -> None:
    rng, none = np.random.default_rng(101), np.zeros(N)
    still = rng.normal(size=N)
    assert noise_cutoff(still, np.full(N, 10.0), FPS, KNOWN) == BOUNDS[0]
    assert noise_cutoff(still, none, FPS, KNOWN) == BOUNDS[1]
    assert noise_cutoff(still, none, 20.0, KNOWN) == pytest.approx(0.45 * 20)
    assert noise_cutoff(still, none, FPS, ~KNOWN) == BOUNDS[0]


@pytest.mark.parametrize("hertz", [2.0, 6.0, 12.0])
def test_the_smoother_passes_what_its_formula_says(hertz: float) -> None:
    sigma, amplitude = np.deg2rad(1.0), 0.05
    poses = list[Pose]()
    for n in range(N):
        q = Pose.rest(BODY).q.copy()
        q[KNEE] = 0.8 + amplitude * np.cos(2 * np.pi * hertz * n / FPS)
        poses.append(Pose(Pose.rest(BODY).root, q))
    out = np.array([pose.q[KNEE] for pose in smoothed(motion(poses, sigma))])[60:-60]
    turn = 2 * np.sin(np.pi * hertz / FPS) * FPS  # rad/s, of the second difference of a wave
    gain = 1 / (1 + turn**4 * sigma**2 / 100.0**2)
    given = np.array([pose.q[KNEE] for pose in poses])[60:-60]
    assert np.ptp(out) / np.ptp(given) == pytest.approx(gain, rel=0.02)


def test_the_smoother_says_its_cutoff() -> None:
    poses = [Pose.rest(BODY)] * 20
    cutoffs = filtered(motion(poses, np.deg2rad(1.0), np.ones(20, bool)), Filter("smoother")).cutoffs
    k = coordinates_of(BODY, poses).names.index("knee_angle_r")
    assert cutoffs[k] == pytest.approx(0.802 * np.sqrt(100.0 / np.deg2rad(1.0)) / (2 * np.pi), rel=1e-3)


@pytest.mark.parametrize("seed", range(100, 104))
def test_filters_take_noise_away(seed: int) -> None:
    """At 1° of noise the chosen cutoffs are better than 6 Hz for all, and every filter is better than none."""
    poses, noisy = noisy_walk(seed, np.deg2rad(1.0))
    table = coordinates_of(BODY, poses)
    k = [table.names.index(name) for name in BODY.coordinate_names if "arm" not in name]
    errors: dict[str, float] = {}
    for name, how in (("chosen", Filter()), ("6 Hz", Filter(cutoff=6.0)), ("smoother", Filter("smoother"))):
        off = (filtered(noisy, how).values - table.in_degrees[0])[:, k]
        errors[name] = float(np.sqrt(np.mean(off**2)))
    assert errors["chosen"] < errors["6 Hz"] < 0.5 and errors["smoother"] < 0.65


@pytest.mark.parametrize("kind", ["butterworth", "smoother"])
def test_no_filter_runs_across_a_gap(kind: str) -> None:
    _, noisy = noisy_walk(102, 0.01)
    known = KNOWN.copy()
    known[150] = False
    jump = [Pose(p.root, p.q + (0.5 if n > 150 else 0.0)) for n, p in enumerate(noisy.poses)]
    values = filtered(motion(jump, 0.01, known), Filter(kind)).values  # type: ignore[arg-type]
    whole = filtered(motion(list(noisy.poses[:150]), 0.01, known[:150]), Filter(kind)).values  # type: ignore[arg-type]
    assert np.isnan(values[150]).all()
    if kind == "smoother":  # the Butterworth's cutoff is chosen on the longest run, here the first as well
        np.testing.assert_allclose(values[:150], whole, atol=1e-6)
    else:
        np.testing.assert_allclose(values[:100], whole[:100], atol=0.5)


@pytest.mark.parametrize("kind", ["butterworth", "smoother"])
def test_where_no_frame_is_known_no_cutoff_is_claimed(kind: Kind) -> None:
    found = filtered(motion([Pose.rest(BODY)] * 20, 0.01, np.zeros(20, bool)), Filter(kind))
    assert np.isnan(found.cutoffs).all() and np.isnan(found.values).all()
    sentence = in_words(Filter(kind), dict(zip(found.table.names, found.cutoffs.tolist(), strict=True)))
    assert sentence.startswith("Angles pass") and "cutoff" not in sentence and "nan" not in sentence


def test_a_covariance_that_is_not_finite_gives_no_cutoff() -> None:
    _, noisy = noisy_walk(103, 0.01)
    noisy.covariances[40] = np.nan
    with pytest.raises(InputError, match="covariance of the result is not finite"):
        filtered(noisy, Filter())
    known = KNOWN.copy()
    known[40] = False  # of a frame that is not known, none is needed
    assert np.isfinite(filtered(replace(noisy, known=known), Filter()).cutoffs).all()


def test_words_and_refusals() -> None:
    assert "cutoff 4.0 to 6.0 Hz, where the spectrum" in in_words(Filter(), {"a": 4.0, "b": 6.0})
    assert in_words(Filter(cutoff=6.0), {"a": 6.0}).endswith("cutoff 6.0 Hz.")
    assert "smoother of refine" in in_words(Filter("smoother"), {"a": 9.0})
    with pytest.raises(InputError, match="takes no cutoff"):
        Filter("smoother", 6.0)
    with pytest.raises(InputError, match="filter is"):
        Filter("median")  # type: ignore[arg-type]
