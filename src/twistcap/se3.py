"""Rigid motions and their twists, batched over leading axes.

A twist is the 6-vector ``(ω, v)``; a motion is a 4×4 matrix. ``exp`` and ``log`` are those of Rosenhahn, Brox and
Seidel, "Scaled Motion Dynamics for Markerless Motion Capture", eq. 4-9 (DOI 10.1109/CVPR.2007.383128), in forms that
are exact near θ = 0 and θ = π.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from twistcap.arrays import Bool, Float

_SMALL = 1e-4  # below this angle (rad) the trigonometric quotients are replaced by their series


def hat(omega: ArrayLike) -> Float:
    """Cross-product matrix: ``hat(a) @ b == a × b``. (..., 3) -> (..., 3, 3)."""
    w = np.asarray(omega, dtype=np.float64)
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -w[..., 2], w[..., 1]
    out[..., 1, 0], out[..., 1, 2] = w[..., 2], -w[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -w[..., 1], w[..., 0]
    return out


def vee(matrix: ArrayLike) -> Float:
    """Inverse of `hat`; the symmetric part of the matrix is ignored. (..., 3, 3) -> (..., 3)."""
    m = np.asarray(matrix, dtype=np.float64)
    return 0.5 * np.stack(
        [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1
    )


def transform(rotation: ArrayLike, translation: ArrayLike) -> Float:
    """Motion from a rotation (..., 3, 3) and a translation (..., 3), metres. -> (..., 4, 4)."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    out = np.zeros((*batch, 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = rotation, translation, 1.0
    return out


def inverse(motion: ArrayLike) -> Float:
    """Inverse motion, by transposition. (..., 4, 4) -> (..., 4, 4)."""
    T = np.asarray(motion, dtype=np.float64)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def apply(motion: ArrayLike, points: ArrayLike) -> Float:
    """Move points: ``R x + t``. (..., 4, 4) and (..., N, 3) -> (..., N, 3)."""
    T = np.asarray(motion, dtype=np.float64)
    return np.asarray(points, float) @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def _sinc_terms(theta: Float) -> tuple[Float, Float, Float]:
    """sin θ/θ, (1 − cos θ)/θ² and (θ − sin θ)/θ³."""
    small = np.abs(theta) < _SMALL
    safe = np.where(small, 1.0, theta)
    t2 = theta * theta
    a = np.where(small, 1.0 - t2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - t2 / 24.0, 2.0 * np.sin(safe / 2.0) ** 2 / safe**2)
    # θ − sin θ loses digits: the series is used up to 0.3 rad, where its remainder is below 1e-16.
    series = 1 / 6 - t2 / 120 * (1 - t2 / 42 * (1 - t2 / 72 * (1 - t2 / 110)))
    c = np.where(np.abs(theta) < 0.3, series, (safe - np.sin(safe)) / safe**3)
    return a, b, c


def exp_rotation(omega: ArrayLike) -> Float:
    """Rotation matrix of a rotation vector in rad (Rodrigues). (..., 3) -> (..., 3, 3)."""
    w = np.asarray(omega, dtype=np.float64)
    a, b, _ = _sinc_terms(np.linalg.norm(w, axis=-1))
    W = hat(w)
    return np.eye(3) + a[..., None, None] * W + b[..., None, None] * (W @ W)


def log_rotation(rotation: ArrayLike) -> Float:
    """Rotation vector in rad, ‖ω‖ ≤ π, through the unit quaternion (exact near 0 and π). (..., 3, 3) -> (..., 3)."""
    R = np.asarray(rotation, dtype=np.float64)
    # 4 q qᵀ from the entries of R; its largest column is the best conditioned multiple of q (Shepperd's method).
    trace = np.trace(R, axis1=-2, axis2=-1)
    twice_vee = 2.0 * vee(R)
    K = np.empty((*R.shape[:-2], 4, 4))
    K[..., 0, 0] = 1.0 + trace
    K[..., 0, 1:] = K[..., 1:, 0] = twice_vee
    K[..., 1:, 1:] = R + np.swapaxes(R, -1, -2) + (1.0 - trace)[..., None, None] * np.eye(3)
    best = np.argmax(np.diagonal(K, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(K, best[..., None, None], axis=-1)[..., 0]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2.0 * np.arctan2(sine, q[..., 0])
    small = sine < 1e-12
    factor = np.where(small, 2.0, angle / np.where(small, 1.0, sine))
    return factor[..., None] * q[..., 1:]


def exp(twist: ArrayLike) -> Float:
    """Motion of a twist (ω rad, v m). (..., 6) -> (..., 4, 4)."""
    xi = np.asarray(twist, dtype=np.float64)
    w, v = xi[..., :3], xi[..., 3:]
    a, b, c = (x[..., None, None] for x in _sinc_terms(np.linalg.norm(w, axis=-1)))
    W = hat(w)
    W2 = W @ W
    V = np.eye(3) + b * W + c * W2
    return transform(np.eye(3) + a * W + b * W2, (V @ v[..., None])[..., 0])


def log(motion: ArrayLike) -> Float:
    """Twist (ω rad, v m) of a motion, ‖ω‖ ≤ π. (..., 4, 4) -> (..., 6)."""
    T = np.asarray(motion, dtype=np.float64)
    w = log_rotation(T[..., :3, :3])
    theta = np.linalg.norm(w, axis=-1)
    half = theta / 2.0
    small = theta < 1e-2
    safe = np.where(small, 1.0, half)
    rest = np.where(small, 1 / 12 + theta**2 / 720 + theta**4 / 30240, (1 - safe / np.tan(safe)) / (4 * safe**2))
    W = hat(w)
    V_inv = np.eye(3) - 0.5 * W + rest[..., None, None] * (W @ W)
    return np.concatenate([w, (V_inv @ T[..., :3, 3:])[..., 0]], axis=-1)


def adjoint(motion: ArrayLike) -> Float:
    """``Ad_g`` with ``g exp(ξ̂) g⁻¹ = exp((Ad_g ξ)^)`` for twists (ω, v). (..., 4, 4) -> (..., 6, 6)."""
    T = np.asarray(motion, dtype=np.float64)
    R = T[..., :3, :3]
    return _block_triangular(R, hat(T[..., :3, 3]) @ R)


def bracket_matrix(twist: ArrayLike) -> Float:
    """``ad_ξ``, the derivative of `adjoint` at the identity. (..., 6) -> (..., 6, 6)."""
    xi = np.asarray(twist, dtype=np.float64)
    return _block_triangular(hat(xi[..., :3]), hat(xi[..., 3:]))


def _block_triangular(on: Float, below: Float) -> Float:
    """(..., 6, 6) of the same block (..., 3, 3) twice on the diagonal, and one below it."""
    out = np.zeros((*on.shape[:-2], 6, 6))  # np.block takes longer than all the rest here
    out[..., :3, :3] = out[..., 3:, 3:] = on
    out[..., 3:, :3] = below
    return out


def left_jacobian(twist: ArrayLike) -> Float:
    """J with ``exp(ξ + δ) ≈ exp(J δ) exp(ξ)``, ``J = Σ ad_ξⁿ/(n+1)!``. (..., 6) -> (..., 6, 6).

    Above 1 rad the closed form in ad … ad⁴, below it the series, exact there to the last digit.
    """
    xi = np.asarray(twist, dtype=np.float64)
    ad = bracket_matrix(xi)
    eye = np.eye(6)
    series = np.broadcast_to(eye, ad.shape).copy()
    for n in range(18, 0, -1):
        series = eye + ad @ series / (n + 1)
    phi = np.linalg.norm(xi[..., :3], axis=-1)[..., None, None]
    if np.all(phi < 1.0):
        return series
    f = np.where(phi < 1.0, 1.0, phi)
    s, c = np.sin(f), np.cos(f)
    ad2 = ad @ ad
    closed = (
        eye
        + (4 - f * s - 4 * c) / (2 * f**2) * ad
        + (4 * f - 5 * s + f * c) / (2 * f**3) * ad2
        + (2 - f * s - 2 * c) / (2 * f**4) * (ad2 @ ad)
        + (2 * f - 3 * s + f * c) / (2 * f**5) * (ad2 @ ad2)
    )
    return np.where(phi < 1.0, series, closed)


def inverse_left_jacobian(twist: ArrayLike) -> Float:
    """Inverse of `left_jacobian`; below 0.1 rad by the Bernoulli series. (..., 6) -> (..., 6, 6)."""
    xi = np.asarray(twist, dtype=np.float64)
    if np.all(np.abs(xi[..., :3]) < 0.1):
        ad = bracket_matrix(xi)
        ad2 = ad @ ad
        return np.eye(6) - 0.5 * ad + ad2 / 12.0 - (ad2 @ ad2) / 720.0 + (ad2 @ ad2 @ ad2) / 30240.0
    return np.asarray(np.linalg.inv(left_jacobian(xi)), dtype=np.float64)


def is_motion(matrix: ArrayLike, tolerance: float = 1e-4) -> Bool:
    """(...,) whether matrices (..., 4, 4) are rigid motions: rotation, finite translation, last row 0 0 0 1."""
    T = np.asarray(matrix, float)
    R = np.where(np.isfinite(T[..., :3, :3]), T[..., :3, :3], 0.0)
    square = np.all(np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)) < tolerance, axis=(-1, -2))
    last = np.all(np.abs(T[..., 3, :] - [0.0, 0.0, 0.0, 1.0]) < tolerance, axis=-1)
    return square & last & (np.linalg.det(R) > 0) & np.all(np.isfinite(T), axis=(-1, -2))


def orthonormalised(motion: ArrayLike) -> Float:
    """The motion nearest to a matrix that has left SE(3) by rounding. (..., 4, 4) -> (..., 4, 4)."""
    T = np.array(motion, dtype=np.float64)
    U, _, Vt = np.linalg.svd(T[..., :3, :3])
    sign = np.linalg.det(U @ Vt)[..., None]
    U = np.concatenate([U[..., :2], U[..., 2:] * sign[..., None]], axis=-1)
    return transform(U @ Vt, T[..., :3, 3])


@njit(cache=True, nogil=True)
def log_one(T: Float) -> Float:
    """`log` of a single motion (4, 4) -> (6,)."""
    trace = T[0, 0] + T[1, 1] + T[2, 2]
    K = np.empty((4, 4))
    K[0, 0] = 1.0 + trace
    K[0, 1], K[0, 2], K[0, 3] = T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]
    for i in range(3):
        K[i + 1, 0] = K[0, i + 1]
        for j in range(3):
            K[i + 1, j + 1] = T[i, j] + T[j, i] + (1.0 - trace if i == j else 0.0)
    best = 0
    for i in range(1, 4):
        if K[i, i] > K[best, best]:
            best = i
    q = K[:, best] / np.sqrt(K[0, best] ** 2 + K[1, best] ** 2 + K[2, best] ** 2 + K[3, best] ** 2)
    if q[0] < 0.0:
        q = -q
    sine = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    theta = 2.0 * np.arctan2(sine, q[0])
    factor = 2.0 if sine < 1e-12 else theta / sine
    w0, w1, w2 = factor * q[1], factor * q[2], factor * q[3]
    half = 0.5 * theta
    rest = 1 / 12 + theta**2 / 720 + theta**4 / 30240 if theta < 1e-2 else (1 - half / np.tan(half)) / (4 * half**2)
    t0, t1, t2 = T[0, 3], T[1, 3], T[2, 3]
    c0, c1, c2 = w1 * t2 - w2 * t1, w2 * t0 - w0 * t2, w0 * t1 - w1 * t0
    out = np.empty(6)
    out[0], out[1], out[2] = w0, w1, w2
    out[3] = t0 - 0.5 * c0 + rest * (w1 * c2 - w2 * c1)
    out[4] = t1 - 0.5 * c1 + rest * (w2 * c0 - w0 * c2)
    out[5] = t2 - 0.5 * c2 + rest * (w0 * c1 - w1 * c0)
    return out


@njit(cache=True, nogil=True)
def exp_one(twist: Float) -> Float:
    """`exp` of a single twist (6,) -> (4, 4)."""
    w0, w1, w2, v0, v1, v2 = twist
    t2 = w0 * w0 + w1 * w1 + w2 * w2
    t = np.sqrt(t2)
    a = 1.0 - t2 / 6.0 if t < _SMALL else np.sin(t) / t
    b = 0.5 - t2 / 24.0 if t < _SMALL else 2.0 * np.sin(0.5 * t) ** 2 / t2
    c = 1 / 6 - t2 / 120 * (1 - t2 / 42 * (1 - t2 / 72 * (1 - t2 / 110))) if t < 0.3 else (t - np.sin(t)) / (t * t2)
    c0, c1, c2 = w1 * v2 - w2 * v1, w2 * v0 - w0 * v2, w0 * v1 - w1 * v0
    out = np.empty((4, 4))
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - b * (w1 * w1 + w2 * w2), b * w0 * w1 - a * w2, b * w0 * w2 + a * w1
    out[1, 0], out[1, 1], out[1, 2] = b * w0 * w1 + a * w2, 1.0 - b * (w0 * w0 + w2 * w2), b * w1 * w2 - a * w0
    out[2, 0], out[2, 1], out[2, 2] = b * w0 * w2 - a * w1, b * w1 * w2 + a * w0, 1.0 - b * (w0 * w0 + w1 * w1)
    out[0, 3] = v0 + b * c0 + c * (w1 * c2 - w2 * c1)
    out[1, 3] = v1 + b * c1 + c * (w2 * c0 - w0 * c2)
    out[2, 3] = v2 + b * c2 + c * (w0 * c1 - w1 * c0)
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0
    return out


@njit(cache=True, nogil=True)
def compose_one(A: Float, B: Float) -> Float:
    """``A B`` of single motions (4, 4), orthonormalised: ``R <- R (3 I - RᵀR) / 2`` squares the rounding error."""
    out = np.zeros((4, 4))
    R = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            R[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        out[i, 3] = A[i, 0] * B[0, 3] + A[i, 1] * B[1, 3] + A[i, 2] * B[2, 3] + A[i, 3]
    for j in range(3):
        for k in range(3):
            gram = R[0, j] * R[0, k] + R[1, j] * R[1, k] + R[2, j] * R[2, k]
            factor = 0.5 * ((3.0 if j == k else 0.0) - gram)
            for i in range(3):
                out[i, k] += R[i, j] * factor
    out[3, 3] = 1.0
    return out


@njit(cache=True, nogil=True)
def inverse_one(T: Float) -> Float:
    """`inverse` of a single motion (4, 4)."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = T[j, i]
            out[i, 3] -= T[j, i] * T[j, 3]
    out[3, 3] = 1.0
    return out


@njit(cache=True, nogil=True)
def inverse_left_jacobian_one(twist: Float) -> Float:
    """`inverse_left_jacobian` of a single twist (6,) -> (6, 6).

    Since ``(ad² + θ²)² ad = 0``, the Bernoulli series ends: ``1 - ad/2 + a ad² + b ad⁴`` (Selig, "Geometric
    Fundamentals of Robotics", 2005; DOI 10.1007/b138859). Below 0.03 rad its factors are replaced by their series.
    """
    w0, w1, w2, v0, v1, v2 = twist
    ad = np.zeros((6, 6))
    for k in (0, 3):
        ad[k, k + 1], ad[k, k + 2], ad[k + 1, k + 2] = -w2, w1, -w0
        ad[k + 1, k], ad[k + 2, k], ad[k + 2, k + 1] = w2, -w1, w0
    ad[3, 1], ad[3, 2], ad[4, 2], ad[4, 0], ad[5, 0], ad[5, 1] = -v2, v1, -v0, v2, -v1, v0
    t2 = w0 * w0 + w1 * w1 + w2 * w2
    a, b = 1 / 12 - t2 * t2 / 30240, -1 / 720 - t2 / 15120
    if t2 > 1e-3:
        t = np.sqrt(t2)
        sine, versine = np.sin(t), 2.0 * np.sin(0.5 * t) ** 2
        a = 2.0 / t2 - (t + 3.0 * sine) / (4.0 * t * versine)
        b = 1.0 / (t2 * t2) - (t + sine) / (4.0 * t2 * t * versine)
    ad2 = _product(ad, ad)
    out = _product(ad2, ad2)
    for i in range(6):
        for j in range(6):
            out[i, j] = b * out[i, j] + a * ad2[i, j] - 0.5 * ad[i, j] + (1.0 if i == j else 0.0)
    return out


@njit(cache=True, nogil=True)
def _product(A: Float, B: Float) -> Float:
    """``A B`` of square matrices, without BLAS, which takes long to compile."""
    out = np.zeros(A.shape)
    for i in range(len(A)):
        for k in range(len(A)):
            for j in range(len(A)):
                out[i, j] += A[i, k] * B[k, j]
    return out


@njit(cache=True, nogil=True)
def difference_one(A: Float, B: Float) -> Float:
    """Twist (6,) with ``A = exp(ξ̂) B``."""
    return log_one(compose_one(A, inverse_one(B)))


# The readable twins of the kernels above are the batched functions of this module.
exp_one_reference = exp
log_one_reference = log
inverse_one_reference = inverse
inverse_left_jacobian_one_reference = inverse_left_jacobian


def compose_one_reference(A: Float, B: Float) -> Float:
    """Readable twin of `compose_one`."""
    return A @ B


def difference_one_reference(A: Float, B: Float) -> Float:
    """Readable twin of `difference_one`."""
    return log(A @ inverse(B))
