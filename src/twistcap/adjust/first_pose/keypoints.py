"""The least-squares problem of the first pose: keypoints in some views, robust, with limits and weak priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from twistcap.adjust.first_pose.skeleton import Scaling, Skeleton
from twistcap.arrays import Float, Int
from twistcap.body import Body, Pose
from twistcap.body.model import unsided
from twistcap.body.rig_spec import RIG_MEND
from twistcap.camera import Rig, pinhole
from twistcap.errors import InputError, check
from twistcap.estimate import Keypoints
from twistcap.solve import Arrow, BlockProblem, Dense, PoseTrack, Solution, Variables, minimise
from twistcap.terms import BlockGaussian, GaussianTerm, LimitTerm, OnPose, ReprojectionTerm

# Standard deviations as multiples of a wrist's: the definitions differ between detector and body. The hips of OpenPose
# are several centimetres from the joints.
_LOOSENESS = {
    "hip": 2.0, "mid_hip": 1.5, "neck": 2.0, "head_top": 2.0, "nose": 1.5, "eye": 2.0, "ear": 2.0, "toe": 1.5,
    "small_toe": 2.0, "heel": 1.5, "shoulder": 1.3,
}  # fmt: skip
_GAIN = 1e-4  # fraction by which a step must lower the energy, else the solve ends
_BLUR = 0.015  # a detector's standard deviation as a fraction of the person's height in the image

COORDINATE = 0.5
"""rad, standard deviation of a joint about 0, before its limits truncate that. Of 0.3, 0.4, 0.5, 0.6 and 1 rad it gave
the smallest error of the joints in 24 people of the studio, clicked in six joints (22 mm; 38 at 1 rad)."""
LIMIT = 0.01
"""rad beyond a limit, standard deviation."""
_STATURE, _LENGTH, _GIRTH = 0.12, 0.06, 0.06  # standard deviations of the log-factors


@dataclass(frozen=True)
class Evidence:
    """Keypoints of one instant made ready: N landmarks of the body (`marks`) in C pinhole views.

    `columns` (N,) are those of the keypoints as given. Pixels (C, N, 2) are undistorted, with confidence `weights`
    (C, N); both are 0 where there is none. `sigma` (C, N) is their standard deviation, pixels.
    """

    marks: Int
    columns: Int
    rig: Rig
    pixels: Float
    weights: Float
    sigma: Float


def evidence(body: Body, rig: Rig, keypoints: Keypoints, sigma_px: float | None = None) -> Evidence:
    """Check keypoints against body and rig, undistort them, and give each its standard deviation.

    Arguments are those of `fit_keypoints`. Raises InputError for arrays of the wrong shape, values that are not finite,
    fewer than two views, or joints that the body does not have.
    """
    _check(rig, keypoints)
    check_views(rig)
    known = {name: i for i, name in enumerate(body.landmarks.names)}
    columns = np.array([i for i, name in enumerate(keypoints.names) if name in known], np.int32)
    names = [keypoints.names[i] for i in columns]
    lacks = [name for name in keypoints.names if name not in known]
    own = f"the body {body.name!r} has {len(names)} of their {len(keypoints.names)} joints"
    check("keypoints", len(names) >= 3 or not lacks, f"{own}, and no {', '.join(lacks[:4])} …; {RIG_MEND}")
    pixels = np.stack([_undistorted(rig, c, keypoints.pixels[c, columns]) for c in range(len(rig))])
    weights = np.where(np.isfinite(pixels).all(axis=-1), keypoints.confidence[:, columns], 0.0)
    enough = np.count_nonzero((weights > 0).sum(axis=1) >= 3) >= 2
    check("keypoints", enough, "two cameras must see three or more known joints each; add views or joints")
    extents = [
        np.ptp(p[w > 0], axis=0).max() if np.sum(w > 0) > 1 else 0.0 for p, w in zip(pixels, weights, strict=True)
    ]
    height = np.array(extents)
    base = np.maximum(_BLUR * height, 0.5) if sigma_px is None else np.full(len(rig), sigma_px)
    sigma = base[:, None] * np.array([_LOOSENESS.get(unsided(name), 1.0) for name in names])
    marks = np.array([known[n] for n in names], np.int32)
    return Evidence(marks, columns, rig.pinhole(), np.nan_to_num(pixels), weights, sigma)


def check_views(rig: Rig) -> None:
    """Raises InputError for a camera alone, where no way of finding a first pose knows the depth."""
    if len(rig) < 2:
        ways = "not in its images, by keypoints or by clicks, as one view does not show depth"
        mend = "add a second camera, or give the pose itself, as [first_pose] file"
        raise InputError(f"camera {rig.names[0]} alone gives no first pose, {ways}; {mend}.")


def _check(rig: Rig, keypoints: Keypoints) -> None:
    C, L = len(rig), len(keypoints.names)
    if keypoints.pixels.shape != (C, L, 2) or keypoints.confidence.shape != (C, L):
        shapes, need = f"{keypoints.pixels.shape} and {keypoints.confidence.shape}", f"{(C, L, 2)}, {(C, L)}"
        raise InputError(f"keypoints: pixels and confidence are {shapes}; {C} cameras and {L} names need {need}.")
    seen = keypoints.confidence != 0
    if not np.all(np.isfinite(keypoints.confidence)) or not np.all(np.isfinite(keypoints.pixels[seen])):
        raise InputError("keypoints: a pixel or a confidence is not a finite number; give it weight 0.")
    check("keypoints", not np.any(keypoints.confidence < 0), "a confidence is negative; it must lie between 0 and 1")


def _undistorted(rig: Rig, c: int, pixels: Float) -> Float:
    K = rig[c].K
    return rig[c].normalised(pixels) @ K[:2, :2].T + K[:2, 2]


@dataclass(frozen=True)
class KeypointProblem:
    """Which blocks are free and which terms are summed: poses of F instants, and the log-factors that they share.

    `reach` is that of the robust function, in standard deviations; `fit_lengths` says whether the log-factors are free,
    and `limit` (rad) is the standard deviation beyond a limit of a joint.
    """

    skeleton: Skeleton
    frames: tuple[Evidence, ...]
    reach: float
    fit_lengths: bool
    limit: float = LIMIT

    def start(self, poses: Sequence[Pose], log_factors: Float) -> Variables:
        """The blocks at these poses and log-factors."""
        blocks = {
            "poses": PoseTrack(tuple(poses), np.arange(float(len(poses)))),
            "shape": Scaling(log_factors, skeleton=self.skeleton),
        }
        return Variables(blocks, ("poses", "shape") if self.fit_lengths else ("poses",))

    def minimised(self, x: Variables, steps: int = 30) -> Solution[Variables, Dense | Arrow]:
        """The minimum of the terms from there."""
        return minimise(self.problem, x, steps, damping=1e-4, gain=_GAIN)

    def energy(self, x: Variables) -> float:
        """Of all terms."""
        return sum(self.problem.energies(x).values())

    @cached_property
    def problem(self) -> BlockProblem:
        """Keypoints, limits and weak priors."""
        sigmas = self.skeleton.sigmas(_STATURE, _LENGTH, _GIRTH)
        factors = BlockGaussian("shape", np.zeros(self.skeleton.size), sigmas)
        return BlockProblem([*self.keypoints, *self._poses(), factors])

    @cached_property
    def keypoints(self) -> list[ReprojectionTerm]:
        """One term for each instant and view in which a landmark is known."""
        views = [(f, c) for f, frame in enumerate(self.frames) for c in range(len(frame.rig))]
        return [self._view(f, c) for f, c in views if self.frames[f].weights[c].any()]

    def _view(self, f: int, c: int) -> ReprojectionTerm:
        frame = self.frames[f]
        own = np.flatnonzero(frame.weights[c] > 0)
        pixels, weight, sigma = (array[c, own] for array in (frame.pixels, frame.weights, frame.sigma))
        return ReprojectionTerm(frame.rig[c].P, frame.marks[own], pixels, weight, sigma, self.reach, f)

    def _poses(self) -> list[OnPose]:
        body = self.skeleton.body
        mean, sigma = truncated(body.limits, COORDINATE)
        neutral, joints = Pose(np.eye(4), mean), np.diag(np.r_[np.zeros(6), sigma**-2.0])
        each = (GaussianTerm(neutral, joints, "neutral"), LimitTerm(self.limit))
        return [OnPose(term, body, frame=f) for f in range(len(self.frames)) for term in each]


def truncated(limits: Float, sigma: float) -> tuple[Float, Float]:
    """Mean and standard deviation (J,) of normal joint coordinates, 0 ± sigma (rad), truncated to limits (J, 2).

    A hinge that is straight at its limit is mostly a little bent. With a Gaussian about 0 it would be straight, and the
    bones too short. (Johnson, Kotz and Balakrishnan, "Continuous Univariate Distributions", 1994, 13.10.1.)
    """
    a, b = np.clip(limits.T / sigma, -40.0, 40.0)
    density_a, density_b = (np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi) for x in (a, b))
    inside = np.maximum(ndtr(b) - ndtr(a), 1e-9)
    mean = (density_a - density_b) / inside
    variance = 1.0 + (a * density_a - b * density_b) / inside - mean**2
    return np.clip(sigma * mean, *limits.T), sigma * np.sqrt(np.maximum(variance, 1e-4))


def residuals(frame: Evidence, points: Float) -> Float:
    """(C, N, 2) reprojection errors of points (N, 3) in standard deviations; very large behind a camera."""
    pixels, depth, _ = pinhole(np.stack([camera.P for camera in frame.rig]), points[None])
    off = (pixels - frame.pixels) / frame.sigma[..., None]
    return np.where(depth[..., None] > 0.05, off, 1e6)
