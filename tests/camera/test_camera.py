"""Cameras: OpenCV's projection, its inverse, rays, pixel grids and rectification."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twistcap import se3
from twistcap.camera import Camera, Rectifier, Rig, distort, look_at, undistort

DIST = np.array([-0.21, 0.09, 0.0012, -0.0008, -0.015])
K = np.array([[410.0, 0, 322.7], [0, 405.0, 236.2], [0, 0, 1]])


def camera(dist: np.ndarray = DIST) -> Camera:
    return Camera("c", K, look_at((3.0, -2.0, 1.6), (0.1, 0.2, 0.9)), (640, 480), dist)


def cloud(n: int = 200) -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.8, 0.8, (n, 3)) + np.array([0.1, 0.2, 0.9])


@pytest.mark.parametrize("dist", [DIST, np.zeros(5)])
def test_projection_is_opencvs(dist: np.ndarray) -> None:
    c = camera(dist)
    rvec, tvec = se3.log_rotation(c.T_cam_world[:3, :3]), c.T_cam_world[:3, 3]
    expected, _ = cv2.projectPoints(cloud(), rvec, tvec, K, dist)
    pixels, depth = c.project(cloud())
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(depth, se3.apply(c.T_cam_world, cloud())[:, 2], atol=1e-14)


def test_projection_matrix_is_the_pinholes_projection() -> None:
    c = camera()
    homogeneous = cloud() @ c.P[:, :3].T + c.P[:, 3]
    np.testing.assert_allclose(c.pinhole().project(cloud())[0], homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-10)


def test_points_at_or_behind_the_camera_plane_have_no_pixel() -> None:
    c = Camera("c", K, np.eye(4), (640, 480), DIST)
    pixels, depth = c.project([[0.0, 0.0, 0.0], [0.3, 0.1, 0.0], [0.3, 0.1, -2.0], [0.3, 0.1, 2.0]])
    np.testing.assert_array_equal(np.isnan(pixels), [[True, True]] * 3 + [[False, False]])
    np.testing.assert_array_equal(depth, [0, 0, -2, 2])


@given(
    st.tuples(st.floats(-0.25, 0.25), st.floats(-0.1, 0.1), st.floats(-0.003, 0.003), st.floats(-0.003, 0.003)),
    st.floats(0, 0.7),
    st.floats(0, 2 * np.pi),
)
@settings(deadline=None, max_examples=80)
def test_undistort_undoes_distort(terms: tuple[float, ...], radius: float, angle: float) -> None:
    dist = np.array([*terms, 0.0])
    xy = radius * np.array([[np.cos(angle), np.sin(angle)]])
    np.testing.assert_allclose(undistort(distort(xy, dist), dist), xy, atol=1e-9)


def test_pixels_beyond_the_fold_are_nan_not_a_guess() -> None:
    """r (1 − ½ r²) never exceeds 0.5443: nothing projects to a radius of 0.7."""
    dist = np.array([-0.5, 0, 0, 0, 0])
    result = undistort(np.array([[0.7, 0.0], [0.3, 0.0]]), dist)
    assert np.all(np.isnan(result[0]))
    np.testing.assert_allclose(distort(result[1], dist), [0.3, 0.0], atol=1e-9)


def test_rays_go_through_their_points() -> None:
    c = camera()
    X = cloud()
    n, m = c.rays(c.project(X)[0])
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-14)
    assert np.all(np.linalg.norm(np.cross(X, n) - m, axis=1) < 1e-9)
    assert np.all(np.sum(n * (X - c.centre), axis=1) > 0)  # towards the scene
    np.testing.assert_allclose(np.cross(np.broadcast_to(c.centre, n.shape), n), m, atol=1e-14)


@pytest.mark.parametrize("factor", [3.0, 0.5, 0.25])
def test_scaled_keeps_pixel_centres_at_integers(factor: float) -> None:
    big, _ = camera().scaled(factor).project(cloud())
    np.testing.assert_allclose(big, (camera().project(cloud())[0] + 0.5) * factor - 0.5, atol=1e-9)


def test_scaled_agrees_with_a_resized_image() -> None:
    """A dot in an image shrunk by averaging lies where the scaled camera says."""
    X = np.array([0.1, 0.2, 0.9])
    small = camera().scaled(0.25)
    shrunk = cv2.resize(dots(camera().project(X[None])[0], (640, 480), 8.0), small.size, interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(centroid(shrunk, small.project(X)[0], 12), small.project(X)[0], atol=0.02)


def test_scaled_to_a_size_that_does_not_divide_follows_the_true_size() -> None:
    c = Camera("c", K, camera().T_cam_world, (641, 479)).scaled(0.5)
    assert c.size == (320, 240)
    full = Camera("c", K, camera().T_cam_world, (641, 479)).project(cloud())[0]
    np.testing.assert_allclose(c.project(cloud())[0], (full + 0.5) * [320 / 641, 240 / 479] - 0.5, atol=1e-9)


def test_cropped_moves_the_origin() -> None:
    c = camera().cropped((37, 101), (200, 150))
    assert c.size == (200, 150)
    np.testing.assert_allclose(c.project(cloud())[0], camera().project(cloud())[0] - [37, 101], atol=1e-9)


def dots(at: np.ndarray, size: tuple[int, int], sigma: float = 2.5) -> np.ndarray:
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    image = np.zeros((size[1], size[0]), np.float32)
    for u, v in at:
        image += np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / sigma**2).astype(np.float32)
    return image


def centroid(image: np.ndarray, near: np.ndarray, reach: int) -> np.ndarray:
    u, v = np.round(near).astype(int)
    patch = image[v - reach : v + reach + 1, u - reach : u + reach + 1]
    y, x = np.mgrid[v - reach : v + reach + 1, u - reach : u + reach + 1]
    return np.array([(patch * x).sum(), (patch * y).sum()]) / patch.sum()


def test_rectified_dots_lie_where_the_pinhole_projects_them() -> None:
    c = camera()
    pixels = np.stack(np.meshgrid(np.arange(60, 600, 80), np.arange(60, 440, 75)), axis=-1).reshape(-1, 2) + 0.37
    n, _ = c.rays(pixels)
    X = c.centre + 3.0 * n
    rectified = Rectifier(c)(dots(c.project(X)[0], c.size))
    expected = c.pinhole().project(X)[0]
    inside = np.all((expected > 14) & (expected < np.array(c.size) - 15), axis=1)
    assert inside.sum() > 20
    found = np.array([centroid(rectified, e, 11) for e in expected[inside]])
    assert np.abs(expected - pixels).max() > 5  # the distortion is worth the trouble
    assert np.linalg.norm(found - expected[inside], axis=1).max() < 0.1


def test_rectifier_of_a_pinhole_returns_the_image_itself() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    assert Rectifier(camera(np.zeros(5)))(image) is image


def test_rectified_masks_stay_masks() -> None:
    mask = (dots(np.array([[90.0, 80.0]]), (640, 480), 20.0) > 0.5).astype(np.uint8) * 255
    assert set(np.unique(Rectifier(camera())(mask, nearest=True))) == {0, 255}


def test_look_at_centres_the_target_with_up_upward() -> None:
    eye, target = np.array([3.0, -2.0, 1.6]), np.array([0.1, 0.2, 0.9])
    c = Camera("c", K, look_at(eye, target), (640, 480))
    np.testing.assert_allclose(c.centre, eye, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(c.T_cam_world[:3, :3]), 1.0)
    at, above = c.project(np.stack([target, target + np.array([0, 0, 0.1])]))[0]
    np.testing.assert_allclose(at, K[:2, 2], atol=1e-9)
    assert above[1] < at[1] and abs(above[0] - at[0]) < 1e-9


def test_a_rig_scales_and_straightens_all_its_cameras() -> None:
    rig = Rig((camera(), camera(np.zeros(5))))
    assert len(rig) == 2 and rig.names == ("c", "c")
    assert all(c.size == (320, 240) for c in rig.scaled(0.5))
    assert not any(np.any(c.dist) for c in rig.pinhole())


def test_a_fisheye_lens_is_opencvs_and_is_undone() -> None:
    rng = np.random.default_rng(0)
    fish = replace(camera(np.array([0.08, -0.02, 0.004, -0.001, 0.0])), fisheye=True)
    points = rng.uniform(-1.5, 1.5, (40, 3)) + np.array([0.0, 0.0, 1.7])
    moved = points @ fish.T_cam_world[:3, :3].T + fish.T_cam_world[:3, 3]
    points, moved = points[moved[:, 2] > 0.1], moved[moved[:, 2] > 0.1]
    expected = cv2.fisheye.projectPoints(moved[:, None], np.zeros(3), np.zeros(3), fish.K, fish.dist[:4])[0][:, 0]
    pixels = fish.project(points)[0]
    np.testing.assert_allclose(pixels, expected, atol=1e-6)
    np.testing.assert_allclose(fish.normalised(pixels), moved[:, :2] / moved[:, 2:], rtol=1e-6, atol=1e-8)
    assert fish.distorts and not fish.pinhole().fisheye
    beyond = fish.normalised(np.array([[1e5, 1e5]]))
    assert np.all(np.isnan(beyond))
