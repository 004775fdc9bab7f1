"""Readable twins of functions that have their kernels to themselves."""

from __future__ import annotations

import math

import cv2
import numpy as np

from twistcap.arrays import Float, Float32, Int
from twistcap.body import Body, Posed
from twistcap.camera import ScaledView
from twistcap.render import SurfacePoints
from twistcap.terms import Rows
from twistcap.terms.photometric import Samples, sample
from twistcap.terms.scaled import image_motion


def stacked_rows(posed: Posed, points: SurfacePoints, rows: Rows, beside: Float | None = None) -> tuple[Float, Float]:
    """Readable twin of `terms.accumulate.normal_equations`."""
    jacobian = posed.point_jacobian(points.segments, points.weights, points.local)
    J = np.einsum("ni,nid->nd", rows.gradient, jacobian)
    if beside is not None:
        J = np.concatenate([J, beside], axis=1)
    return J.T @ (rows.weight * rows.residual), J.T @ (rows.weight[:, None] * J)


def stacked_view_rows(
    posed: Posed, view: ScaledView, samples: Samples, image: Float32, exposure: Float, weight: Float
) -> tuple[Float, Float]:
    """Readable twin of `terms.scaled.normal_equations`."""
    pixels = view.pixels(samples.points.at(posed))
    here = [sample(image, x, y) for x, y in pixels]
    value, slope = np.array([s[0] for s in here]), np.array([s[1:3] for s in here])
    inside = np.array([s[3] for s in here])
    motion = np.einsum("ni,nid->nd", 0.5 * (slope + samples.gradient), image_motion(posed, view, samples.points))
    rows = np.concatenate([motion, -samples.value[:, None], -np.ones((len(motion), 1))], axis=1)
    r = value - (1.0 + exposure[0]) * samples.value - exposure[1]
    w = np.where(inside, weight, 0.0)
    return rows.T @ (w * r), rows.T @ (w[:, None] * rows)


def tv_step_reference(channels: Float32, tau: float, epsilon: float) -> Float:
    """Readable twin of `tv_step`, by dense matrices."""
    u = channels.astype(float)
    down = _implicit_down_reference(u, 2.0 * tau, epsilon)
    along = _implicit_down_reference(u.transpose(0, 2, 1), 2.0 * tau, epsilon)
    return 0.5 * (down + along.transpose(0, 2, 1))


def _implicit_down_reference(u: Float, tau: float, epsilon: float) -> Float:
    padded = np.pad(u, ((0, 0), (0, 0), (1, 1)), mode="edge")
    central = (padded[:, :, 2:] - padded[:, :, :-2]) / 2
    aside = (central[:, 1:] + central[:, :-1]) / 2
    g = 1.0 / np.sqrt((np.diff(u, axis=1) ** 2 + aside**2).sum(axis=0) + epsilon**2)  # (H − 1, W), between rows
    height, out = u.shape[1], np.empty_like(u)
    difference = np.diff(np.eye(height), axis=0)
    for c in range(u.shape[2]):
        matrix = np.eye(height) + tau * difference.T @ np.diag(g[:, c]) @ difference
        out[:, :, c] = np.linalg.solve(matrix, u[:, :, c].T).T
    return out


def blend_binding_reference(body: Body, corners: Int, weights: Float, keep: int = 4) -> Float:
    """Readable twin of the binding of `render.view.surface_points`, as dense weights (N, S)."""
    dense = np.zeros((len(body.vertices), len(body.segment_names)))
    rows = np.repeat(np.arange(len(body.vertices)), body.skin_segments.shape[1])
    np.add.at(dense, (rows, body.skin_segments.ravel()), body.skin_weights.ravel())
    blended = np.einsum("nm,nms->ns", weights, dense[corners])
    threshold = -np.sort(-blended, axis=1)[:, min(keep, blended.shape[1]) - 1 :][:, :1]
    kept = np.where(blended >= threshold, blended, 0.0)
    return kept / kept.sum(axis=1, keepdims=True)


def blockwise_log_ratio_reference(
    channels: Float32, inside: Float32, rho: float, floor: float, prior_mass: float
) -> Float32:
    """Readable twin of `blockwise_log_ratio` and its kernels, with statistics of pixels in place of blocks."""
    size = max(3, 2 * round(rho * math.sqrt(3.0)) + 1)
    values, gaussians = channels.astype(float), list[tuple[Float, Float]]()
    for weight in (inside.astype(float), 1.0 - inside):
        sums = weight[..., None] * np.concatenate([np.ones((*weight.shape, 1)), values, values**2], axis=2)
        prior = prior_mass * sums.mean(axis=(0, 1)) / max(float(weight.mean()), 1e-6)
        window = cv2.boxFilter(sums, -1, (size, size), borderType=cv2.BORDER_REFLECT_101) + prior
        mean, second = np.split(window[..., 1:] / np.maximum(window[..., :1], 1e-6), 2, axis=2)
        gaussians.append((mean, np.maximum(second - mean**2, 0.0) + floor))
    (mu_in, var_in), (mu_out, var_out) = gaussians
    ratio = (values - mu_out) ** 2 / var_out - (values - mu_in) ** 2 / var_in + np.log(var_out / var_in)
    return (0.5 * ratio.sum(axis=2)).astype(np.float32)
