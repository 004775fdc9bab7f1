"""The first pose from 2D keypoints: root, joint angles and segment lengths together, robustly, from several starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.adjust.first_pose.keypoints import Evidence, KeypointProblem, evidence, residuals
from twistcap.adjust.first_pose.skeleton import Proportions, Skeleton
from twistcap.adjust.first_pose.triangulate import rigid_fit, triangulate
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose
from twistcap.body.kinematics import Posed
from twistcap.body.model import unsided
from twistcap.body.shape import rescaled
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.solve import Variables
from twistcap.terms.robust import geman_mcclure

_FEWEST = 5  # triangulated joints, at least
_REACH = 4.0  # final scale of the robust function, standard deviations
_USED = 0.2  # robust weight above which a keypoint counts as used
_TRUNK = ("hip", "shoulder", "mid_hip", "neck")  # landmarks that hardly move with limbs
_CURVED = 3.0  # standard deviations from a straight line in time that are no noise
_LOOSE = 0.2  # rad, standard deviation beyond a limit while starts are compared

# Start poses in degrees, both sides alike; coordinates that the body lacks do not count.
STARTS_DEG: tuple[Mapping[str, float], ...] = (
    {},
    {"arm_add": -80.0},
    {"arm_flex": 70.0, "elbow_flex": 40.0},
    {"arm_add": -150.0, "elbow_flex": 20.0},
    {"arm_flex": 140.0, "elbow_flex": 20.0},
    {"hip_flexion": 70.0, "knee_angle": 90.0, "ankle_angle": 20.0, "elbow_flex": 60.0},
    {"arm_flex": -30.0, "elbow_flex": 90.0, "lumbar_extension": -30.0},
)


@dataclass(frozen=True)
class FirstPose:
    """A pose fitted to keypoints, and the body at the fitted lengths.

    The proportions made the body from the generic one. `residual_px` (C, L) is the distance between keypoint and
    landmark, undistorted pixels, NaN where there is none; `used` (C, L) are the keypoints that counted. The covariance
    (6 + J, 6 + J) of the pose step (rad, m) is that of the solve, scaled to the residuals.
    """

    body: Body
    pose: Pose
    proportions: Proportions
    residual_px: Float
    used: Bool
    names: tuple[str, ...]
    cameras: tuple[str, ...]
    covariance: Float

    @property
    def rejected(self) -> tuple[tuple[str, str], ...]:
        """Camera and name of every keypoint that was given and did not count."""
        given = np.isfinite(self.residual_px)
        return tuple((self.cameras[c], self.names[n]) for c, n in np.argwhere(given & ~self.used))


def fit_keypoints(
    body: Body, rig: Rig, keypoints: Keypoints, *, fit_lengths: bool = True, sigma_px: float | None = None,
    start: Pose | None = None,
) -> FirstPose:  # fmt: skip
    """Pose and lengths of a person from 2D keypoints in two or more views.

    Landmarks are triangulated with a vote of all views; those of the trunk give the root. Levenberg-Marquardt on the
    reprojection errors gives the rest, from each of a few start poses; the result of least energy is kept. The loss is
    that of Geman and McClure (1987), its scale lowered in stages. Limits hold; joints not seen stay near neutral.

    Args:
        body: the generic body; its landmark names say which keypoints count.
        rig, keypoints: cameras, with their distortion, and keypoints in their own pixels.
        fit_lengths: whether stature, segment lengths and the breadth of pelvis and torso are fitted too.
        sigma_px: standard deviation of a wrist keypoint, pixels; by default 1.5 % of the person's height in the image.
        start: one more start pose.

    Raises InputError for arrays of the wrong shape, fewer than two views, or too few joints seen by two views.
    """
    fits = fit_keypoints_sequence(body, [rig], [keypoints], fit_lengths=fit_lengths, sigma_px=sigma_px, starts=[start])
    return fits[0]


def fit_keypoints_sequence(
    body: Body, rigs: Rig | Sequence[Rig], keypoints: Sequence[Keypoints], *, fit_lengths: bool = True,
    sigma_px: float | None = None, starts: Sequence[Pose | None] | None = None,
) -> tuple[FirstPose, ...]:  # fmt: skip
    """As `fit_keypoints`, for several instants that share their lengths (and `FirstPose.body`).

    `rigs` are one for all, or one for each instant: two trials may differ in cameras and grids. `starts` may give each
    instant one more start pose. Raises InputError as `fit_keypoints`, or if there is no instant, or not one rig for
    each.
    """
    rigs = [rigs] * len(keypoints) if isinstance(rigs, Rig) else list(rigs)
    if not keypoints or len(rigs) != len(keypoints):
        raise InputError(f"keypoints: {len(keypoints)} instants and {len(rigs)} rigs were given; each needs its rig.")
    frames = tuple(evidence(body, rig, k, sigma_px) for rig, k in zip(rigs, keypoints, strict=True))
    problem = KeypointProblem(Skeleton(body), frames, _REACH, fit_lengths)
    given = starts or [None] * len(frames)
    singles: list[Variables] = []
    for frame, extra in zip(frames, given, strict=True):
        alone = replace(problem, frames=(frame,), reach=2 * _REACH)
        singles.append(_first_fit(alone, extra, singles[-1] if singles else None))
    factors = np.median([x["shape"].values for x in singles], axis=0)
    x = problem.start([x["poses"].poses[0] for x in singles], factors)
    x = problem.minimised(replace(problem, reach=2 * _REACH).minimised(x).x).x
    poses = [pose.within(body.limits) for pose in x["poses"].poses]
    return _answers(problem, problem.start(poses, x["shape"].values), rigs, keypoints)


def _first_fit(problem: KeypointProblem, extra: Pose | None, before: Variables | None) -> Variables:
    """One instant alone: from the one before if that explains the keypoints, else from all starts."""
    if before is not None:
        carried = problem.minimised(problem.start(before["poses"].poses, before["shape"].values)).x
        if problem.energy(carried) < 1.5 * problem.frames[0].weights.sum():  # noise alone costs about 1 for each
            return carried
    return _best_start(problem, extra)


def _best_start(fine: KeypointProblem, extra: Pose | None) -> Variables:
    """The best of all starts: each first on the keypoints the views agree on, the best three then on all."""
    (frame,) = fine.frames
    points, inliers = triangulate(frame.rig, frame.pixels, frame.weights, frame.sigma)
    trusted = replace(frame, weights=np.where(inliers, 1.0, 0.1) * frame.weights)
    coarse = replace(fine, frames=(trusted,), limit=_LOOSE, reach=10 * _REACH)
    poses = [*_start_poses(fine.skeleton.body, frame, points), *([] if extra is None else [extra])]
    ends = [coarse.minimised(coarse.start([pose], np.zeros(fine.skeleton.size)), 15) for pose in poses]
    best = sorted(ends, key=lambda end: end.energy)[:3]
    return min((fine.minimised(end.x, 10) for end in best), key=lambda end: end.energy).x


def _start_poses(body: Body, frame: Evidence, seen: Float) -> list[Pose]:
    """Start poses with the root fitted to the triangulated trunk."""
    good = np.isfinite(seen).all(axis=1)
    if good.sum() < _FEWEST:
        mend = f"{_FEWEST} are needed, so check calibration, pixel grids and which person was chosen"
        raise InputError(f"keypoints: only {good.sum()} joints are seen by two views that agree; {mend}.")
    trunk = good & np.array([unsided(body.landmarks.names[m]) in _TRUNK for m in frame.marks])
    used = trunk if trunk.sum() >= 3 else good
    poses: list[Pose] = []
    for angles in STARTS_DEG:
        q = np.clip(np.deg2rad([angles.get(unsided(n), 0.0) for n in body.coordinate_names]), *body.limits.T)
        points = Posed(body, Pose(np.eye(4), q)).landmarks[frame.marks]
        poses.append(Pose(rigid_fit(points[used], seen[used], np.ones(used.sum())), q))
    return poses


def _answers(
    problem: KeypointProblem, x: Variables, rigs: Sequence[Rig], keypoints: Sequence[Keypoints]
) -> tuple[FirstPose, ...]:
    skeleton, poses = problem.skeleton, x["poses"].poses
    proportions = skeleton.proportions(x["shape"].values)
    body = rescaled(skeleton.body, proportions.lengths, proportions.girths, proportions.stature)
    pairs = zip(problem.frames, poses, strict=True)
    errors = [residuals(frame, Posed(body, pose).landmarks[frame.marks]) for frame, pose in pairs]
    covariance = _covariance(problem, x, errors)
    out: list[FirstPose] = []
    for f, (frame, pose) in enumerate(zip(problem.frames, poses, strict=True)):
        own = slice(f * body.dof, (f + 1) * body.dof)
        residual = np.full(keypoints[f].confidence.shape, np.nan)
        used = np.zeros(residual.shape, dtype=bool)
        distance = np.linalg.norm(errors[f], axis=-1) * frame.sigma
        residual[:, frame.columns] = np.where(frame.weights > 0, distance, np.nan)
        used[:, frame.columns] = (frame.weights > 0) & (_robust(errors[f], problem.reach) > _USED)
        marks = keypoints[f].names, rigs[f].names
        out.append(FirstPose(body, pose, proportions, residual, used, *marks, covariance[own, own]))
    return tuple(out)


def _robust(errors: Float, reach: float) -> Float:
    """Robust weights of errors (..., 2)."""
    return geman_mcclure(np.sum(errors * errors, axis=-1), reach)[1]


def _covariance(problem: KeypointProblem, x: Variables, errors: Sequence[Float]) -> Float:
    """Marginal covariances, the keypoints' standard deviations scaled to the residuals."""
    weights = [frame.weights * _robust(r, problem.reach) for frame, r in zip(problem.frames, errors, strict=True)]
    squares = sum(float(np.sum(w[..., None] * r * r)) for w, r in zip(weights, errors, strict=True))
    used = sum(2 * np.count_nonzero(w > _USED) for w in weights)
    free = max(used - x["poses"].dof, 1)
    scale = max(float(np.sqrt(squares / free)), 0.05)
    frames = tuple(replace(frame, sigma=scale * frame.sigma) for frame in problem.frames)
    scaled = replace(problem, frames=frames, reach=problem.reach / scale)  # the same robust weights as before
    return scaled.problem.covariance(x)


def pose_at(poses: Sequence[Pose], times: Sequence[float], time: float, sigmas: Sequence[Float] | None = None) -> Pose:
    """The pose at a time (s or frames, about those given) by a straight line through the steps from the first pose.

    `sigmas` (6 + J,) are the standard deviations of each pose. A coordinate that is off the line by more than they
    allow, as of a fast wrist, takes the line through the two nearest poses. The root's six are one. Raises InputError
    for fewer than two poses, or times of another number.
    """
    if len(poses) < 2 or len(times) != len(poses):
        given = f"{len(poses)} poses and {len(times)} times were given"
        raise InputError(f"pose_at: {given}; two or more of each are needed.")
    steps, at = np.array([pose.minus(poses[0]) for pose in poses]), np.asarray(times, float) - time
    slope, value = np.polyfit(at, steps, 1)
    if sigmas is not None:
        curved = np.any(np.abs(steps - value - at[:, None] * slope) > _CURVED * np.array(sigmas), axis=0)
        curved[:6] = curved[:6].any()
        nearest = np.argsort(np.abs(at), kind="stable")[:2]
        value = np.where(curved, np.polyfit(at[nearest], steps[nearest], 1)[1], value)
    return poses[0].retract(value)
