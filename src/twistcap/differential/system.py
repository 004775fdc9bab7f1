"""One linear system for the motion of a view and of the joints, from brightness constancy.

Each pixel of the body gives a row ``[H_i | J_i] (φ; θ̇) = −I_t``: H_i is the image gradient times the image motion of
the view's φ = (s', v₁, v₂, ω_x, ω_y, ω_z), J_i times that of every joint above the pixel's segment, by the twists
``ξ'_k = Ad ξ_k`` (Bregler and Malik, DOI 10.1109/CVPR.1998.698581, eqs. 13 and 19). Two more columns take up a change
of the exposure, ``I' = (1 + a) I + b``. Views have φ, a and b of their own and share the joints' columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap import se3
from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Posed
from twistcap.differential.view import ROOT, ScaledView
from twistcap.render import SurfacePoints
from twistcap.terms.photometric import sample

EXPOSURE = 2
"""Numbers of a view's change of exposure: relative gain and offset."""


def image_motion(posed: Posed, view: ScaledView, points: SurfacePoints) -> Float:
    """(N, 2, 6 + J) derivative of the pixels of surface points by the view's motion and the joints."""
    q = view.camera_points(points.at(posed))
    out = np.zeros((len(q), 2, posed.body.dof))
    out[:, :, 0] = q[:, :2]
    out[:, 0, 1] = out[:, 1, 2] = 1.0
    out[:, :, 3:ROOT] = -se3.hat(q)[:, :2]
    joints = posed.point_jacobian(points.segments, points.weights, points.local)[:, :, 6:]
    out[:, :, ROOT:] = view.scale * np.einsum("ij,njk->nik", view.rotation[:2], joints)
    return out


@dataclass(frozen=True)
class Samples:
    """Surface points of one view and how bright they should be.

    Attributes:
        points: N places on the surface.
        value: (N,) brightness in the frames before, in one channel.
        gradient: (N, 2) image gradient there, 1/px.
    """

    points: SurfacePoints
    value: Float
    gradient: Float


def residuals(posed: Posed, view: ScaledView, samples: Samples, image: Float32, exposure: Float) -> Float:
    """(N,) ``I(x) − (1 + a) value − b`` at the points' pixels; NaN off the image."""
    return _residuals(*samples.points.bound_to(posed), view.P, samples.value, image, exposure)


def normal_equations(
    posed: Posed, view: ScaledView, samples: Samples, image: Float32, exposure: Float, weight: Float
) -> tuple[Float, Float]:
    """Gradient (D,) and Gauss-Newton matrix (D, D) of ``½ Σ w r²`` by (φ, θ̇, a, b), D = 6 + J + 2."""
    body = posed.body
    return _normal_equations(
        *samples.points.bound_to(posed), body.chain, _camera_twists(posed, view), view.P, view.scale * view.rotation,
        samples.value, samples.gradient, image, exposure, weight,
    )  # fmt: skip


def normal_equations_reference(
    posed: Posed, view: ScaledView, samples: Samples, image: Float32, exposure: Float, weight: Float
) -> tuple[Float, Float]:
    """Readable twin of `normal_equations`: stacked rows."""
    pixels = view.pixels(samples.points.at(posed))
    here = [sample(image, x, y) for x, y in pixels]
    value, slope = np.array([s[0] for s in here]), np.array([s[1:3] for s in here])
    inside = np.array([s[3] for s in here])
    motion = np.einsum("ni,nid->nd", 0.5 * (slope + samples.gradient), image_motion(posed, view, samples.points))
    rows = np.concatenate([motion, -samples.value[:, None], -np.ones((len(motion), 1))], axis=1)
    r = value - (1.0 + exposure[0]) * samples.value - exposure[1]
    w = np.where(inside, weight, 0.0)
    return rows.T @ (w * r), rows.T @ (w[:, None] * rows)


def _camera_twists(posed: Posed, view: ScaledView) -> Float:
    """(J, 6) the joints' twists in camera axes and px."""
    twists = posed.world_twists
    return np.concatenate([twists[:, :3] @ view.rotation.T, view.camera_points(twists[:, 3:])], axis=1)


@njit(cache=True, nogil=True)
def _residuals(
    transforms: Float, segments: Int, weights: Float, local: Float, P: Float, value: Float, image: Float32,
    exposure: Float,
) -> Float:  # fmt: skip
    out = np.full(len(local), np.nan)
    for n in range(len(local)):
        x, y = P[0, 3], P[1, 3]
        for k in range(segments.shape[1]):
            w = weights[n, k]
            if w == 0.0:
                continue
            T = transforms[segments[n, k]]
            for i in range(3):
                X = w * (T[i, 0] * local[n, 0] + T[i, 1] * local[n, 1] + T[i, 2] * local[n, 2] + T[i, 3])
                x += P[0, i] * X
                y += P[1, i] * X
        here, _, _, inside = sample(image, x, y)
        if inside:
            out[n] = here - (1.0 + exposure[0]) * value[n] - exposure[1]
    return out


@njit(cache=True, nogil=True)
def _normal_equations(
    transforms: Float, segments: Int, weights: Float, local: Float, chain: Bool, twists: Float, P: Float, M: Float,
    value: Float, gradient: Float, image: Float32, exposure: Float, weight: Float,
) -> tuple[Float, Float]:  # fmt: skip
    """`twists` (J, 6) in camera axes and px; `M` (3, 3) takes the body frame there."""
    J = len(twists)
    D = 6 + J + 2
    g, H = np.zeros(D), np.zeros((D, D))
    row, used = np.zeros(D), np.zeros(D, dtype=np.int64)
    for n in range(len(local)):
        if weight[n] == 0.0:
            continue
        row[:] = 0.0
        x, y, z = 0.0, 0.0, 0.0
        # The place first, since the gradient is wanted there; then the joints that move it.
        for k in range(segments.shape[1]):
            if weights[n, k] != 0.0:
                a, b, c = _carried(transforms[segments[n, k]], M, local[n])
                x, y, z = x + weights[n, k] * a, y + weights[n, k] * b, z + weights[n, k] * c
        here, gx, gy, inside = sample(image, x + P[0, 3], y + P[1, 3])
        if not inside:
            continue
        gx, gy = 0.5 * (gx + gradient[n, 0]), 0.5 * (gy + gradient[n, 1])
        for k in range(segments.shape[1]):
            w = weights[n, k]
            if w == 0.0:
                continue
            a, b, c = _carried(transforms[segments[n, k]], M, local[n])
            for j in range(J):
                if chain[segments[n, k], j]:
                    t = twists[j]
                    ux, uy = t[1] * c - t[2] * b + t[3], t[2] * a - t[0] * c + t[4]
                    row[6 + j] += w * (gx * ux + gy * uy)
        row[0], row[1], row[2] = gx * x + gy * y, gx, gy
        row[3], row[4], row[5] = -gy * z, gx * z, gy * x - gx * y
        row[6 + J], row[7 + J] = -value[n], -1.0
        r = here - (1.0 + exposure[0]) * value[n] - exposure[1]
        count = 0
        for d in range(D):
            if row[d] != 0.0:
                used[count] = d
                count += 1
        for i in range(count):
            wi = weight[n] * row[used[i]]
            g[used[i]] += wi * r
            for j in range(i, count):
                H[used[i], used[j]] += wi * row[used[j]]
    for i in range(D):
        for j in range(i):
            H[i, j] = H[j, i]
    return g, H


@njit(cache=True, nogil=True, inline="always")
def _carried(T: Float, M: Float, point: Float) -> tuple[float, float, float]:
    """A rest point after a segment's motion, in camera axes and px."""
    X = T[0, 0] * point[0] + T[0, 1] * point[1] + T[0, 2] * point[2] + T[0, 3]
    Y = T[1, 0] * point[0] + T[1, 1] * point[1] + T[1, 2] * point[2] + T[1, 3]
    Z = T[2, 0] * point[0] + T[2, 1] * point[1] + T[2, 2] * point[2] + T[2, 3]
    return (
        M[0, 0] * X + M[0, 1] * Y + M[0, 2] * Z,
        M[1, 0] * X + M[1, 1] * Y + M[1, 2] * Z,
        M[2, 0] * X + M[2, 1] * Y + M[2, 2] * Z,
    )
