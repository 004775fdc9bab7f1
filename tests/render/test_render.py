"""Rendering: the rasteriser against its twin, and outlines against spheres and capsules known in closed form."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from support.readable import blend_binding_reference
from support.shapes import camera_at, outline, round_mesh, two_part_body
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.kinematics import vertex_normals, vertex_normals_reference
from twistcap.camera import AnyCamera, ScaledView
from twistcap.camera.projection import project, projected
from twistcap.render import ContourPoints, RenderedView, render, visible_contour
from twistcap.render import contour as contour_module
from twistcap.render.contour import reprojected
from twistcap.render.raster import barycentric, rasterise, rasterise_reference
from twistcap.render.view import body_window, surface_points

ORIGIN = np.zeros(3)
EYE = (3.0, 0.4, 0.5)
R_TORSO, R_ARM, ARM = 0.5, 0.15, np.array([1.0, 0.4, 0.1])


@lru_cache
def arm_before_torso() -> Body:
    return two_part_body(round_mesh(ORIGIN, R_TORSO), round_mesh(ARM, R_ARM, rings=64))


@lru_cache
def capsule() -> Body:
    return two_part_body(round_mesh(np.array([0.1, 0, -0.3]), 0.25, length=0.6), round_mesh(ORIGIN + 50, 0.1, rings=8))


def rest(body: Body, q: float = 0.0) -> Posed:
    return Posed(body, Pose(np.eye(4), np.array([q])))


def random_pose(body: Body, seed: int = 0, size: float = 0.3) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(se3.exp(size * rng.normal(size=6)), size * rng.normal(size=body.dof - 6))


def scene(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random triangles, some behind the camera (inverse depth 0), some reaching out of the window."""
    rng = np.random.default_rng(seed)
    pixels, w = rng.uniform(-15, 75, (3 * n, 2)), rng.uniform(0.2, 2.0, 3 * n)
    w[rng.random(3 * n) < 0.05] = 0.0
    return pixels, w, np.arange(3 * n, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("origin, size", [((0, 0), (60, 45)), ((11, 7), (30, 22)), ((-6, -9), (40, 40))])
def test_rasteriser_agrees_with_its_twin(origin: tuple[int, int], size: tuple[int, int]) -> None:
    index, depth = rasterise(*scene(40), origin, size)
    expected_index, expected_depth = rasterise_reference(*scene(40), origin, size)
    assert np.mean(index >= 0) > 0.5 and np.any(index < 0)
    assert np.mean(index != expected_index) < 2e-3  # a pixel centre may fall on an edge to within rounding
    same = index == expected_index
    np.testing.assert_allclose(depth[same], expected_depth[same], rtol=1e-5)


def test_a_window_is_a_cut_out_of_the_whole() -> None:
    whole, _ = rasterise(*scene(40), (0, 0), (60, 45))
    part, _ = rasterise(*scene(40), (11, 7), (30, 22))
    assert np.mean(part != whole[7:29, 11:41]) < 2e-3


def test_neighbouring_triangles_leave_no_hole() -> None:
    view = render(Posed(b := humanoid(), Pose.rest(b)), camera_at((2.6, 0.3, 0.1)))
    filled = view.mask
    enclosed = filled[:-2, 1:-1] & filled[2:, 1:-1] & filled[1:-1, :-2] & filled[1:-1, 2:]
    assert filled.sum() > 3000 and not np.any(enclosed & ~filled[1:-1, 1:-1])


def test_depth_is_that_of_the_sphere() -> None:
    camera = camera_at(EYE)
    view = render(rest(arm_before_torso()), camera)
    rows, columns = np.nonzero(view.part == 0)
    n, _ = camera.rays(np.stack([columns, rows], axis=1))
    along = -n @ camera.centre
    half = np.sqrt(np.maximum(R_TORSO**2 - (camera.centre @ camera.centre - along**2), 0))
    depth = (along - half) * (n @ camera.T_cam_world[2, :3])
    inner = half > 0.1
    np.testing.assert_allclose(1 / view.nearness_image[rows, columns][inner], depth[inner], atol=1e-3)


def test_project_pinhole_is_the_cameras() -> None:
    camera, X = camera_at(EYE), np.random.default_rng(0).uniform(-1, 1, (50, 3))
    pixels, w = project(camera.P, X)
    expected, depth = camera.project(X)
    np.testing.assert_allclose(pixels, expected, atol=1e-10)
    np.testing.assert_allclose(w, 1 / depth, rtol=1e-12)
    assert np.all(project(camera.P, camera.centre + X + [5, 0, 0])[1] == 0)


def test_barycentric_returns_the_known_points_in_perspective() -> None:
    rng = np.random.default_rng(1)
    camera = camera_at(EYE)
    corners = rng.uniform(-0.8, 0.8, (30, 3, 3))
    weights = rng.dirichlet(np.ones(3), 30)
    at, _ = camera.project(np.einsum("nk,nki->ni", weights, corners))
    pixels, w = project(camera.P, corners.reshape(-1, 3))
    faces = np.arange(90, dtype=np.int32).reshape(-1, 3)
    found = barycentric(np.arange(30, dtype=np.int32), faces, pixels, w, at)
    np.testing.assert_allclose(found, weights, atol=1e-8)


def test_surface_points_of_pixels_project_back() -> None:
    body = humanoid()
    pose = random_pose(body)
    # A rigid binding: on blended skin the rest-pose point of a triangle is carried otherwise than its corners' mean.
    camera = camera_at((2.6, 0.3, 0.1))
    rigid = Posed(arm_before_torso(), Pose(se3.exp(0.1 * np.ones(6)), np.array([0.2])))
    for posed, tolerance in [(rigid, 1e-9), (Posed(body, pose), 0.3)]:
        view = render(posed, camera)
        rows, columns = (x[::37] for x in np.nonzero(view.mask))
        back, _ = camera.project(view.surface_points(rows, columns).at(posed))
        assert np.linalg.norm(back - np.stack([columns, rows], axis=1), axis=1).max() < tolerance


def contour_of(body: Body, spacing: float = 2.0) -> tuple[RenderedView, ContourPoints]:
    view = render(rest(body), camera_at(EYE))
    return view, visible_contour(view, spacing)


def check_on_outline(contour: ContourPoints, a: np.ndarray, b: np.ndarray, radius: float) -> None:
    distance, normal = outline(camera_at(EYE), a, b, radius, contour.pixels)
    assert np.abs(distance).max() < 0.1
    assert abs(distance.mean()) < 0.03
    assert np.sum(normal * contour.normals, axis=1).min() > np.cos(np.deg2rad(3))
    np.testing.assert_allclose(np.linalg.norm(contour.normals, axis=1), 1, atol=1e-12)


def test_contour_of_spheres_lies_on_their_outlines() -> None:
    _, contour = contour_of(arm_before_torso())
    for part, centre, radius in [(0, ORIGIN, R_TORSO), (1, ARM, R_ARM)]:
        own = contour[contour.part == part]
        assert len(own) > 40
        check_on_outline(own, centre, centre, radius)


def test_contour_of_a_capsule_lies_on_its_outline() -> None:
    _, contour = contour_of(capsule())
    assert len(contour) > 80 and np.all(contour.outer) and np.all(contour.part == 0)
    check_on_outline(contour, np.array([0.1, 0, -0.3]), np.array([0.1, 0, 0.3]), 0.25)


def test_contour_samples_are_spaced_as_asked() -> None:
    _, contour = contour_of(capsule(), spacing=4.0)
    x = contour.pixels - contour.pixels.mean(axis=0)
    ring = contour.pixels[np.argsort(np.arctan2(x[:, 1], x[:, 0]))]
    perimeter = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).sum()
    assert perimeter / len(contour) == pytest.approx(4.0, rel=0.15)  # the mesh's edges zigzag a little


def test_contours_are_outer_off_the_body_and_inner_before_another_part() -> None:
    """The arm sticks out over the torso's outline: half of its contour is inner, the rest outer."""
    _, contour = contour_of(arm_before_torso())
    torso, _ = outline(camera_at(EYE), ORIGIN, ORIGIN, R_TORSO, contour.pixels)
    arm = contour.part == 1
    assert np.sum(arm & ~contour.outer) > 10 and np.sum(arm & contour.outer) > 10
    clear = arm & (np.abs(torso) > 2.0)
    np.testing.assert_array_equal(contour.outer[clear], torso[clear] > 0)
    assert np.all(contour.outer[~arm])


def test_hidden_contours_are_dropped() -> None:
    _, contour = contour_of(arm_before_torso())
    behind = contour[contour.part == 0]
    arm, _ = outline(camera_at(EYE), ARM, ARM, R_ARM, behind.pixels)
    assert arm.min() > -1.5  # no torso point within the arm's disc
    torso, _ = outline(camera_at(EYE), ORIGIN, ORIGIN, R_TORSO, np.array(camera_at(EYE).project(ARM)[0])[None])
    assert abs(torso[0]) < 15  # the torso's outline does run behind the arm's disc


def test_inner_contours_need_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contour_module, "_INNER_GAP", 3.0)
    _, contour = contour_of(arm_before_torso())
    assert np.all(contour.outer)


def test_contour_points_reproject_to_their_pixels() -> None:
    body = arm_before_torso()
    posed = Posed(body, Pose(se3.exp(0.1 * np.ones(6)), np.array([0.15])))
    camera = camera_at(EYE)
    contour = visible_contour(render(posed, camera), 2.0)
    assert len(contour) > 50 and set(contour.part) == {0, 1}
    pixels, depth = camera.project(contour.points.at(posed))
    np.testing.assert_allclose(pixels, contour.pixels, atol=1e-8)
    np.testing.assert_allclose(contour.inverse_depth, 1 / depth, rtol=1e-9)
    moved = Posed(body, Pose(posed.pose.root, np.array([0.2])))
    again = reprojected(contour, moved, camera.P)
    np.testing.assert_allclose(again.pixels, camera.project(contour.points.at(moved))[0], atol=1e-9)
    assert np.linalg.norm(again.pixels - contour.pixels, axis=1)[contour.part == 1].min() > 1


def test_contour_of_the_humanoid_follows_its_mask() -> None:
    """Half a pixel outside every outer point there is no body, half a pixel inside there is."""
    body = humanoid()
    view = render(Posed(body, random_pose(body, 3, 0.2)), camera_at((2.6, 0.3, 0.1)))
    contour = visible_contour(view, 2.0)
    outer = contour[contour.outer]
    for sign, expected in [(1, False), (-1, True)]:
        column, row = np.round(outer.pixels + sign * 1.5 * outer.normals).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < 320) & (row < 240)
        assert np.mean(view.mask[row[inside], column[inside]] == expected) > 0.9
    reprojection, _ = view.camera.project(contour.points.at(view.posed))
    error = np.linalg.norm(reprojection - contour.pixels, axis=1)
    assert np.percentile(error, 95) < 0.3 and np.median(error) < 0.05


def test_vertex_normals_agree_with_their_twin_and_point_outward() -> None:
    body = humanoid()
    vertices = Posed(body, random_pose(body)).vertices
    np.testing.assert_allclose(
        vertex_normals(vertices, body.faces), vertex_normals_reference(vertices, body.faces), atol=1e-15
    )
    ball, faces = round_mesh(ARM, R_ARM, rings=32)
    normals = vertex_normals(ball, faces)
    cosine = np.sum(normals * (ball - ARM), axis=1) / np.linalg.norm(normals, axis=1) / R_ARM
    assert cosine.min() > 0.999


def test_blended_bindings_agree_with_their_twin() -> None:
    body, rng = humanoid(), np.random.default_rng(2)
    corners = body.faces[rng.integers(len(body.faces), size=400)]
    weights = rng.dirichlet(np.ones(3), 400)
    points = surface_points(body, corners, weights)
    dense = np.zeros((400, len(body.segment_names)))
    np.add.at(dense, (np.repeat(np.arange(400), 4), points.segments.ravel()), points.weights.ravel())
    np.testing.assert_allclose(dense, blend_binding_reference(body, corners, weights), atol=1e-12)
    assert np.any((dense > 0).sum(axis=1) > 1)
    far = rng.integers(len(body.vertices), size=(400, 5)).astype(np.int32)  # many bones: the least ones are dropped
    share = rng.dirichlet(np.ones(5), 400)
    points = surface_points(body, far, share, keep=3)
    dense[:] = 0
    np.add.at(dense, (np.repeat(np.arange(400), 3), points.segments.ravel()), points.weights.ravel())
    np.testing.assert_allclose(dense, blend_binding_reference(body, far, share, keep=3), atol=1e-12)


def test_body_window_holds_the_body_and_its_margin() -> None:
    posed, camera = rest(arm_before_torso()), camera_at(EYE)
    window = body_window(posed, camera, 6.0)
    assert window is not None
    (x, y), (w, h) = window
    rows, columns = np.nonzero(render(posed, camera).mask)
    assert x <= columns.min() - 6 and columns.max() + 6 <= x + w - 1 and x >= columns.min() - 8
    assert y <= rows.min() - 6 and rows.max() + 6 <= y + h - 1 and y + h - 1 <= rows.max() + 8
    cropped = render(posed, camera.cropped((x, y), (w, h)))
    assert cropped.mask.sum() == render(posed, camera).mask.sum()


def test_body_window_is_held_to_the_image_and_none_off_it() -> None:
    camera = camera_at(EYE)
    near = body_window(rest(arm_before_torso()), camera, 1000.0)
    assert near == ((0, 0), (320, 240))
    aside = Posed(arm_before_torso(), Pose(se3.exp([0, 0, 0, 0, 20, 0]), np.zeros(1)))
    behind = Posed(arm_before_torso(), Pose(se3.exp([0, 0, 0, 20, 0, 0]), np.zeros(1)))
    assert body_window(aside, camera, 6.0) is None and body_window(behind, camera, 6.0) is None


def test_a_view_tells_parts_and_scale() -> None:
    view = render(rest(arm_before_torso()), camera_at(EYE))
    at = np.round(view.camera.project(np.stack([ARM, ORIGIN]))[0]).astype(int)
    assert [view.part[v, u] for u, v in at] == [1, 0] and view.part[0, 0] == -1
    np.testing.assert_array_equal(view.mask, view.part >= 0)
    assert 80 < view.px_per_m < 150  # 300 px over about 3 m, the arm being nearer


SCALED = ScaledView.of(camera_at(EYE), np.eye(4))
CAMERAS = (camera_at(EYE), SCALED, ScaledView.of(camera_at(EYE), np.eye(4), perspective=True))


@pytest.mark.parametrize("camera", CAMERAS)
def test_surface_points_of_any_camera_lie_at_their_pixels_and_are_visible(camera: AnyCamera) -> None:
    body = arm_before_torso()
    view = render(rest(body), camera)
    rows, columns = (i.astype(np.int32) for i in np.nonzero(view.mask))
    points = view.surface_points(rows, columns)
    visible, pixels = view.visible(points, 0.02)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=1), atol=1e-6)
    assert visible.all()
    away = Posed(body, Pose(se3.transform(np.eye(3), -0.1 * np.array(EYE) / np.linalg.norm(EYE)), np.zeros(1)))
    near, far = (view.visible(points, tolerance, away)[0].mean() for tolerance in (0.02, 0.3))
    assert near < 0.05 and far > 0.9  # of what is farther from the camera by 10 cm


@pytest.mark.parametrize("camera", CAMERAS)
def test_what_another_part_hides_is_not_visible(camera: AnyCamera) -> None:
    body = arm_before_torso()
    view, torso = (
        render(rest(body), camera),
        render(rest(two_part_body(round_mesh(ORIGIN, R_TORSO), far_arm())), camera),
    )
    covered = (view.part == 1) & (torso.part == 0)
    rows, columns = (i.astype(np.int32) for i in np.nonzero(covered))
    assert len(rows) > 100 and not view.visible(torso.surface_points(rows, columns), 0.05)[0].any()


def far_arm() -> tuple[np.ndarray, np.ndarray]:
    return round_mesh(ORIGIN + 50, R_ARM, rings=8)


@pytest.mark.parametrize("camera", CAMERAS)
def test_inside_is_the_distance_from_the_nearest_rim(camera: AnyCamera) -> None:
    view = render(rest(arm_before_torso()), camera)
    depth = np.where(view.mask, camera_depth(view), np.inf)
    rim = ~view.mask
    for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
        with np.errstate(invalid="ignore"):
            jump = ~(np.abs(depth - np.roll(depth, shift, axis)) <= 0.04)
        rim |= jump
    rows, columns = np.nonzero(rim)
    inner = np.argwhere(view.inside > 0)[::97]
    nearest = np.sqrt(((inner[:, None] - np.stack([rows, columns], 1)) ** 2).sum(axis=2)).min(axis=1)
    np.testing.assert_allclose(view.inside[tuple(inner.T)], nearest, rtol=0.06, atol=0.05)
    assert np.all(view.inside[rim] == 0)


def camera_depth(view: RenderedView) -> np.ndarray:
    """(H, W) depth of what is seen, m, up to a constant."""
    near = np.where(view.mask, view.nearness_image, 1.0).astype(float)
    return 1.0 / near if view.camera.inverse_depth else -near


def test_a_scaled_view_has_the_depth_of_its_points() -> None:
    view = render(rest(arm_before_torso()), SCALED)
    rows, columns = (i.astype(np.int32) for i in np.nonzero(view.mask))
    points = view.surface_points(rows, columns).at(view.posed)
    np.testing.assert_allclose(view.nearness_image[rows, columns], projected(SCALED, points)[1], atol=1e-5)
    np.testing.assert_allclose(
        np.diff(view.nearness_image[rows, columns]), -np.diff(points @ SCALED.rotation[2]), atol=1e-5
    )
