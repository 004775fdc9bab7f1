"""Optic flow: known motions, the mask's boundary, motion edges, bad input, Middlebury."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.moving_texture import H, W, X, Y, limb_scene, moved, texture, turn
from twistcap.arrays import Bool, Float32
from twistcap.errors import InputError
from twistcap.flow import BROX_2004, PRESETS, FlowSettings, flow_confidence, moved_mask, optical_flow
from twistcap.flow.solver import assemble, data_weights, diffusivity, relax


def error(flow: Float32, truth: Float32, where: Bool | None = None) -> float:
    """Mean endpoint error, 6 px from the image's border."""
    inside = np.zeros(flow.shape[:2], bool)
    inside[6:-6, 6:-6] = True
    inside &= True if where is None else where
    return float(np.linalg.norm(flow - truth, axis=-1)[inside].mean())


MOTIONS = {
    "whole pixels": (np.eye(2), np.array([3.0, -2.0])),
    "parts of a pixel": (np.eye(2), np.array([0.3, 0.45])),
    "far": (np.eye(2), np.array([11.0, 6.5])),
    "turn": (turn(3.0), np.zeros(2)),
    "zoom": (1.04 * np.eye(2), np.zeros(2)),
}


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(("settings", "bound"), [("accurate", 0.05), ("fast", 0.12)])
def test_known_motion_of_a_smooth_texture(name: str, settings: str, bound: float) -> None:
    first, second, truth = moved(*MOTIONS[name])
    assert error(optical_flow(first, second, preset=settings), truth) < bound


def test_the_published_form_finds_a_known_motion() -> None:
    first, second, truth = moved(turn(2.0), np.array([2.5, -1.5]))
    assert error(optical_flow(first, second, settings=BROX_2004), truth) < 0.1


def test_channels_decide_together_and_bytes_are_as_good_as_floats() -> None:
    """Each channel alone shows a grating and so half of the motion; both together show all of it."""
    shift = np.array([1.5, -1.0])
    channels = [np.stack([0.5 + 0.3 * np.sin(0.4 * (x - d[0])), 0.5 + 0.3 * np.sin(0.4 * (y - d[1]))], axis=-1)
                for x, y, d in ((X, Y, np.zeros(2)), (X, Y, shift))]  # fmt: skip
    truth = np.broadcast_to(shift, (H, W, 2)).astype(np.float32)
    both = optical_flow(channels[0], channels[1])
    assert error(both, truth) < 0.03
    assert error(optical_flow(channels[0][..., 0], channels[1][..., 0]), truth) > 0.5
    quantised = optical_flow(*(np.rint(255 * c).astype(np.uint8) for c in channels))
    assert error(quantised, truth) < 0.05


def test_a_change_of_light_is_survived_by_the_gradient_alone() -> None:
    first, second, truth = moved(np.eye(2), np.array([2.0, 1.0]))
    brighter = second + np.float32(0.08)
    assert error(optical_flow(first, brighter), truth) < 0.05
    blind = replace(PRESETS["accurate"], gamma=0.0)
    assert error(optical_flow(first, brighter, settings=blind), truth) > 0.3


def split_scene(apart: float = 4.0) -> tuple[Float32, Float32, Float32, Bool]:
    """Left half moves right by `apart` / 2, the right half left: the truth, and the mask of the left half."""
    left = X < W / 2
    flow = np.stack([np.where(left, apart / 2, -apart / 2), np.zeros((H, W))], axis=-1).astype(np.float32)
    seen = X < W / 2  # the middle closes up: what is left of it in the second image was left before
    second = np.where(seen, texture(X - apart / 2, Y), texture(X + apart / 2, Y, seed=1))
    return np.where(left, texture(X, Y), texture(X, Y, seed=1)), second.astype(np.float32), flow, left


def test_a_motion_edge_stays_sharp() -> None:
    first, second, truth, _ = split_scene()
    band = (np.abs(X - W / 2) > 3) & (np.abs(X - W / 2) < 14)
    assert error(optical_flow(first, second, settings=replace(PRESETS["accurate"], median=0)), truth, band) < 0.15


def test_motion_outside_the_mask_does_not_leak_in() -> None:
    """The same left half beside a right half that moves otherwise, or as it does itself."""
    settings = replace(PRESETS["accurate"], search=None, alpha=30.0, median=0)  # smoothness reaches far
    first, second, truth, mask = split_scene()
    with_it = (
        np.where(mask, texture(X, Y), texture(X, Y, seed=1)),
        np.where(mask, texture(X - 2, Y), texture(X - 2, Y, seed=1)),
    )
    inner = mask & (X < W / 2 - 8)  # derivatives of the images themselves see a few pixels across
    far = inner & (X > W / 2 - 20)
    against = optical_flow(first, second, mask=mask, settings=settings)
    along = optical_flow(*(i.astype(np.float32) for i in with_it), mask=mask, settings=settings)
    unmasked = optical_flow(first, second, settings=settings)
    assert error(against, along, far) < 0.1
    assert error(against, truth, inner) < 0.1
    assert error(unmasked, truth, far) > 0.5


def test_the_linear_system_does_not_know_what_lies_off_the_mask() -> None:
    """One outer fixed point: exactly the same inside whatever flow and image lie outside."""
    rng = np.random.default_rng(0)
    mask = np.hypot(X - 60, Y - 48) < 30
    tensors = rng.normal(size=(H, 12, W)).astype(np.float32) ** 2
    flows = [rng.normal(size=(2, H, W)).astype(np.float32) for _ in range(2)]
    flows[1][:, mask] = flows[0][:, mask]
    out = []
    for u, v in flows:
        g = diffusivity(u, v, mask, 0.001)
        data = data_weights(tensors, np.zeros_like(u), np.zeros_like(v), 1.0, 0.001)
        relax(assemble(data, u, v, g, 1.0, mask), u, v, 7, 1.8)
        out.append((u[mask], v[mask]))
    np.testing.assert_array_equal(out[0], out[1])


@pytest.mark.parametrize(("preset", "degrees"), [("accurate", 22.0), ("fast", 14.0)])
def test_a_limb_may_move_farther_than_it_is_wide(preset: str, degrees: float) -> None:
    """A bar of 11 px whose end moves by 16 or 25 px."""
    first, second, truth, mask = limb_scene(degrees)
    assert np.linalg.norm(truth[mask], axis=-1).max() > 15
    flow = optical_flow(first, second, mask=mask, preset=preset)
    without = optical_flow(first, second, mask=mask, settings=replace(PRESETS[preset], search=None))
    tip = mask & (Y > 45)
    assert error(flow, truth, tip) < 1.5
    assert error(without, truth, tip) > 3.0
    np.testing.assert_array_equal(flow, optical_flow(first, second, mask=mask, preset=preset))


def test_confidence_falls_where_the_second_image_hides_the_first() -> None:
    still, hidden = X < 40, (X > 70) & (X < 77)
    bar = [np.abs(X - 65 - d) < 5 for d in (0, 8)]  # it comes to cover what is hidden
    first, second = (np.where(b, texture(X - d, Y, seed=1), texture(X, Y)).astype(np.float32)
                     for b, d in zip(bar, (0, 8), strict=True))  # fmt: skip
    confidence = flow_confidence(optical_flow(first, second), optical_flow(second, first))
    assert confidence[still].mean() > 0.9
    assert confidence[hidden].mean() < 0.5 * confidence[still].mean()
    exact = np.broadcast_to(np.float32([2.0, 1.0]), (H, W, 2)).astype(np.float32)
    np.testing.assert_allclose(flow_confidence(exact, -exact)[: H - 2, : W - 3], 1.0)
    assert flow_confidence(exact, -exact)[:, -1].max() == 0.0


def test_moved_mask_follows_the_flow() -> None:
    mask = np.zeros((20, 20), bool)
    mask[5:10, 5:10] = True
    flow = np.zeros((20, 20, 2), np.float32)
    flow[...] = (3.0, -2.0)
    np.testing.assert_array_equal(moved_mask(mask, flow), np.roll(mask, (-2, 3), axis=(0, 1)))


# --- bad input ----------------------------------------------------------------------------------------------------


def test_bad_input_is_told() -> None:
    with pytest.raises(InputError, match="alpha"):
        FlowSettings(alpha=0.0)
    image = texture(X, Y)
    broken = image.copy()
    broken[3, 4] = np.nan
    mask = np.ones((H, W), bool)
    for kwargs, images, word in (
        ({}, (image, image[:-1]), "same size"),
        ({}, (broken, image), "first image has values that are not finite"),
        ({}, (image, broken), "second image has values that are not finite"),
        ({}, (image[:0], image[:0]), "size"),
        ({}, (image[0], image[0]), "size"),
        ({"mask": mask[:-1]}, (image, image), "the mask has size"),
        ({"mask": ~mask}, (image, image), "no pixel"),
        ({"preset": "best"}, (image, image), "preset is 'best'"),
        ({"settings": FlowSettings(median=4)}, (image, image), "median"),
        ({"settings": FlowSettings(omega=2.0)}, (image, image), "omega"),
    ):
        with pytest.raises(InputError, match=word):
            optical_flow(*images, **kwargs)
    with pytest.raises(InputError, match="same"):
        flow_confidence(np.zeros((4, 4, 2), np.float32), np.zeros((4, 5, 2), np.float32))


def test_images_without_texture_give_no_motion() -> None:
    flat = np.full((40, 50), 0.5, np.float32)
    mask = np.zeros((40, 50), bool)
    mask[10:30, 20:30] = True
    for kwargs in ({}, {"mask": mask}, {"mask": mask, "preset": "fast"}):
        assert np.abs(optical_flow(flat, flat, **kwargs)).max() < 1e-3


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (7, 5), (17, 200)])
def test_small_and_odd_sizes(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform(size=(2, *shape)).astype(np.float32)
    mask = np.zeros(shape, bool)
    mask[0, 0] = True
    for kwargs in ({}, {"mask": mask}):
        flow = optical_flow(first, second, **kwargs)
        assert flow.shape == (*shape, 2) and flow.dtype == np.float32 and np.isfinite(flow).all()


# --- real images --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "bar"), [("RubberWhale", 0.11), ("Venus", 0.29)])
def test_middlebury(shared_data: Path, name: str, bar: float) -> None:
    """Baker et al. 2011, average endpoint error over all known pixels."""
    folder = shared_data / "flow_middlebury" / name
    first, second = (cv2.imread(str(folder / f"frame1{k}.png"), cv2.IMREAD_GRAYSCALE) for k in (0, 1))
    width, height = np.fromfile(folder / "flow10.flo", np.int32, 3)[1:]
    truth = np.fromfile(folder / "flow10.flo", np.float32, offset=12).reshape(height, width, 2)
    known = np.abs(truth).max(axis=-1) < 1e9
    assert np.linalg.norm(optical_flow(first, second) - truth, axis=-1)[known].mean() <= bar
