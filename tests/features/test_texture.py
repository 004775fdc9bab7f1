"""Texture channels: total variation flow, structure tensor, local scale, and what they tell apart."""

from __future__ import annotations

import numpy as np
import pytest

from reproduce.scenes.textures import DIFFERENCES, Difference, texture_scene
from reproduce.segment import segment
from support.readable import tv_step_reference
from twistcap.errors import InputError
from twistcap.features import Channels, Texture, feature_channels
from twistcap.features.texture import flow_speed, grid_planes, structure_tensor, structure_tensor_reference
from twistcap.features.tvflow import tv_step
from twistcap.region.models import RegionModel

PAPERS = Texture(resolution=1, blend=True)
COUNTS: dict[Channels, int] = {"grey": 1, "lab": 3, "grey+texture": 5, "lab+texture": 7}
MODEL = RegionModel("global")


def noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).random(shape).astype(np.float32)


def stripes(wavelength: float) -> np.ndarray:
    x = np.arange(160)
    return np.tile(0.5 + 0.15 * np.sin(2.0 * np.pi * x / wavelength), (40, 1)).astype(np.float32)


@pytest.mark.parametrize("shape", [(3, 19, 30), (1, 8, 1), (2, 1, 5)])
def test_flow_as_its_twin(shape: tuple[int, ...]) -> None:
    u = noise(1, *shape)
    assert tv_step(u, 0.3, 0.01) == pytest.approx(tv_step_reference(u, 0.3, 0.01), abs=2e-6)


def test_flow_keeps_the_mean_and_new_extremes_away() -> None:
    u = noise(2, 3, 30, 40)
    after = tv_step(u, 5.0, 1e-3)
    assert after.mean(axis=(1, 2)) == pytest.approx(u.mean(axis=(1, 2)), abs=1e-5)
    assert np.all(after >= u.min() - 1e-5) and np.all(after <= u.max() + 1e-5)


@pytest.mark.parametrize("width", [4, 10])
def test_flow_lowers_a_bump_at_two_over_its_width(width: int) -> None:
    u = np.zeros((1, 8, 120), dtype=np.float32)
    u[:, :, 55 : 55 + width] = 0.8
    tau, steps = 0.005, 60
    for _ in range(steps):
        u = tv_step(u, tau, 1e-4)
    top = u[0, 4, 55 + width // 2]
    assert 0.8 - top == pytest.approx(2.0 * tau * steps / width, rel=0.03)


def test_flow_lowers_a_disc_at_four_over_its_diameter() -> None:
    """Within what the grid's staircase adds to the length of its rim."""
    y, x = np.mgrid[:81, :81] - 40
    disc = np.hypot(x, y) < 16.0
    u = disc.astype(np.float32)[None]
    for _ in range(40):
        u = tv_step(u, 0.02, 1e-3)
    assert 1.0 - u[0, disc].mean() == pytest.approx(4.0 / 32.0 * 0.8, rel=0.15)


def test_an_edge_in_one_channel_holds_another() -> None:
    """The diffusivity is common: a faint step survives beside a strong one, and blurs without it."""
    step = (np.arange(40) >= 20).astype(np.float32)
    faint, strong = np.tile(0.02 * step, (10, 1)), np.tile(step, (10, 1))
    alone, held = tv_step(faint[None], 0.5, 0.01)[0], tv_step(np.stack([faint, strong]), 0.5, 0.01)[0]
    assert 0.02 - np.ptp(held[5, 19:21]) < 0.25 * (0.02 - np.ptp(alone[5, 19:21]))


def test_structure_tensor_as_its_twin() -> None:
    light = noise(3, 17, 22)
    assert structure_tensor(light, 0.2, 0.1) == pytest.approx(structure_tensor_reference(light, 0.2, 0.1), abs=1e-6)


def test_the_grid_has_means_over_blocks_and_half_a_block_at_the_border() -> None:
    light = noise(3, 17, 22)
    blocks = grid_planes([light], 2)
    assert blocks.shape == (1, 9, 11)
    assert blocks[0, 3, 4] == pytest.approx(light[6:8, 8:10].mean(), abs=1e-6)
    assert blocks[0, 8, 4] == pytest.approx(light[16:, 8:10].mean(), abs=1e-6)


@pytest.mark.parametrize("channels", COUNTS)
@pytest.mark.parametrize("texture", [Texture(), PAPERS])
def test_shapes_and_ranges(channels: Channels, texture: Texture) -> None:
    image = np.random.default_rng(4).integers(0, 256, (41, 31, 3), dtype=np.uint8)
    features = feature_channels(image, channels, texture)
    assert features.shape == (41, 31, COUNTS[channels]) and features.dtype == np.float32
    assert features.flags.c_contiguous and np.all(np.isfinite(features))
    assert features[..., 0].min() >= -1e-5 and features[..., 0].max() <= 1.0 + 1e-5
    if channels.endswith("texture"):
        J, scale = features[..., -4:-1], features[..., -1]
        assert J[..., :2].min() >= 0.0 and J.max() <= 0.2
        assert scale.min() >= 0.0 and scale.max() <= 1.0 + 1e-5
        assert np.ptp(scale) > 0.01


def test_a_grey_image_has_no_colours() -> None:
    grey = noise(5, 20, 24)
    assert feature_channels(grey, "lab").shape[2] == 1
    assert np.array_equal(feature_channels(grey, "lab+texture"), feature_channels(grey, "grey+texture"))


def test_bytes_and_floats_agree() -> None:
    image = np.random.default_rng(6).integers(0, 256, (40, 50), dtype=np.uint8)
    floats = feature_channels(image.astype(np.float32) / 255.0, "grey+texture")
    assert feature_channels(image, "grey+texture") == pytest.approx(floats, abs=1e-4)


@pytest.mark.parametrize("texture", [Texture(), PAPERS])
def test_a_quarter_turn_swaps_the_tensor(texture: Texture) -> None:
    image = noise(7, 40, 60)
    features, turned = (feature_channels(i, "grey+texture", texture) for i in (image, np.rot90(image).copy()))
    back = np.rot90(turned, -1)
    assert back[..., 1] == pytest.approx(features[..., 2], abs=1e-4)
    assert back[..., 2] == pytest.approx(features[..., 1], abs=1e-4)
    assert back[..., 3] == pytest.approx(-features[..., 3], abs=1e-4)
    assert back[..., 4] == pytest.approx(features[..., 4], abs=1e-3)


def test_scale_grows_with_the_wavelength() -> None:
    found = [feature_channels(stripes(w), "grey+texture")[8:-8, 30:-30, 4].mean() for w in (4.0, 6.0, 9.0, 13.0, 20.0)]
    assert np.all(np.diff(found) > 0.02)


def test_speed_is_two_over_the_width_of_a_stripe() -> None:
    """Square stripes: all of them move, alternately up and down, at both their edges."""
    x = np.arange(160)
    light = np.tile(np.where(x // 5 % 2 == 0, 0.3, 0.7), (40, 1)).astype(np.float32)
    speed = flow_speed(light, Texture(flow_time=0.06, epsilon=1e-3, resolution=1))
    assert speed[20, 60:100] == pytest.approx(2.0 / 5.0, rel=0.05)


@pytest.mark.parametrize("channels", ["grey+texture", "lab+texture"])
@pytest.mark.parametrize("value", [0, 90, 255])
def test_nothing_to_see_is_finite(channels: Channels, value: int) -> None:
    features = feature_channels(np.full((33, 20, 3), value, dtype=np.uint8), channels)
    assert np.all(np.isfinite(features))
    assert features[..., -4:-1] == pytest.approx(0.0, abs=1e-6)
    assert features[..., -1] == pytest.approx(1.0, abs=1e-4)  # the largest scale


@pytest.mark.parametrize("bad", [{"tau": float("nan")}, {"largest": 1.0}, {"resolution": 0}, {"steps": -1}])
def test_bad_settings(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"[Tt]exture"):
        Texture(**bad)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("difference", DIFFERENCES)
def test_scenes_have_one_histogram(difference: Difference) -> None:
    scene = texture_scene(difference, 3)
    inside, outside = scene.image[scene.region], scene.image[~scene.region]
    assert inside.mean() == pytest.approx(outside.mean(), abs=1e-4)
    assert inside.std() == pytest.approx(outside.std(), abs=1e-4)


def overlap(scene_seed: int, difference: Difference, channels: Channels) -> float:
    scene = texture_scene(difference, scene_seed)
    found = segment(feature_channels(scene.image, channels), scene.start, MODEL)
    return float((found & scene.region).sum() / (found | scene.region).sum())


@pytest.mark.parametrize("difference", DIFFERENCES)
def test_texture_tells_apart_what_grey_cannot(difference: Difference) -> None:
    """All eight seeds: benchmarks/texture.py."""
    assert overlap(0, difference, "grey+texture") >= 0.9
    assert overlap(0, difference, "grey") <= 0.6


def test_segment_finds_a_bright_disc_and_refuses_nonsense() -> None:
    y, x = np.mgrid[:60, :80]
    disc, start = np.hypot(x - 40, y - 30) < 18, np.hypot(x - 48, y - 28) < 7
    image = (0.3 + 0.4 * disc + 0.05 * np.random.default_rng(8).standard_normal(disc.shape)).astype(np.float32)
    found = segment(image[..., None], start, MODEL)
    assert (found & disc).sum() / (found | disc).sum() > 0.95
    with pytest.raises(InputError, match="both inside and outside"):
        segment(image[..., None], np.ones_like(start), MODEL)
    with pytest.raises(InputError, match="one size"):
        segment(image[..., None], start[1:], MODEL)
