"""The least-squares problem of the first pose: keypoints in some views, robust, with limits and weak priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap._typing import Float, Int
from twistcap.body import Body, Pose
from twistcap.body.kinematics import Posed
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.firstpose.skeleton import Skeleton

# How much looser than a wrist's a detector's word on these is (their definitions differ between detector and body:
# the hips of OpenPose lie several centimetres off the joints).
_LOOSENESS = {
    "hip": 2.0, "mid_hip": 1.5, "neck": 2.0, "head_top": 2.0, "nose": 1.5, "eye": 2.0, "ear": 2.0, "toe": 1.5,
    "small_toe": 2.0, "heel": 1.5, "shoulder": 1.3,
}  # fmt: skip
_BLUR = 0.015  # a detector's standard deviation as a part of the person's height in the image


@dataclass(frozen=True)
class Priors:
    """Standard deviations of the weak priors: coordinates (rad), limits (rad beyond them), log-factors."""

    coordinate: float = 1.0
    limit: float = 0.01
    stature: float = 0.12
    length: float = 0.06
    girth: float = 0.06


@dataclass(frozen=True)
class Evidence:
    """Keypoints of one instant made ready: N landmarks of the body in C pinhole views.

    Attributes:
        marks: (N,) landmark of the body.
        columns: (N,) column of each in the keypoints as given.
        rig: pinhole cameras.
        P: (C, 3, 4) their matrices.
        pixels: (C, N, 2) undistorted, 0 where there is none.
        weights: (C, N) confidence, 0 where there is none.
        sigma: (C, N) standard deviation, pixels.
    """

    marks: Int
    columns: Int
    rig: Rig
    P: Float
    pixels: Float
    weights: Float
    sigma: Float


def evidence(body: Body, rig: Rig, keypoints: Keypoints, sigma_px: float | None = None) -> Evidence:
    """Check keypoints against body and rig, undistort them, and give each its standard deviation.

    Raises:
        InputError: for arrays of the wrong shape, values that are not finite, or fewer than two views.
    """
    _check(rig, keypoints)
    known = {name: i for i, name in enumerate(body.landmarks.names)}
    columns = np.array([i for i, name in enumerate(keypoints.names) if name in known], np.int32)
    names = [keypoints.names[i] for i in columns]
    pixels = np.stack([_undistorted(rig, c, keypoints.pixels[c, columns]) for c in range(len(rig))])
    weights = np.where(np.isfinite(pixels).all(axis=-1), keypoints.confidence[:, columns], 0.0)
    if np.count_nonzero((weights > 0).sum(axis=1) >= 3) < 2:
        raise InputError(
            "keypoints: at least two cameras must see three or more known joints each; add views or joints."
        )
    height = np.array([_extent(p[w > 0]) for p, w in zip(pixels, weights, strict=True)])
    base = np.maximum(_BLUR * height, 0.5) if sigma_px is None else np.full(len(rig), sigma_px)
    sigma = base[:, None] * np.array([_looseness(n) for n in names])
    marks = np.array([known[n] for n in names], np.int32)
    P = np.stack([camera.P for camera in rig])
    return Evidence(marks, columns, rig.pinhole(), P, np.nan_to_num(pixels), weights, sigma)


def _check(rig: Rig, keypoints: Keypoints) -> None:
    C, L = len(rig), len(keypoints.names)
    if keypoints.pixels.shape != (C, L, 2) or keypoints.confidence.shape != (C, L):
        shapes = f"{keypoints.pixels.shape} and {keypoints.confidence.shape}"
        raise InputError(
            f"keypoints: pixels and confidence are {shapes}; {C} cameras and {L} names need {(C, L, 2)}, {(C, L)}."
        )
    seen = keypoints.confidence != 0
    if not np.all(np.isfinite(keypoints.confidence)) or not np.all(np.isfinite(keypoints.pixels[seen])):
        raise InputError(
            "keypoints: a pixel with confidence, or a confidence, is not a finite number; give it weight 0."
        )
    if np.any(keypoints.confidence < 0):
        raise InputError("keypoints: a confidence is negative; it must lie between 0 and 1.")


def _undistorted(rig: Rig, c: int, pixels: Float) -> Float:
    K = rig[c].K
    return rig[c].normalised(pixels) @ K[:2, :2].T + K[:2, 2]


def _extent(pixels: Float) -> float:
    return float(np.ptp(pixels, axis=0).max()) if len(pixels) > 1 else 0.0


def _looseness(name: str) -> float:
    return _LOOSENESS.get(name.removesuffix("_r").removesuffix("_l"), 1.0)


@dataclass(frozen=True)
class State:
    """Poses of F instants and the log-factors they share."""

    poses: tuple[Pose, ...]
    log_factors: Float


@dataclass(frozen=True)
class Problem:
    """Robust energy of a `State` and its normal equations.

    Robust function: Geman and McClure's, ``ρ(r) = c² r² / (c² + r²)``, whose weight falls to 0 for gross errors.

    Attributes:
        skeleton: the scalable body.
        frames: evidence of each instant.
        neutral: (J,) coordinates the weak prior pulls to.
        priors: their widths.
        reach: c, in standard deviations.
        fit_lengths: whether the log-factors are free.
    """

    skeleton: Skeleton
    frames: tuple[Evidence, ...]
    neutral: Float
    priors: Priors
    reach: float
    fit_lengths: bool

    def energy(self, state: State) -> float:
        body = self.skeleton.scaled(state.log_factors)
        total = 0.5 * float(np.sum((state.log_factors / self._factor_sigma) ** 2))
        for frame, pose in zip(self.frames, state.poses, strict=True):
            r2 = _squares(residuals(frame, Posed(body, pose).landmarks[frame.marks]))
            total += 0.5 * float(np.sum(frame.weights * self.reach**2 * r2 / (self.reach**2 + r2)))
            total += 0.5 * float(np.sum(self._prior_rows(pose)[0] ** 2))
        return total

    def normal_equations(self, state: State) -> tuple[Float, Float]:
        """Gradient and Gauss-Newton matrix by (pose step of every instant, log-factors)."""
        body, D, F = self.skeleton.scaled(state.log_factors), self.skeleton.body.dof, len(self.frames)
        n = F * D + self.skeleton.size
        g, H = np.zeros(n), np.zeros((n, n))
        for f, (frame, pose) in enumerate(zip(self.frames, state.poses, strict=True)):
            rows = np.r_[f * D : (f + 1) * D, F * D : n]
            gradient, matrix = self._frame_equations(frame, Posed(body, pose), state.log_factors)
            g[rows] += gradient
            H[np.ix_(rows, rows)] += matrix
        g[F * D :] += state.log_factors / self._factor_sigma**2
        H[range(F * D, n), range(F * D, n)] += 1.0 / self._factor_sigma**2
        return (g, H) if self.fit_lengths else (g[: F * D], H[: F * D, : F * D])

    def _frame_equations(self, frame: Evidence, posed: Posed, log_factors: Float) -> tuple[Float, Float]:
        marks = posed.body.landmarks
        one = np.ones((len(frame.marks), 1))
        by_pose = posed.point_jacobian(marks.segments[frame.marks, None], one, marks.points[frame.marks])
        by_factor = self.skeleton.jacobian(posed, log_factors)[frame.marks]
        points = posed.landmarks[frame.marks]
        r = residuals(frame, points)
        J = np.einsum("cnij,njd->cnid", _image_jacobian(frame, points), np.concatenate([by_pose, by_factor], axis=2))
        w = frame.weights * self.robust_weight(r)
        g, H = np.einsum("cn,cnid,cni->d", w, J, r), np.einsum("cnid,cnie->de", w[..., None, None] * J, J)
        prior, slope = self._prior_rows(posed.pose)
        q = slice(6, posed.body.dof)
        g[q] += (slope * prior).sum(axis=0)
        H[range(6, posed.body.dof), range(6, posed.body.dof)] += (slope**2).sum(axis=0)
        return g, H

    def robust_weight(self, r: Float) -> Float:
        """Weight of residuals (..., 2) in standard deviations."""
        return (self.reach**2 / (self.reach**2 + _squares(r))) ** 2

    def _prior_rows(self, pose: Pose) -> tuple[Float, Float]:
        """Residuals (2, J) of prior and limits, and their slopes."""
        lower, upper = self.skeleton.body.limits.T
        beyond = pose.q - np.clip(pose.q, lower, upper)
        rows = np.stack([(pose.q - self.neutral) / self.priors.coordinate, beyond / self.priors.limit])
        slope = np.stack([np.full(len(pose.q), 1 / self.priors.coordinate), (beyond != 0) / self.priors.limit])
        return rows, slope

    @property
    def _factor_sigma(self) -> Float:
        lengths, girths = len(self.skeleton.length_groups), len(self.skeleton.girth_segments)
        p = self.priors
        return np.array([p.stature, *[p.length] * lengths, *[p.girth] * girths])


def residuals(frame: Evidence, points: Float) -> Float:
    """(C, N, 2) reprojection errors of points (N, 3) in standard deviations; very large behind a camera."""
    h = points @ np.swapaxes(frame.P[:, :, :3], 1, 2) + frame.P[:, None, :, 3]
    depth = h[..., 2:]
    r = (h[..., :2] / np.where(depth > 0.05, depth, 1.0) - frame.pixels) / frame.sigma[..., None]
    return np.where(depth > 0.05, r, 1e6)


def _image_jacobian(frame: Evidence, points: Float) -> Float:
    """(C, N, 2, 3) derivative of `residuals` by the points."""
    h = points @ np.swapaxes(frame.P[:, :, :3], 1, 2) + frame.P[:, None, :, 3]
    depth = np.where(h[..., 2] > 0.05, h[..., 2], np.inf)[..., None, None]
    uv = h[..., :2, None] / depth
    return (frame.P[:, None, :2, :3] - uv * frame.P[:, None, 2:, :3]) / depth / frame.sigma[..., None, None]


def _squares(r: Float) -> Float:
    return np.sum(r * r, axis=-1)


def minimise(problem: Problem, state: State, iterations: int = 30, tolerance: float = 1e-4) -> State:
    """Levenberg-Marquardt; a step is taken only if the energy falls (Madsen, Nielsen and Tingleff 2004, alg. 3.16)."""
    energy, damping = problem.energy(state), 1e-3
    g, H = problem.normal_equations(state)
    for _ in range(iterations):
        step = np.asarray(np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-9), -g), np.float64)
        trial = retract(state, step)
        trial_energy = problem.energy(trial)
        if not trial_energy < energy:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        gain, state, energy = energy - trial_energy, trial, trial_energy
        if gain < tolerance * energy:
            break
        damping = max(damping / 5.0, 1e-7)
        g, H = problem.normal_equations(state)
    return state


def retract(state: State, step: Float) -> State:
    """The state after a step (F D [+ factors])."""
    F, D = len(state.poses), 6 + len(state.poses[0].q)
    poses = tuple(pose.retract(step[f * D : (f + 1) * D]) for f, pose in enumerate(state.poses))
    factors = state.log_factors if len(step) == F * D else state.log_factors + step[F * D :]
    return State(poses, factors)
