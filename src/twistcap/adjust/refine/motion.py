"""Smooth motion over a sequence: Gaussian accelerations between neighbouring frames, two-sided in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.predict import MotionNoise, covariance_about
from twistcap.solve import Arrow


def accelerations(
    poses: Sequence[Pose], times: Sequence[float], noise: MotionNoise, system: Arrow | None = None
) -> float:
    """Energy of the change of velocity at every inner frame; its rows are added to a system if one is given.

    Velocity from one frame to the next is ``log(M' M⁻¹) / Δt`` and ``Δq / Δt``; its change over the mean Δt is an
    acceleration of the standard deviations of `noise`, the root's about the body.
    """
    energy = 0.0
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

    ``log(exp(δ') D exp(−δ))``: by δ' the inverse left Jacobian at the step, by δ minus the inverse right one.
    """
    D = len(step)
    start, end = -np.eye(D), np.eye(D)
    end[:6, :6] = se3.inverse_left_jacobian_one(step[:6])
    start[:6, :6] = -se3.inverse_left_jacobian_one(-step[:6])
    return start, end
