"""Region models: known densities, one protocol in both methods, statistics of the whole body or of each part."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.stats import gaussian_kde

from support.readable import blockwise_log_ratio_reference
from twistcap.body import Posed
from twistcap.build import build
from twistcap.cues.direct import DirectContour
from twistcap.cues.levelset import LevelSetContour
from twistcap.cues.view import View, crop_view
from twistcap.errors import InputError
from twistcap.features import Channels
from twistcap.hindsight import tracked
from twistcap.io.session import tracker_settings
from twistcap.region.densities import heaviside, parzen_densities, parzen_log_ratio
from twistcap.region.lines import LineSettings, ratio_lines
from twistcap.region.models import Density, RegionModel, log_ratio_by_part, nearest_part
from twistcap.render import RenderedView, render, visible_contour
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.terms import PointNormalTerm, PointRayTerm
from twistcap.track import Settings

MODELS = (RegionModel("local", rho=8.0), RegionModel("global"), RegionModel("parzen"))
DENSITIES: tuple[Density, ...] = ("local", "global", "parzen")


def samples(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Values (40, 50) of two clusters, and soft weights."""
    rng = np.random.default_rng(seed)
    values = np.where(rng.random((40, 50)) < 0.3, 0.2, 0.7) + 0.05 * rng.standard_normal((40, 50))
    return values.astype(np.float32), rng.random((40, 50)).astype(np.float32)


@pytest.mark.parametrize("sigma", [0.02, 0.1])
def test_parzen_is_scipys_kernel_estimate(sigma: float) -> None:
    values, weight = samples()
    low, width, found = parzen_densities(values, weight, 1 - weight, sigma)
    places = low + width * np.arange(found.shape[1])
    flat = values.ravel().astype(float)
    for density, w in zip(found, (weight.ravel(), 1 - weight.ravel()), strict=True):
        spread = np.sqrt(np.cov(flat, aweights=w))
        known = gaussian_kde(flat, bw_method=sigma / spread, weights=w)(places)
        assert density == pytest.approx(known, abs=0.02 * known.max())
        assert density.sum() * width == pytest.approx(1.0, abs=1e-3)


def test_parzen_ratio_is_that_of_its_densities_with_the_floor() -> None:
    values, weight = samples(1)
    low, width, (one, other) = parzen_densities(values, weight**4, 1 - weight**4, 0.03)
    places = low + width * np.arange(len(one))
    expected = np.interp(values, places, np.log((one + 0.1) / (other + 0.1)))
    found = parzen_log_ratio(values[..., None], weight**4, 1 - weight**4, 0.03, 0.1)
    assert found == pytest.approx(expected, abs=1e-4)
    twice = parzen_log_ratio(np.dstack([values, values]), weight**4, 1 - weight**4, 0.03, 0.1)
    assert twice == pytest.approx(2 * found, abs=1e-4)


def test_no_logarithm_of_nothing() -> None:
    """A value that one region never has, a region without pixels, one value everywhere: all finite."""
    values = np.full((20, 30, 1), 0.5, np.float32)
    half = np.zeros((20, 30), np.float32)
    half[:10] = 1.0
    nothing = np.zeros_like(half)
    two = values.copy()
    two[:10] = 0.9
    for model in MODELS:
        for image, one in ((values, half), (two, half), (two, nothing)):
            assert np.all(np.isfinite(model.log_ratio(image, one, 1 - one, 1.0)))
    ratio = RegionModel("parzen").log_ratio(two, half, 1 - half, 1.0)
    top = np.log((1 / (0.02 * np.sqrt(2 * np.pi)) + 0.05) / 0.05)
    assert ratio[0, 0] == pytest.approx(top, rel=0.02) and ratio[19, 0] == pytest.approx(-top, rel=0.02)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_parzen_refuses_a_kernel_without_width(wrong: float) -> None:
    values, weight = samples()
    with pytest.raises(InputError, match="positive and finite"):
        parzen_log_ratio(values[..., None], weight, 1 - weight, wrong, 0.1)


def test_parzen_tells_two_humps_where_a_gaussian_cannot() -> None:
    """Inside black and white, outside grey, of equal mean and variance."""
    rng = np.random.default_rng(0)
    inside = np.zeros((60, 60), np.float32)
    inside[:, :30] = 1.0
    humps = np.where(rng.random((60, 60)) < 0.5, 0.4, 0.6) + 0.01 * rng.standard_normal((60, 60))
    image = np.where(inside > 0, humps, 0.5 + 0.1005 * rng.standard_normal((60, 60))).astype(np.float32)[..., None]
    right = [np.mean((m.log_ratio(image, inside, 1 - inside, 1.0) > 0) == (inside > 0)) for m in (MODELS[1], MODELS[2])]
    assert right[0] < 0.65 < 0.75 < right[1]


@pytest.mark.parametrize("channels", [1, 3, 5, 7])
@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.density)
def test_any_number_of_channels(model: RegionModel, channels: int) -> None:
    """Independent channels add up; those that say nothing add nothing."""
    rng = np.random.default_rng(channels)
    disc = (np.hypot(*(np.mgrid[:50, :60] - np.array([25, 30])[:, None, None])) < 15).astype(np.float32)
    image = (0.3 + 0.3 * disc[..., None] + 0.05 * rng.standard_normal((50, 60, channels))).astype(np.float32)
    ratio = model.log_ratio(image, disc, 1 - disc, 1.0)
    assert np.mean((ratio > 0) == (disc > 0)) > 0.98
    doubled = model.log_ratio(np.concatenate([image, image], axis=2), disc, 1 - disc, 1.0)
    assert doubled == pytest.approx(2 * ratio, abs=1e-2)


def test_local_model_is_the_pixelwise_one() -> None:
    values = cv2.GaussianBlur(samples(4)[0], (0, 0), 2.0)
    inside = heaviside(np.linspace(-10, 10, 2000, dtype=np.float32).reshape(40, 50), 2.0)
    found = RegionModel("local", rho=0.05).log_ratio(values[..., None], inside, 1 - inside, 100.0)
    exact = blockwise_log_ratio_reference(values[..., None], inside, 5.0, 4e-4, 0.02)
    assert np.corrcoef(found.ravel(), exact.ravel())[0, 1] > 0.97


@pytest.mark.parametrize("density", DENSITIES)
def test_a_part_is_held_against_its_own_colours(density: Density) -> None:
    """A black and a white part before grey: as a whole the body's mean is the background's, each part's is not."""
    part = np.full((60, 80), -1, np.int32)
    part[20:40, 10:40], part[20:40, 40:70] = 0, 1
    rng = np.random.default_rng(0)
    image = np.where(part == 0, 0.2, np.where(part == 1, 0.8, 0.5)) + 0.03 * rng.standard_normal(part.shape)
    features, inside = image.astype(np.float32)[..., None], (part >= 0).astype(np.float32)
    near, wanted = nearest_part(part), np.ones(part.shape, bool)
    model = RegionModel(density, 0.06, 4e-4, 0.02, 0.03)
    ratio = log_ratio_by_part(model, features, inside, near, 100.0, wanted)
    assert np.mean((ratio > 0) == (part >= 0)) > 0.99
    one = model.log_ratio(features, (part == 0).astype(np.float32), 1 - inside, 100.0)
    place = near == 0
    if density != "local":  # whose window is cut off at the box, which changes nothing but the little it falls back on
        assert ratio[place] == pytest.approx(one[place], abs=1e-4)


def test_the_nearest_part_is_the_nearest() -> None:
    part = np.full((30, 40), -1, np.int32)
    part[10:15, 5:10], part[18:25, 25:33] = 3, 7
    found = nearest_part(part)
    rows, columns = np.nonzero(part >= 0)
    for r, c in np.random.default_rng(0).integers(0, 30, (60, 2)):
        d = np.hypot(rows - r, columns - c)
        assert d[part[rows, columns] == found[r, c]].min() <= d.min() + 0.5
    assert np.all(nearest_part(np.full((5, 5), -1, np.int32)) == -1)


def test_lines_of_known_ratios_end_where_the_ratio_turns() -> None:
    """+2 nats per px inside x = 41.3, -2 outside: the posterior sits there, whatever the start."""
    x = np.arange(90, dtype=np.float32)
    ratio = np.tile(np.clip(4.0 * (41.3 - x), -2.0, 2.0), (60, 1)).astype(np.float32)
    pixels = np.stack([np.linspace(37.0, 45.0, 20), np.linspace(10, 50, 20)], axis=1)
    face = np.where(x[None] < pixels[:, :1].min(), 0, -1).astype(np.int32)
    face_index = np.ascontiguousarray(np.broadcast_to(face[:1], (60, 90)))
    one, normals = np.zeros(20, np.int32), np.tile([1.0, 0.0], (20, 1))
    pixels[:, 0] = 37.0
    lines = (pixels, normals, one, np.ones(20, bool), np.ones(20))
    settings = LineSettings(16, 3.0, 1.0, 1.0, 0.25, 0.0, 1.0, 1.0, 1.0, 0.0)
    displacement, weight, evidence, target = ratio_lines(ratio, (face_index, one[:1]), lines, 8.0, settings)
    assert displacement == pytest.approx(41.3 - 37.0, abs=0.3)
    assert target[:, 0] == pytest.approx(pixels[:, 0] + displacement)
    assert np.all(weight > 1.0) and np.all(evidence > 3.0)


@cache
def seen_from_one_camera(channels: Channels = "lab") -> tuple[Capture, View, RenderedView]:
    scene = capture(StudioConfig(seed=2, views=2, frames=3))
    posed = Posed(scene.true_body, scene.true_poses[0])
    image = scene.frame(0).images[0]
    assert image is not None
    view = crop_view(image, scene.rig[0], posed, 0.15, channels)
    assert view is not None
    return scene, view, render(posed, view.camera)


@pytest.mark.parametrize("method", ["direct", "levelset"])
@pytest.mark.parametrize("statistics", ["part", "whole"])
@pytest.mark.parametrize("density", DENSITIES)
def test_every_model_measures_in_both_methods(density: Density, statistics: str, method: str) -> None:
    """At the true pose the contour stays: most points are matched within 2 px, and they differ between models."""
    scene, view, seen = seen_from_one_camera()
    cue = {"direct": DirectContour(), "levelset": LevelSetContour()}[method]
    colours = np.zeros((len(scene.body.segment_names), 7))
    contour = visible_contour(seen, 3.0)
    found = replace(cue, density=density, statistics=statistics).locate(view, seen, contour, 1.0, colours)  # type: ignore[arg-type]
    assert np.all(np.isfinite(found.displacement)) and np.all(np.isfinite(found.contrast))
    assert np.median(np.abs(found.displacement)) < 2.0 and np.mean(found.contrast > 0) > 0.3
    assert len(found.displacement) == len(found.contour) == len(found.contrast)
    other: Density = "global" if density != "global" else "parzen"
    differs = replace(cue, density=other, statistics=statistics).locate(view, seen, contour, 1.0, colours)  # type: ignore[arg-type]
    n = min(len(found.displacement), len(differs.displacement))
    assert np.abs(found.displacement[:n] - differs.displacement[:n]).max() > 0.1


def test_statistics_of_the_whole_body_on_lines_are_not_those_of_its_parts() -> None:
    scene, view, seen = seen_from_one_camera()
    contour, colours = visible_contour(seen, 3.0), np.zeros((len(scene.body.segment_names), 7))
    outer = contour[contour.outer]
    part = DirectContour(statistics="part").locate(view, seen, outer, 1.0, colours)
    whole = DirectContour(statistics="whole").locate(view, seen, contour, 1.0, colours)
    assert np.all(whole.contour.outer) and np.abs(part.displacement - whole.displacement).max() > 0.5
    plain = DirectContour().locate(view, seen, outer, 1.0, colours)
    np.testing.assert_array_equal(plain.displacement, part.displacement)


@pytest.mark.parametrize("cue", [DirectContour(), LevelSetContour()], ids=["direct", "levelset"])
def test_contours_of_a_surface_that_may_be_off_weigh_by_its_spread(cue: DirectContour | LevelSetContour) -> None:
    """The variance of the surface, in pixels at each point's depth, joins that of the measurement."""
    scene, view, seen = seen_from_one_camera()
    contour, colours = visible_contour(seen, 3.0), np.zeros((len(scene.body.segment_names), 7))
    contour = contour[contour.outer]
    exact, off = (c.locate(view, seen, contour, 1.0, colours) for c in (cue, replace(cue, surface_sigma=0.01)))
    np.testing.assert_array_equal(exact.displacement, off.displacement)
    assert isinstance(exact.term, PointNormalTerm | PointRayTerm) and isinstance(
        off.term, PointNormalTerm | PointRayTerm
    )
    spread = 1.0 / off.term.weight - 1.0 / exact.term.weight
    np.testing.assert_allclose(spread, (0.01 * view.camera.K[0, 0] * off.contour.inverse_depth) ** 2, rtol=1e-9)


def test_rounds_from_coarse_to_fine_reach_farther() -> None:
    """EM with a wide first round still ends in a finite contour, other than the narrow one's."""
    scene, view, seen = seen_from_one_camera("grey")
    contour, colours = visible_contour(seen, 3.0), np.zeros((len(scene.body.segment_names), 3))
    narrow = LevelSetContour(rounds=2).locate(view, seen, contour, 1.0, colours)
    wide = LevelSetContour(rounds=2, continuation=3.0).locate(view, seen, contour, 1.0, colours)
    assert np.median(np.abs(wide.displacement)) < 2.0
    assert np.abs(wide.displacement - narrow.displacement).max() > 0.2


@pytest.mark.parametrize("method", ["direct", "levelset"])
def test_one_line_of_a_session_chooses_the_model(method: str) -> None:
    config = tracker_settings({"method": method, "density": "parzen"}, "s.toml")
    scene = capture(StudioConfig(views=2, frames=2))
    angles = []
    for settings in (config, replace(config, density="local")):
        model = replace(build(scene.body, scene.rig, settings), searches=())  # they take their time
        angles.append(list(tracked(scene.frames(), model, scene.first_pose))[-1].pose.q)
    assert np.abs(angles[0] - angles[1]).max() > 1e-4


def test_an_unknown_model_is_an_error_that_names_those_there_are() -> None:
    with pytest.raises(InputError, match=r"'tracker.density' is 'histogram'.*'local', 'global' or 'parzen'"):
        tracker_settings({"density": "histogram"}, "s.toml")
    with pytest.raises(InputError, match="must be one of local, global, parzen"):
        RegionModel("histogram", 1.0, 1.0, 1.0, 1.0)  # type: ignore[arg-type]
    assert Settings().density == "local"
