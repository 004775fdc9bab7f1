"""Parts that no view shows: which count as gone, and which joints that leaves known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from support.finite_differences import check_jacobian
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.cues.evidence import ContourEvidence
from twistcap.cues.hidden import HiddenRule, above
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.priors import ParzenPrior, PriorRule, matched
from twistcap.studio import StudioConfig, capture
from twistcap.track import TrackerConfig, track

BODY = humanoid()
PARTS = len(BODY.segment_names)
NONE = np.zeros(PARTS, dtype=np.bool_)
RULE = HiddenRule()
LEG = ("femur_r", "tibia_r", "foot_r")
SMALL = StudioConfig(seed=3, views=2, size=(192, 140), frames=4)


def evidence(**share: float) -> list[ContourEvidence]:
    """Twenty contour points on every part; all tell inside from outside but where a share of them is given."""
    shares = [share.get(name, share.get("others", 1.0)) for name in BODY.segment_names]
    contrast = np.concatenate([np.where(np.arange(20) < round(20 * s), 9.0, 0.0) for s in shares])
    contour: Any = SimpleNamespace(part=np.repeat(np.arange(PARTS), 20), outer=np.ones(20 * PARTS, dtype=np.bool_))
    return [ContourEvidence(None, contour, np.zeros(20 * PARTS), contrast)]  # type: ignore[arg-type]


def gone(**share: float) -> list[str]:
    return names(RULE.now_gone(NONE, evidence(**share), BODY))


def names(flags: np.ndarray) -> list[str]:
    return [name for name, flag in zip(BODY.segment_names, flags, strict=True) if flag]


def test_a_segment_hangs_from_its_limb_but_not_from_the_root() -> None:
    hangs = above(BODY)
    assert set(names(hangs[BODY.segment("foot_r")])) == {"femur_r", "tibia_r", "foot_r"}
    assert names(hangs[BODY.segment("femur_l")]) == ["femur_l"]
    assert not hangs[BODY.segment("pelvis")].any()


def test_what_no_view_shows_is_gone_until_its_whole_limb_is_seen_again() -> None:
    assert gone(tibia_r=0.3) == [] and gone(tibia_r=0.1) == ["tibia_r"]
    hidden = RULE.now_gone(NONE, evidence(femur_r=0.0, tibia_r=0.1, foot_r=0.2), BODY)
    assert names(hidden) == list(LEG)
    # The other leg's outline, taken for the hidden foot's own, does not count while the rest of the leg is absent.
    for still in (evidence(femur_r=0.0, tibia_r=0.1, foot_r=0.6), evidence(femur_r=0.6, tibia_r=0.05, foot_r=0.0)):
        assert names(RULE.now_gone(hidden, still, BODY)) == list(LEG)
    assert names(RULE.now_gone(hidden, evidence(femur_r=0.6, tibia_r=0.2, foot_r=0.2), BODY)) == []


def test_in_noise_nothing_counts_as_gone() -> None:
    assert gone(others=0.7, tibia_r=0.1) == []
    assert names(RULE.now_gone(~NONE, evidence(), BODY)) == []


def test_a_part_that_is_gone_is_not_to_be_trusted() -> None:
    hidden = NONE.copy()
    hidden[BODY.segment("foot_r")] = True
    trust = RULE.trust(evidence(femur_l=0.75), hidden)
    assert trust[BODY.segment("foot_r")] == 0.0 and trust[BODY.segment("femur_l")] == pytest.approx(0.5)
    assert RULE.concealed(evidence(), hidden) == 1.0 and RULE.concealed(evidence(), NONE) == 0.0


def test_joints_below_a_hidden_segment_are_not_known() -> None:
    known = RULE.known(evidence(humerus_r=0.0), NONE, BODY)
    unknown = {name for name, share in zip(BODY.coordinate_names, known, strict=True) if share < 1.0}
    assert {"arm_flex_r", "elbow_flex_r", "pro_sup_r"} <= unknown
    assert all(name.startswith(("arm", "elbow", "pro_sup", "wrist")) and name.endswith("_r") for name in unknown)


def test_the_prior_knows_a_hidden_joint_by_the_others() -> None:
    """Two samples agree with what is seen; the hidden knee, off as it is, has no say in which."""
    samples = np.array([[0.0, 0.2], [0.0, 0.4], [2.0, 1.5]])
    prior = ParzenPrior(("hip_flexion_r", "knee_angle_r"), samples, 0.2)
    q = np.zeros(len(BODY.coordinate_names))
    q[BODY.coordinate("knee_angle_r")] = 1.5
    posed, term = Posed(BODY, Pose(np.eye(4), q)), replace(matched(prior, BODY), weight=3.0)
    known = np.ones(len(q))
    assert term.told_by(known, PriorRule(), posed) is term
    known[BODY.coordinate("knee_angle_r")] = 0.0
    told = term.told_by(known, PriorRule(unseen=0.0), posed)
    assert told.target is not None
    np.testing.assert_allclose(told.target, [0.0, 0.3], atol=1e-9)
    check_jacobian(
        lambda d: np.array(told.energy(Posed(BODY, posed.pose.retract(d)))),
        told.linearize(posed).gradient,
        np.zeros(BODY.dof),
    )
    np.testing.assert_array_equal(told.hessian(BODY.dof), term.hessian(BODY.dof))


def test_despeckled_images_are_tracked_as_if_they_had_been_filtered_before() -> None:
    scene = capture(replace(SMALL, uniform_noise=0.1))
    frames = list(scene.frames())
    filtered = [
        Frame(f.index, f.time, tuple(None if i is None else cv2.medianBlur(i, 3) for i in f.images)) for f in frames
    ]
    own = list(track(frames, scene.body, scene.rig, scene.first_pose, TrackerConfig(despeckle=3)))
    given = list(track(filtered, scene.body, scene.rig, scene.first_pose))
    plain = list(track(frames, scene.body, scene.rig, scene.first_pose))
    np.testing.assert_array_equal(own[-1].pose.q, given[-1].pose.q)
    assert np.abs(own[-1].pose.q - plain[-1].pose.q).max() > 1e-6
    with pytest.raises(InputError, match="despeckle is 2"):
        TrackerConfig(despeckle=2)
