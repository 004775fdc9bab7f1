"""Simplified and ellipsoidal bodies."""

from __future__ import annotations

import numpy as np
import pytest

from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.ellipsoids import Ellipsoids, ellipsoid_body, ellipsoids_on_bones, fitted_ellipsoids, nearest_depths
from twistcap.body.humanoid import humanoid
from twistcap.body.simplify import NINETEEN, angles_of, side_view, simplified, with_surface
from twistcap.camera import ScaledView
from twistcap.errors import InputError
from twistcap.render import render

BODY = humanoid()


def test_a_simplified_body_moves_as_the_full_one_whose_other_joints_stay() -> None:
    rng = np.random.default_rng(2)
    q = np.clip(rng.normal(0, 0.3, len(BODY.coordinate_names)), *BODY.limits.T)
    model = simplified(BODY, NINETEEN, at=q)
    assert len(model.coordinate_names) == 19
    moved = q.copy()
    for name in NINETEEN:
        moved[BODY.coordinate(name)] += 0.1
    there = Posed(BODY, Pose(np.eye(4), moved)).landmarks
    here = Posed(model, Pose(np.eye(4), angles_of(model, BODY, moved))).landmarks
    assert model.landmarks.names == BODY.landmarks.names
    np.testing.assert_allclose(here, there, atol=1e-9)


def test_the_side_view_is_planar() -> None:
    model = side_view(BODY, "r", at=np.full(len(BODY.coordinate_names), 0.1))
    assert len(model.coordinate_names) == 6
    assert not any(name.endswith("_l") for name in model.segment_names)
    assert "knee_r" in model.landmarks.names
    assert "knee_l" not in model.landmarks.names
    moved = Posed(model, Pose(np.eye(4), np.full(6, 0.3))).landmarks - Posed(model, Pose.rest(model)).landmarks
    assert np.abs(moved[:, 1]).max() < 1e-12
    assert np.abs(moved[:, 0]).max() > 0.1


def test_unknown_names_are_told() -> None:
    with pytest.raises(InputError, match="tail"):
        simplified(BODY, ["tail"])
    with pytest.raises(InputError, match="side"):
        side_view(BODY, "x")


def test_an_ellipsoid_is_found_again() -> None:
    axes = se3.exp_rotation([0.3, -0.5, 0.2])
    truth = Ellipsoids(np.zeros(1, np.int32), np.array([[0.1, 0.2, 0.3]]), axes[None], np.array([[0.05, 0.08, 0.2]]))
    bare = simplified(BODY, [])
    found = fitted_ellipsoids(with_surface(bare, *truth.mesh()))
    np.testing.assert_allclose(found.centres, truth.centres, atol=1e-9)
    np.testing.assert_allclose(found.radii, truth.radii, rtol=0.02)
    np.testing.assert_allclose(np.abs(np.einsum("ij,ij->j", found.axes[0], axes)), 1.0, atol=1e-3)


def test_the_mesh_has_the_depth_of_the_quadratic() -> None:
    body = ellipsoid_body(BODY)
    ellipsoids = fitted_ellipsoids(BODY)
    view = ScaledView(np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]), 110.0, np.array([100.0, 120.0]), size=(200, 260))
    posed = Posed(body, Pose.rest(body))
    seen = render(posed, view)
    rows, columns = (i.astype(np.int32) for i in np.nonzero(seen.inside > 3))
    z = view.scale * view.depth(seen.surface_points(rows, columns).at(posed))
    T = posed.segment_transforms[ellipsoids.segments]
    turned = view.rotation @ T[:, :3, :3]
    forms = np.einsum("eij,ejk,elk->eil", turned, ellipsoids.forms(), turned) / view.scale**2
    centres = view.scale * se3.apply(T, ellipsoids.centres[:, None])[:, 0] @ view.rotation.T
    depth, which = nearest_depths(forms, centres, np.stack([columns, rows], 1) - view.shift)
    assert (which >= 0).mean() > 0.99
    hit = which >= 0
    assert np.median(np.abs(depth[hit] - z[hit])) < 0.3  # px, of bodies 40 px thick
    assert (ellipsoids.segments[which[hit]] == seen.part[rows, columns][hit]).mean() > 0.98


def test_bones_without_a_surface_get_ellipsoids() -> None:
    found = ellipsoids_on_bones(BODY)
    thigh = np.flatnonzero(found.segments == BODY.segment("femur_r"))[0]
    hip, knee = (BODY.landmarks.points[BODY.landmarks.index(name)] for name in ("hip_r", "knee_r"))
    np.testing.assert_allclose(found.centres[thigh], 0.5 * (hip + knee), atol=0.01)
