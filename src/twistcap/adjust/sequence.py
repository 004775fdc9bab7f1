"""What problems of a whole sequence share: what is known of the motion without images, and how contours err."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.predict import MotionNoise
from twistcap.predict.history import covariance_about
from twistcap.predict.inertia import INFLATION
from twistcap.priors.standing import RestPose
from twistcap.solve import Arrow
from twistcap.solve.blocks import PoseTrack
from twistcap.terms import LimitTerm, PointTerm, RestTerm


@dataclass(frozen=True)
class SmoothMotion:
    """Limits and a weak rest pose of each pose of a body, and small accelerations."""

    body: Body

    def energies(self, track: PoseTrack) -> dict[str, float]:
        """By term."""
        posed = [Posed(self.body, pose) for pose in track.poses]
        standing = {prior.name: sum(prior.energy(p) for p in posed) for prior in pose_priors()}
        return {**standing, "motion": accelerations(track.poses, track.times.tolist())}

    def add_to(self, arrow: Arrow, track: PoseTrack) -> None:
        """Add the quadratics of the poses' steps."""
        for t, pose in enumerate(track.poses):
            for prior in pose_priors():
                quadratic = prior.linearize(Posed(self.body, pose))
                arrow.value += quadratic.value
                arrow.add_pose(t, quadratic.gradient, quadratic.hessian)
        arrow.value += accelerations(track.poses, track.times.tolist(), system=arrow)


def pose_priors() -> tuple[LimitTerm, RestTerm]:
    """Of each pose: limits, and a weak rest pose."""
    return LimitTerm(), RestTerm(float(np.deg2rad(RestPose().sigma_deg)))


def accelerations(
    poses: Sequence[Pose], times: Sequence[float], noise: MotionNoise | None = None, system: Arrow | None = None
) -> float:
    """Energy of the change of velocity, ``log(M' M⁻¹) / Δt`` and ``Δq / Δt``, at every inner frame.

    Over the mean Δt it is an acceleration of the standard deviations of `noise`, the root's about the body. Its rows
    are added to a system if one is given.
    """
    energy, noise = 0.0, noise or MotionNoise()
    for t in range(1, len(poses) - 1):
        dt = times[t] - times[t - 1], times[t + 1] - times[t]
        first, second = poses[t].minus(poses[t - 1]), poses[t + 1].minus(poses[t])
        variance = (0.5 * (dt[0] + dt[1])) ** 2 * noise.variance(len(first), 1.0, "constant_velocity")
        _, information = covariance_about(variance, poses[t].root[:3, 3])
        root = np.linalg.cholesky(information).T  # rows that the unit weight fits
        white = root @ (second / dt[1] - first / dt[0])
        energy += 0.5 * float(white @ white)
        if system is not None:
            (from_a, to_b), (from_b, to_c) = _derivatives(first), _derivatives(second)
            J = (-from_a / dt[0], from_b / dt[1] - to_b / dt[0], to_c / dt[1])
            system.add_rows((t - 1, t, t + 1), tuple(root @ j for j in J), None, np.ones(len(white)), white)
    return energy


def _derivatives(step: Float) -> tuple[Float, Float]:
    """(D, D) derivatives of the step between two poses by the steps of the one it starts from and of the other.
    ``log(exp(δ') D exp(−δ))``: by δ' the inverse left Jacobian at the step, by δ minus the inverse right one."""
    start, end = -np.eye(len(step)), np.eye(len(step))
    end[:6, :6] = se3.inverse_left_jacobian_one(step[:6])
    start[:6, :6] = -se3.inverse_left_jacobian_one(-step[:6])
    return start, end


def design_effect(sights: Iterable[tuple[PointTerm, Posed]], alike: bool = False) -> float:
    """Factor by which the contours' information is overcounted, 1 or more: points of one part err together.

    See `twistcap.adjust.refine.measure.design_effect`; each image is by itself here. With `alike`, a part may also err
    in all images alike, as a body that does not fit does.
    """
    apart, information, sums = 0.0, 0.0, np.zeros(0)
    for term, posed in sights:
        _, points, rows = term.rows(posed)
        group = np.resize(points.part, len(rows.residual)) * 8 + (rows.gradient > 0.0) @ [1, 2, 4]
        own = np.bincount(group, rows.weight * rows.residual, minlength=len(sums))
        apart += float(np.sum(own**2))
        sums = own + np.pad(sums, (0, len(own) - len(sums)))
        information += float(rows.weight.sum())
    squares = max(apart, float(np.sum(sums**2))) if alike else apart
    return max(1.0, squares / max(information, 1e-12) / INFLATION**2)


def claimed_sigma(arrow: Arrow, effect: float) -> Float:
    """(K,) standard deviations of the shared parameters, inflated as those of poses are."""
    return INFLATION * np.sqrt(effect * np.diagonal(arrow.marginals().shared))
