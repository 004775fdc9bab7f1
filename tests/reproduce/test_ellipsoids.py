"""Bodies of ellipsoids: fitted to a surface, and their mesh against the quadratic."""

from __future__ import annotations

import numpy as np

from reproduce.ellipsoids import Ellipsoids, ellipsoid_body, fitted_ellipsoids, with_surface
from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.simplify import simplified
from twistcap.camera import ScaledView
from twistcap.render import render

BODY = humanoid()


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
    z = view.scale * seen.surface_points(rows, columns).at(posed) @ view.rotation[2]
    T = posed.segment_transforms[ellipsoids.segments]
    turned = view.rotation @ T[:, :3, :3]
    forms = np.einsum("eij,ejk,elk->eil", turned, ellipsoids.forms(), turned) / view.scale**2
    centres = view.scale * se3.apply(T, ellipsoids.centres[:, None])[:, 0] @ view.rotation.T
    depth, which = nearest_depths(forms, centres, np.stack([columns, rows], 1) - view.shift)
    assert (which >= 0).mean() > 0.99
    hit = which >= 0
    assert np.median(np.abs(depth[hit] - z[hit])) < 0.3  # px, of bodies 40 px thick
    assert (ellipsoids.segments[which[hit]] == seen.part[rows, columns][hit]).mean() > 0.98


def nearest_depths(forms: np.ndarray, centres: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth (N,) of the nearest ellipsoid along each ray of a scaled-orthographic view, and which; inf, -1 if none.

    The ray ``x(z) = (x, y, z)`` meets ``(x − c)ᵀ A (x − c) = 1`` where a quadratic in z vanishes: at its lesser root.

    Args:
        forms: (E, 3, 3) A in camera axes, 1/px².
        centres: (E, 3) c there, px.
        pixels: (N, 2) x and y.
    """
    d = pixels[:, None] - centres[None, :, :2]
    a = forms[:, 2, 2]
    b = np.einsum("nei,ei->ne", d, forms[:, :2, 2])
    c = np.einsum("nei,eij,nej->ne", d, forms[:, :2, :2], d) - 1.0
    square = b * b - a * c
    z = np.where(square >= 0, centres[:, 2] + (-b - np.sqrt(np.maximum(square, 0.0))) / a, np.inf)
    which = np.argmin(z, axis=1)
    depth = z[np.arange(len(z)), which]
    return depth, np.where(np.isfinite(depth), which, -1).astype(np.int32)
