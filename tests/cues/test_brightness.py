"""The brightness cue: what a template keeps, gives up and takes over from the present image."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.shapes import camera_at
from support.twins import check_twin
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.cues.brightness import (
    LOOSE_CLOTHES,
    Brightness,
    Template,
    refreshed,
    strongest_in_cells,
    template_values,
    unmoved,
    visible_points,
)
from twistcap.cues.view import View
from twistcap.errors import InputError
from twistcap.render import SurfacePoints, render
from twistcap.render.view import surface_points
from twistcap.terms.photometric import sample

Array = np.ndarray
BODY = humanoid()
CAMERA = camera_at((2.8, 0.7, 0.4))
POSED = Posed(BODY, Pose(np.eye(4), np.zeros(BODY.dof - 6)))
SEEN = render(POSED, CAMERA)
TOLERANCE = 0.012


def noise_image(seed: int, blur: float = 1.5) -> Array:
    height, width = SEEN.inverse_depth_image.shape
    image = np.random.default_rng(seed).uniform(size=(height, width)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur), np.float32)


def places(n: int = 400) -> SurfacePoints:
    rng = np.random.default_rng(1)
    return surface_points(BODY, BODY.faces[rng.integers(len(BODY.faces), size=n)], rng.dirichlet(np.ones(3), n))


def in_sight(points: SurfacePoints) -> tuple[Array, Array]:
    """Pixels (N, 2) and visibility (N,) from the public projection and the depth image."""
    pixels, depth = CAMERA.project(points.at(POSED))
    column, row = np.rint(pixels).astype(int).T
    height, width = SEEN.inverse_depth_image.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    surface = np.where(inside, SEEN.inverse_depth_image[row.clip(0, height - 1), column.clip(0, width - 1)], 0.0)
    with np.errstate(divide="ignore"):
        return pixels, (surface > 0) & (depth > 0) & (depth < 1.0 / surface + TOLERANCE)


def test_visible_points_are_those_that_the_depth_image_shows() -> None:
    points = places()
    _, expected = in_sight(points)
    found = visible_points(CAMERA.P, points.bound_to(POSED), SEEN.inverse_depth_image, TOLERANCE)
    np.testing.assert_array_equal(found, expected.astype(float))
    assert 0.2 < expected.mean() < 0.8


def test_a_point_behind_the_camera_is_not_visible() -> None:
    points, turned = places(50), -CAMERA.P  # the same pixels, from the other side
    assert not visible_points(turned, points.bound_to(POSED), SEEN.inverse_depth_image, TOLERANCE).any()


def test_a_new_template_holds_the_images_values_and_nan_outside() -> None:
    image, points = noise_image(2), places()
    value, gradient = template_values(CAMERA.P, points.bound_to(POSED), image)
    expected = np.array([sample(image, u, v) for u, v in CAMERA.project(points.at(POSED))[0]], dtype=float)
    inside = expected[:, 3] == 1
    assert inside.any()
    np.testing.assert_allclose(value[inside], expected[inside, 0], rtol=1e-6)
    np.testing.assert_allclose(gradient[inside], expected[inside, 1:3], rtol=1e-5, atol=1e-7)
    assert np.all(np.isnan(value[~inside]))
    elsewhere = CAMERA.cropped((200, 0), CAMERA.size)  # the body's right half lies left of this image
    assert np.isnan(template_values(elsewhere.P, points.bound_to(POSED), image)[0]).any()


@pytest.mark.parametrize("cell", [3, 9])
def test_refreshing_agrees_with_its_twin(cell: int) -> None:
    points, rng = places(), np.random.default_rng(4)
    image = noise_image(3)
    value, gradient = template_values(CAMERA.P, points.bound_to(POSED), image)
    value += rng.normal(0, 0.05, value.shape)  # some points have changed too much to be kept
    value[7], image[100:104] = np.nan, np.nan
    height, width = SEEN.inverse_depth_image.shape
    grid = np.zeros((height // cell + 1, width // cell + 1), dtype=np.bool_)
    grid[::3] = True
    _, _, kept = check_twin(
        refreshed, CAMERA.P, points.bound_to(POSED), (value, gradient), image, SEEN.inverse_depth_image,
        (TOLERANCE, 0.2, 0.06), cell, grid, rtol=1e-4, atol=1e-6,
    )  # fmt: skip
    assert 10 < len(kept) < in_sight(points)[1].sum()


def test_reading_and_choosing_points_agree_with_their_twins() -> None:
    points, image, before = places(), noise_image(3), noise_image(6)
    before[100:104] = np.nan
    elsewhere = CAMERA.cropped((200, 0), CAMERA.size).P
    for P in (CAMERA.P, elsewhere, -CAMERA.P):
        check_twin(template_values, P, points.bound_to(POSED), before, rtol=1e-4, atol=1e-6)
        check_twin(unmoved, P, points.bound_to(POSED), before, image, np.array([3.0, -2.5]), rtol=1e-4, atol=1e-6)
        check_twin(visible_points, P, points.bound_to(POSED), SEEN.inverse_depth_image, TOLERANCE)
    height, width = image.shape
    for cell in (1, 8):
        occupied = np.zeros((height // cell + 1, width // cell + 1), dtype=np.bool_)
        occupied[::2] = True
        rows, _ = check_twin(strongest_in_cells, image, SEEN.inverse_depth_image, cell, occupied)
        assert len(rows) > 20


def test_new_points_are_the_most_textured_of_each_free_cell() -> None:
    image, cell = noise_image(5), 8
    height, width = image.shape
    occupied = np.zeros((height // cell + 1, width // cell + 1), dtype=np.bool_)
    occupied[::2] = True
    rows, columns = strongest_in_cells(image, SEEN.inverse_depth_image, cell, occupied)
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
    w = SEEN.inverse_depth_image.astype(float)
    away = w > 0
    for shift in ((-2, 0), (2, 0), (0, -2), (0, 2)):
        other = np.roll(w, shift, axis=(0, 1))
        away &= (other > 0) & (np.abs(w - other) <= 0.04 * w * other)
    return away


def test_templates_follow_the_image_slowly_and_fill_up_again() -> None:
    cue = Brightness(points=120, update=0.2, support="none")
    first_image, second_image = noise_image(6), noise_image(6) + np.float32(0.02)
    first = cue.remember(View(CAMERA, first_image), SEEN, POSED, None, True)
    second = cue.remember(View(CAMERA, second_image), SEEN, POSED, first, True)
    assert 60 < len(first.points) <= len(second.points) < 400
    unfilled = cue.remember(View(CAMERA, second_image), SEEN, POSED, first, False)
    kept = len(unfilled.points)
    assert 0 < kept <= len(first.points)
    np.testing.assert_array_equal(unfilled.points.local, second.points.local[:kept])
    np.testing.assert_allclose(second.samples.value[:kept], first.samples.value[:kept] + 0.2 * 0.02, atol=1e-3)
    coarse = second.blurred(3.0).value  # of the last image as it is
    np.testing.assert_allclose(coarse, first.blurred(3.0).value[: len(coarse)] + 0.02, atol=1e-3)


def carried_image(posed: Posed, before: Array) -> Array:
    """The image after a motion from `POSED`: the body takes its picture along, and what lies behind stays."""
    seen = render(posed, CAMERA)
    rows, columns = (i.astype(np.int32) for i in np.nonzero(seen.mask))
    values, _ = template_values(CAMERA.P, seen.surface_points(rows, columns).bound_to(POSED), before)
    image = before.copy()
    image[rows, columns] = np.where(np.isfinite(values), values, 0.5)
    return image


def after_a_step(cue: Brightness, image: Array, posed: Posed) -> tuple[Template, Template, Array]:
    """The template of a first frame, that of a second one, and where the first one's points are in that (N, 2)."""
    first = cue.remember(View(CAMERA, noise_image(8, 3.0)), SEEN, POSED, None, True)
    second = cue.remember(View(CAMERA, image), render(posed, CAMERA), posed, first, True)
    return first, second, CAMERA.project(second.points.at(posed))[0]


def shifted() -> Posed:
    root = np.eye(4)
    root[:3, 3] = (0.0, 0.05, 0.01)
    return Posed(BODY, Pose(root, np.zeros(BODY.dof - 6)))


def test_a_part_whose_brightness_disagrees_loses_its_say() -> None:
    posed = shifted()
    image, torso = carried_image(posed, noise_image(8, 3.0)), BODY.segment("torso")
    rough = 0.15 * np.random.default_rng(0).normal(size=image.shape)
    image = (image + np.where(render(posed, CAMERA).part == torso, rough, 0.0)).astype(np.float32)
    cue = Brightness(support="robust", jump=1.0)
    _, second, _ = after_a_step(cue, image, posed)
    others = [BODY.segment(name) for name in ("pelvis", "femur_r", "femur_l", "head")]
    assert second.excess[torso] > 1.3 > 1.1 > second.excess[others].max() >= 1.0
    term = cue.term(View(CAMERA, image), render(posed, CAMERA), second, 1)
    own = second.points.part == torso
    _, plain, _ = after_a_step(Brightness(support="none", jump=1.0), image, posed)
    np.testing.assert_array_equal(plain.excess, 1.0)
    assert np.median(term.weight[own]) < 0.7 * np.median(term.weight[~own])


def test_of_a_part_that_is_hidden_nothing_is_learnt() -> None:
    posed, cue = shifted(), Brightness(support="robust", jump=1.0)
    image = carried_image(posed, noise_image(8, 3.0))
    first = cue.remember(View(CAMERA, noise_image(8, 3.0)), SEEN, POSED, None, True)
    hidden = first.points.part == BODY.segment("torso")
    assert hidden.sum() > 20
    unseen = replace(first, trust=np.where(hidden, 0.0, first.trust))
    after = cue.remember(View(CAMERA, image), render(posed, CAMERA), posed, unseen, True)
    assert after.excess[BODY.segment("torso")] == first.excess[BODY.segment("torso")] == 1.0


def test_bad_settings_are_told() -> None:
    for wrong in ({"sigma": 0.0}, {"share": float("nan")}, {"most": 0.5}, {"slide": -1.0}):
        with pytest.raises(InputError, match="brightness: sigma, scale, jump and share must be positive"):
            Brightness(**wrong)


def test_points_under_something_that_stands_still_lose_trust() -> None:
    posed, before = shifted(), noise_image(8, 3.0)
    image = carried_image(posed, before)
    middle = int(np.median(np.nonzero(SEEN.mask)[0]))
    image[middle:] = before[middle:]  # the lower half does not move
    first, second, pixels = after_a_step(replace(LOOSE_CLOTHES, jump=1.0, most=2.0), image, posed)
    above, below = pixels[:, 1] < middle - 6, pixels[:, 1] > middle + 6
    assert min(above.sum(), below.sum()) > 40
    assert np.median(second.trust[above]) >= 0.95 * np.median(first.trust) > 1.5 * np.median(second.trust[below])


def test_what_did_not_change_is_told_at_the_pixels_of_the_frame_before() -> None:
    image = noise_image(9)
    shift = np.array([7.0, -4.0])
    moved = np.roll(image, (-4, 7), axis=(0, 1))
    change, pixels = unmoved(CAMERA.P, places().bound_to(POSED), image, moved, shift)
    np.testing.assert_allclose(pixels, CAMERA.project(places().at(POSED))[0], atol=1e-9)
    known = np.isfinite(change)
    assert known.mean() > 0.8
    np.testing.assert_allclose(change[known], 0.0, atol=1e-6)


def test_steep_places_count_less_where_the_surface_may_slide() -> None:
    view = View(CAMERA, noise_image(10))
    template = Brightness().remember(view, SEEN, POSED, None, True)
    slope = np.linalg.norm(template.samples.gradient, axis=1)
    cue = Brightness(sigma=0.01, slide=0.002, share=1.0)
    term = cue.term(view, SEEN, template, -1)
    seen = term.weight > 0
    expected = 0.01**2 + (0.002 * SEEN.px_per_m * slope) ** 2
    np.testing.assert_allclose(term.weight[seen] * expected[seen], template.trust[seen], rtol=1e-9)
    np.testing.assert_allclose(term.scale, cue.scale * np.sqrt(expected))
