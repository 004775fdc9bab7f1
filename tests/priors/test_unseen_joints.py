"""The pose prior where a joint is not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from support.finite_differences import check_jacobian
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.priors import ParzenPrior, PriorRule, matched

BODY = humanoid()


def test_the_prior_knows_a_hidden_joint_by_the_others() -> None:
    """Two samples agree with what is seen; the hidden knee, off as it is, has no say in which."""
    samples = np.array([[0.0, 0.2], [0.0, 0.4], [2.0, 1.5]])
    prior = ParzenPrior(("hip_flexion_r", "knee_angle_r"), samples, 0.2)
    q = np.zeros(len(BODY.coordinate_names))
    q[BODY.coordinate("knee_angle_r")] = 1.5
    posed, term = Posed(BODY, Pose(np.eye(4), q)), replace(matched(prior, BODY), weight=3.0)
    known = np.ones(len(q))
    assert term.given_joints(known, PriorRule(), posed) is term
    known[BODY.coordinate("knee_angle_r")] = 0.0
    chosen = term.given_joints(known, PriorRule(unseen=0.0), posed)
    assert chosen.target is not None
    np.testing.assert_allclose(chosen.target, [0.0, 0.3], atol=1e-9)
    check_jacobian(
        lambda d: np.array(chosen.energy(Posed(BODY, posed.pose.retract(d)))),
        chosen.linearize(posed).gradient,
        np.zeros(BODY.dof),
    )
    np.testing.assert_array_equal(chosen.linearize(posed).hessian, term.linearize(posed).hessian)
