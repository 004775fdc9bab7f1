"""Kernels of drawing against their readable twins."""

from __future__ import annotations

import numpy as np
import pytest

from support.shapes import camera_at
from support.twins import check_twin
from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera.projection import along, depth_at, project
from twistcap.render import render
from twistcap.render.contour import contour_samples
from twistcap.render.raster import barycentric
from twistcap.render.view import blended, in_sight, off_rims

BODY = humanoid()


def posed(seed: int) -> Posed:
    rng = np.random.default_rng(seed)
    return Posed(BODY, Pose(se3.exp(0.2 * rng.normal(size=6)), 0.4 * rng.normal(size=BODY.dof - 6)))


@pytest.mark.parametrize("place", [(2.8, 0.7, 0.4), (0.25, 0.1, 0.6)], ids=["whole", "partly behind the camera"])
@pytest.mark.parametrize("spacing", [3.0, 0.7])
def test_contours_are_those_of_the_twin(place: tuple[float, float, float], spacing: float) -> None:
    view = render(posed(1), camera_at(place))
    mesh = (BODY.faces, *BODY.edges, BODY.face_part, BODY.vertex_part)
    drawn = (view.face_index, view.nearness_image)
    samples = check_twin(
        contour_samples, view.camera.P, view.pixels, view.nearness, view.posed.vertex_normals, mesh, drawn,
        spacing, 0.04, atol=1e-8,
    )  # fmt: skip
    assert len(samples[0]) > 50 and 0.0 < samples[3].mean() < 1.0  # before the background and before other parts
    assert (view.nearness == 0.0).any() == (place[0] < 1.0)


def test_projections_and_barycentric_coordinates_are_those_of_the_twins() -> None:
    rng, camera = np.random.default_rng(2), camera_at((0.8, 0.2, 0.1))
    points = np.concatenate([rng.uniform(-0.5, 0.5, (60, 3)), [[5.0, 0.0, 0.0], camera.centre]])
    _, inverse_depth = check_twin(project, camera.P, points)
    assert inverse_depth[-2] == inverse_depth[-1] == 0.0 < inverse_depth[0]
    pixels, nearness = rng.uniform(0, 100, (30, 2)), rng.uniform(0.2, 0.5, 30)
    faces = np.arange(30, dtype=np.int32).reshape(10, 3)
    which = rng.integers(0, 10, 25).astype(np.int32)
    inside = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), 25), pixels[faces[which]])
    weights = check_twin(barycentric, which, faces, pixels, nearness, inside, rtol=1e-7, atol=1e-7)
    check_twin(blended, rng.normal(size=(30, 4)), faces[which], weights)


@pytest.mark.parametrize("inverse", [True, False])
def test_sight_and_rims_are_those_of_the_twins(inverse: bool) -> None:
    rng = np.random.default_rng(4)
    image = np.where(rng.uniform(size=(40, 50)) < 0.9, rng.choice([0.4, 0.41, 0.6], (40, 50)), 0.0).astype(np.float32)
    pixels, nearness = rng.uniform(-3, 55, (400, 2)), rng.choice([0.0, 0.39, 0.4, 0.6], 400)
    seen = check_twin(in_sight, pixels, nearness, image, inverse, 0.02)
    assert 0.05 < seen.mean() < 0.9
    assert 0.0 < check_twin(off_rims, image, inverse).mean() < 1.0
    check_twin(depth_at, 0.4, inverse)
    check_twin(along, camera_at((2.0, 0.3, 0.2)).P, 3.0, -4.0, 0.6, 0.8)
