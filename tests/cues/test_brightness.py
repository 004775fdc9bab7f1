"""The brightness cue: what a template keeps, gives up and takes over from the present image."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.shapes import camera_at
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.cues.brightness import (
    Brightness,
)
from twistcap.cues.memory import Look, Retention, first_in_cells, remember, strongest_in_cells
from twistcap.cues.view import Picture, View
from twistcap.errors import InputError
from twistcap.render import SurfacePoints, render
from twistcap.terms.photometric import sample

Array = np.ndarray
BODY = humanoid()
CAMERA = camera_at((2.8, 0.7, 0.4))
POSED = Posed(BODY, Pose(np.eye(4), np.zeros(BODY.dof - 6)))
SEEN = render(POSED, CAMERA)
TOLERANCE = 0.012


def noise_image(seed: int, blur: float = 1.5) -> Array:
    height, width = SEEN.nearness_image.shape
    image = np.random.default_rng(seed).uniform(size=(height, width)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur), np.float32)


def in_sight(points: SurfacePoints) -> tuple[Array, Array]:
    """Pixels (N, 2) and visibility (N,) from the public projection and the depth image."""
    pixels, depth = CAMERA.project(points.at(POSED))
    column, row = np.rint(pixels).astype(int).T
    height, width = SEEN.nearness_image.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    surface = np.where(inside, SEEN.nearness_image[row.clip(0, height - 1), column.clip(0, width - 1)], 0.0)
    with np.errstate(divide="ignore"):
        return pixels, (surface > 0) & (depth > 0) & (depth < 1.0 / surface + TOLERANCE)


def test_first_in_cells_are_those_in_their_order() -> None:
    rng = np.random.default_rng(4)
    pixels, cell, border = rng.uniform(0, 60, (300, 2)), 7, 2
    occupied = np.zeros((10, 10), dtype=np.bool_)
    occupied[3] = True
    free, expected = occupied.copy(), dict[tuple[int, int], int]()
    order = rng.permutation(300)[:200]
    for n in order:
        column, row = np.floor(pixels[n] + 0.5).astype(int) - border
        place = row // cell, column // cell
        if min(row, column) >= 0 and not free[place] and place not in expected:
            expected[place] = n
    found = first_in_cells(pixels, order, cell, border, occupied)
    assert list(found) == [n for _, n in sorted(expected.items())]
    assert 20 < len(found) < 81
    for place in expected:
        free[place] = True
    np.testing.assert_array_equal(occupied, free)


def a_look(image: Array, exposure: Array | None = None) -> Look:
    picture = Picture(image)
    return Look(picture, picture.levels(2), SEEN, POSED, np.zeros(2) if exposure is None else exposure)


def test_kept_points_are_seen_alike_and_follow_slowly() -> None:
    image = noise_image(3)
    rule = Retention(9, "strongest", update=0.2, jump=0.06)
    first = remember(a_look(image), None, rule)
    rough = np.where(np.arange(len(first.trust)) % 3 == 0, 0.1, 0.02)[:, None, None]
    changed = replace(first, value=first.value + rough)
    kept = remember(a_look(image), changed, rule, fresh=False)
    pixels, visible = in_sight(first.points)
    expected = np.flatnonzero(visible & (rough[:, 0, 0] < rule.jump))
    np.testing.assert_array_equal(kept.points.local, first.points.local[expected])
    np.testing.assert_allclose(kept.value, first.value[expected] + 0.8 * 0.02, atol=1e-9)
    np.testing.assert_allclose(kept.pixels, pixels[expected], atol=1e-9)
    again = remember(a_look(image), changed, rule)  # other points take the empty cells
    assert len(kept.trust) < len(again.trust)


def test_values_at_all_levels_are_the_pyramids() -> None:
    image = noise_image(3)
    memory = remember(a_look(image), None, Retention(9, "middle"))
    assert memory.value.shape[1:] == (2, 1) and memory.gradient.shape[1:] == (2, 1, 2)
    for level in (0, 1):
        picture = Picture(image).level(level)[0]
        at = 0.5**level * memory.pixels + 0.5 * (0.5**level - 1)
        expected = [sample(picture, *pixel) for pixel in at]
        np.testing.assert_allclose(memory.samples(level)[0].value, [e[0] for e in expected], rtol=1e-6)
        np.testing.assert_allclose(memory.samples(level)[0].gradient, [e[1:3] for e in expected], atol=1e-6)
    assert np.isfinite(memory.inside).all() and memory.inside.max() > 5


def test_what_is_remembered_takes_the_exposure_of_the_frame() -> None:
    image, exposure = noise_image(3), np.array([0.1, -0.02])
    first = remember(a_look(image), None, Retention(9, "middle"))
    after = remember(a_look(1.1 * image - np.float32(0.02), exposure), first, Retention(9, "middle"), fresh=False)
    assert len(after.trust) > 0.9 * len(first.trust)
    at = [int(np.flatnonzero((first.points.local == p).all(axis=1))[0]) for p in after.points.local]
    np.testing.assert_allclose(after.value, 1.1 * first.value[at] - 0.02, atol=1e-3)


def test_hidden_points_are_remembered_for_some_frames() -> None:
    image, rule = noise_image(3), Retention(9, "middle", hidden=2, trust=0.8)
    memory = remember(a_look(image), None, rule)
    from_behind = render(POSED, camera_at((-2.8, -0.7, 0.4)))
    picture = Picture(noise_image(5)[: from_behind.mask.shape[0], : from_behind.mask.shape[1]])
    behind = Look(picture, picture.levels(2), from_behind, POSED)
    for missed in (1, 2, 3):
        memory = remember(behind, memory, rule)
        assert (memory.missed == missed).any() == (missed <= 2)
    assert not (memory.missed > 2).any()


def test_the_most_trusted_point_of_a_cell_stays() -> None:
    image, rule = noise_image(3), Retention(40, "middle", trusted_first=True)
    many = remember(a_look(image), None, Retention(5, "middle"))
    trust = np.random.default_rng(0).random(len(many.trust))
    kept = remember(a_look(image), replace(many, trust=trust), rule, fresh=False)
    row, column = (np.rint(many.pixels).astype(int) // 40).T[::-1]
    _, visible = in_sight(many.points)
    best = [trust[(row == r) & (column == c) & visible].max() for r, c in sorted({*zip(row, column, strict=True)})]
    np.testing.assert_array_equal(kept.trust, best)


def test_new_points_are_the_most_textured_of_each_free_cell() -> None:
    image, cell = noise_image(5), 8
    height, width = image.shape
    occupied = np.zeros((height // cell + 1, width // cell + 1), dtype=np.bool_)
    occupied[::2] = True
    rows, columns = strongest_in_cells(image, SEEN.nearness_image, True, cell, occupied)
    places = {((r - 2) // cell, (c - 2) // cell) for r, c in zip(rows, columns, strict=True)}
    assert len(places) == len(rows) > 20 and not any(occupied[p] for p in places)
    assert SEEN.mask[rows, columns].all()
    strength = np.zeros_like(image)
    strength[1:-1, 1:-1] = (image[1:-1, 2:] - image[1:-1, :-2]) ** 2 + (image[2:, 1:-1] - image[:-2, 1:-1]) ** 2
    strength[~away_from_rims()] = 0.0
    for r, c in zip(rows, columns, strict=True):
        top, left = (r - 2) // cell * cell + 2, (c - 2) // cell * cell + 2
        assert strength[r, c] == strength[top : min(top + cell, height - 2), left : min(left + cell, width - 2)].max()


def away_from_rims() -> Array:
    """(H, W) where the body goes on, without a jump in depth of 4 cm, two pixels off in each direction."""
    w = SEEN.nearness_image.astype(float)
    away = w > 0
    for shift in ((-2, 0), (2, 0), (0, -2), (0, 2)):
        other = np.roll(w, shift, axis=(0, 1))
        away &= (other > 0) & (np.abs(w - other) <= 0.04 * w * other)
    return away


def test_templates_follow_the_image_slowly_and_fill_up_again() -> None:
    cue = Brightness(points=120, update=0.2)
    first_image, second_image = noise_image(6), noise_image(6) + np.float32(0.02)
    first = cue.remember(View(CAMERA, first_image), SEEN, POSED, None, True)
    second = cue.remember(View(CAMERA, second_image), SEEN, POSED, first, True)
    assert 60 < len(first.points) <= len(second.points) < 400
    unfilled = cue.remember(View(CAMERA, second_image), SEEN, POSED, first, False)
    kept = len(unfilled.points)
    assert 0 < kept <= len(first.points)
    np.testing.assert_array_equal(unfilled.points.local, second.points.local[:kept])
    np.testing.assert_allclose(second.value[:kept], first.value[:kept] + 0.2 * 0.02, atol=1e-3)
    coarse = second.blurred(3.0).value  # of the last image as it is
    np.testing.assert_allclose(coarse, first.blurred(3.0).value[: len(coarse)] + 0.02, atol=1e-3)


def test_bad_settings_are_told() -> None:
    for wrong in ({"sigma": 0.0}, {"share": float("nan")}):
        with pytest.raises(InputError, match=r"Brightness: .* is "):
            Brightness(**wrong)
