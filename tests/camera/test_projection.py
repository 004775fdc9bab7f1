"""Projections of pinholes and of scaled orthography: pixels, nearness, derivatives, crops."""

from __future__ import annotations

import numpy as np
import pytest

from support.finite_differences import check_jacobian
from twistcap.camera import Camera, ScaledView, look_at, pinhole
from twistcap.camera.projection import along, depth_at, project, projected
from twistcap.camera.scaled import REACH

K = np.array([[300.0, 0, 100], [0, 310.0, 130], [0, 0, 1.0]])
NEAR = Camera("near", K, look_at([3, 0.5, 1], [0, 0, 0.2]), (200, 260))
PARALLEL = ScaledView.of(NEAR, np.eye(4))
CAMERAS = (NEAR, PARALLEL, ScaledView.of(NEAR, np.eye(4), perspective=True))
POINTS = np.random.default_rng(0).uniform(-0.8, 0.8, (60, 3))


@pytest.mark.parametrize("camera", CAMERAS)
def test_nearness_is_linear_in_the_image_and_tells_the_depth(camera) -> None:
    a, b = POINTS[:30], POINTS[30:]
    (at_a, near_a), (at_b, near_b) = projected(camera, a), projected(camera, b)
    at, near = projected(camera, 0.3 * a + 0.7 * b)  # on the lines between them
    s = np.linalg.norm(at - at_a, axis=1) / np.linalg.norm(at_b - at_a, axis=1)
    np.testing.assert_allclose(near, (1 - s) * near_a + s * near_b, rtol=1e-12)
    axis = camera.rotation[2] if camera is PARALLEL else NEAR.T_cam_world[2, :3]
    depth = np.array([depth_at(n, camera.inverse_depth) for n in near_a])
    if camera is CAMERAS[2]:  # linear in the image, it has the depth of a parallel projection at the origin alone
        distance, *others = pinhole(camera.P, np.concatenate([np.zeros((1, 3)), a]))[1]
        np.testing.assert_allclose(depth + REACH, distance * (1 - distance / np.array(others)), atol=1e-12)
    else:
        np.testing.assert_allclose(depth - depth[0], (a - a[0]) @ axis, atol=1e-12)
    assert np.all(near_a > 0)


def test_what_lies_behind_a_pinhole_has_no_nearness() -> None:
    behind = NEAR.centre - POINTS @ np.diag([0, 0, 1.0]) - 2 * NEAR.T_cam_world[2, :3]
    assert np.all(projected(NEAR, behind)[1] == 0)
    assert np.all(projected(PARALLEL, behind)[1] > 0)


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_derivative_is_that_of_the_pixels(camera) -> None:
    pixels, depth, by_point = pinhole(camera.P, POINTS)
    there, w = project(camera.P, POINTS)
    np.testing.assert_allclose(pixels, there, rtol=1e-12)
    np.testing.assert_allclose(w * depth, 1.0, rtol=1e-12)
    check_jacobian(lambda step: project(camera.P, POINTS + step)[0], by_point, np.zeros(3), rtol=1e-6, atol=1e-5)
    a, b = 0.6, -1.3
    rows = [w[n] * np.array(along(camera.P, *pixels[n], a, b)) for n in range(len(POINTS))]
    np.testing.assert_allclose(rows, a * by_point[:, 0] + b * by_point[:, 1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
def test_crops_and_resized_images_keep_their_pixels(camera) -> None:
    pixels = projected(camera, POINTS)[0]
    crop = camera.cropped((20, 33), (90, 80))
    assert crop.size == (90, 80)
    np.testing.assert_allclose(projected(crop, POINTS)[0], pixels - [20, 33], atol=1e-9)
    half = camera.scaled(0.5)
    assert half.size == (100, 130)
    np.testing.assert_allclose(projected(half, POINTS)[0], 0.5 * pixels - 0.25, atol=1e-9)


def test_image_scale_at_the_body() -> None:
    nearness = np.array([0.5, 0.0, 0.25])
    assert NEAR.px_per_m(nearness) == pytest.approx(300.0 * 0.375)
    assert PARALLEL.px_per_m(nearness) == PARALLEL.scale
    assert NEAR.px_per_m(np.zeros(3)) == 0.0
