"""Shape matching: displacement fields and partners on shapes moved in a known way."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twistcap.body import Posed
from twistcap.cues.levelset import LevelSetContour, Matching
from twistcap.cues.view import crop_view
from twistcap.region.levelset import nearest_with_normal, signed_distance, zero_crossings
from twistcap.region.matching import Displacement, VariationalRule, displaced_partners, displacement, relax
from twistcap.render import render, visible_contour
from twistcap.studio import StudioConfig, capture

SIZE, CENTRE = (120, 160), np.array([80.0, 60.0])
AXES = (48.0, 24.0)


def turned(points: np.ndarray, degrees: float, shift: tuple[float, float]) -> np.ndarray:
    a = np.deg2rad(degrees)
    return (points - CENTRE) @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) + CENTRE + shift


def ellipse(degrees: float = 0.0, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """(H, W) about the distance to an ellipse, with the exact zero level."""
    grid = np.stack(np.meshgrid(np.arange(SIZE[1]), np.arange(SIZE[0])), axis=-1).reshape(-1, 2) - np.array(shift)
    x, y = (turned(grid.astype(float), -degrees, (0, 0)) - CENTRE).T
    r = np.hypot(x / AXES[0], y / AXES[1])
    slope = np.hypot(x / AXES[0] ** 2, y / AXES[1] ** 2) / np.maximum(r, 1e-9)
    return ((1 - r) / np.maximum(slope, 1e-3)).reshape(SIZE).astype(np.float32)


def outline(n: int = 90) -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    normals = np.stack([np.cos(t) / AXES[0], np.sin(t) / AXES[1]], axis=1)
    points = CENTRE + np.stack([AXES[0] * np.cos(t), AXES[1] * np.sin(t)], axis=1)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "degrees, shift", [(0.0, (0.0, 0.0)), (0.0, (3.4, -2.6)), (6.0, (0.0, 0.0)), (-5.0, (2.0, 3.0))]
)
def test_a_moved_ellipse_is_matched(degrees: float, shift: tuple[float, float]) -> None:
    """Partners lie on the moved outline to a third of a pixel; the way along it is better than the nearest point's."""
    points, normals = outline()
    phi = ellipse(degrees, shift)
    flow = displacement(signed_distance(ellipse() > 0), phi, VariationalRule())
    partner, distance = displaced_partners(points, normals, flow, phi, 0.5)
    assert np.all(np.isfinite(distance))
    back = (turned(partner - np.array(shift), -degrees, (0, 0)) - CENTRE) / AXES
    off = np.abs(np.hypot(*back.T) - 1) * np.linalg.norm((partner - CENTRE - shift), axis=1)
    assert off.max() < 0.3
    np.testing.assert_allclose(distance, np.linalg.norm(partner - points, axis=1), atol=1e-9)


def test_the_field_slides_along_the_contour_where_the_nearest_point_cannot() -> None:
    points, normals = outline()
    shift = (6.0, 0.0)
    phi = ellipse(0.0, shift)
    rule = VariationalRule(warps=8, iterations=100)
    partner, _ = displaced_partners(points, normals, displacement(signed_distance(ellipse() > 0), phi, rule), phi, 0.5)
    nearest, _ = nearest_with_normal(points, normals, *zero_crossings(phi), 0.5)
    off = [np.linalg.norm(p - points - shift, axis=1).mean() for p in (partner, nearest)]
    assert off[0] < 0.6 * off[1]


def exact_solution(field, warped, source, weight, alpha):
    """The linear system itself, solved exactly."""
    h, w = source.shape
    A, b = np.zeros((2 * h * w, 2 * h * w)), np.zeros(2 * h * w)
    for r in range(h):
        for c in range(w):
            i, m = r * w + c, weight[r, c]
            f, fx, fy = warped[r, c]
            rest = f - source[r, c] - fx * field[r, c, 0] - fy * field[r, c, 1]
            for k, (g, other) in enumerate(((fx, fy), (fy, fx))):
                row, cross = k * h * w + i, (1 - k) * h * w + i
                A[row, row] += m * g * g
                A[row, cross] += m * g * other
                b[row] -= m * g * rest
                for rr, cc in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                    if 0 <= rr < h and 0 <= cc < w:
                        A[row, row] += alpha
                        A[row, k * h * w + rr * w + cc] -= alpha
    return np.linalg.solve(A, b).reshape(2, h, w).transpose(1, 2, 0)


def test_sweeps_converge_to_the_solution_of_the_system() -> None:
    rng = np.random.default_rng(0)
    h, w = 7, 9
    field = rng.normal(size=(h, w, 2)).astype(np.float32)
    warped, source = rng.normal(size=(h, w, 3)).astype(np.float32), rng.normal(size=(h, w)).astype(np.float32)
    weight = (rng.random((h, w)) < 0.7).astype(np.float32)
    expected = exact_solution(field, warped, source, weight, 1.5)
    relax(field, warped, source, weight, 1.5, 400)
    np.testing.assert_allclose(field, expected, atol=2e-3)
    assert np.ptp(expected) > 0.5


def test_a_linear_field_is_read_where_it_stands() -> None:
    """Grid cell k covers pixels r k … r k + r − 1: its value stands in their middle."""
    y, x = np.mgrid[:60, :80].astype(np.float32)
    plane = np.stack([0.1 * x + 0.02 * y, 0.03 * x - 0.2 * y], axis=-1)
    coarse = cv2.resize(plane, (20, 15), interpolation=cv2.INTER_AREA)
    points = np.random.default_rng(0).uniform(5, 50, (30, 2))
    expected = np.stack([points @ [0.1, 0.02], points @ [0.03, -0.2]], axis=1)
    np.testing.assert_allclose(Displacement(coarse, 4).at(points), expected, atol=0.02)
    assert Displacement(coarse, 4).at(np.zeros((0, 2))).shape == (0, 2)


def test_partners_with_another_normal_and_no_contour_are_infinitely_far() -> None:
    points, normals = outline()
    phi = ellipse()
    flow = Displacement(np.zeros((30, 40, 2), np.float32), 4)
    assert np.all(np.isinf(displaced_partners(points, -normals, flow, phi, 0.5)[1]))
    assert np.all(np.isinf(displaced_partners(points, normals, flow, np.full(SIZE, 9.0, np.float32), 0.5)[1]))
    blank = displacement(ellipse(), np.full(SIZE, -9.0, np.float32), VariationalRule())
    assert np.all(np.isfinite(blank.field))


@pytest.mark.parametrize("matching", ["icp", "variational", "both"])
def test_matching_pulls_a_body_back(matching: Matching) -> None:
    """The body is rendered 1.5 cm aside: most partners lie the other way, on the outline that was evolved."""
    scene = capture(StudioConfig(seed=1, views=2, frames=1))
    pose = scene.true_poses[0]
    aside = np.zeros(scene.body.dof)
    aside[3:6] = scene.rig[0].T_cam_world[0, :3] * 0.015
    posed = Posed(scene.true_body, pose.retract(aside))
    image = scene.frame(0).images[0]
    assert image is not None
    view = crop_view(image, scene.rig[0], posed, 0.15, "lab")
    assert view is not None
    seen = render(posed, view.camera)
    cue = replace(LevelSetContour(), matching=matching)
    found = cue.locate(view, seen, visible_contour(seen, 3.0), 1.0, np.zeros((len(scene.body.segment_names), 7)))
    sideways = np.abs(found.contour.normals[:, 0]) > 0.8
    back = -np.sign(found.contour.normals[sideways, 0]) * found.displacement[sideways]
    assert np.mean(back > 0) > 0.75 and np.median(back) > 0.3 * 0.015 * seen.px_per_m
