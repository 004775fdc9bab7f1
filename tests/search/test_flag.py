"""The probability of loss: its shape, its bounds, and that signs of loss raise it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, Rig
from twistcap.cues.observation import Agreement
from twistcap.search.flag import (
    SIGNS,
    FlagRule,
    flag_groups,
    image_signs,
    judged,
    log_odds,
    outer_segments,
    ramps,
    segment_deviations,
    support_signs,
)
from twistcap.search.limb import LimbRule
from twistcap.search.recollection import Check, Recollection


def test_groups_part_the_segments() -> None:
    body = humanoid()
    groups = flag_groups(body)
    np.testing.assert_array_equal(groups.sum(axis=0), np.ones(len(body.segment_names)))


def test_a_quiet_body_is_not_lost_and_a_contradicted_one_is() -> None:
    rule, groups = FlagRule(), flag_groups(humanoid())
    good = np.full(len(groups), 0.01)
    signs = support_signs(groups, np.ones(groups.shape[1]))
    quiet = rule.limbs(signs, signs, good)
    assert rule.whole(quiet) < 0.02
    signs = signs.copy()
    signs[1] = [1.0, 1.0, 0.5, 0.5, 0.9, 0.4, 0.2, 0.0, 0.0, 0.3, 0.0]
    lost = rule.limbs(signs, signs, np.where(np.arange(len(groups)) == 1, 0.2, good))
    assert lost.argmax() == 1
    assert lost[1] > 0.5
    assert rule.whole(lost) > 0.5


def test_a_second_track_is_doubted_more() -> None:
    rule, groups = FlagRule(), flag_groups(humanoid())
    signs = support_signs(groups, np.full(groups.shape[1], 0.5))
    once, again = (r.limbs(signs, signs, np.full(len(groups), 0.1)) for r in (rule, rule.in_hindsight))
    np.testing.assert_allclose(log_odds(again) - log_odds(once), rule.again)
    assert rule.again > 0.0


def test_what_is_not_seen_is_the_less_sure_the_longer_and_the_wider() -> None:
    blind = [FlagRule().blind(s, 0.05, False) for s in (0.0, 0.02, 0.1, 0.5, 5.0)]
    assert np.all(np.diff(blind) >= 0.0)
    assert FlagRule().blind(0.02, 0.02, False) < 0.5 < FlagRule().blind(5.0, 1.0, False)
    assert FlagRule().blind(0.02, 0.02, True) == FlagRule().gone > 0.5


def test_a_limb_with_a_segment_in_no_image_is_not_judged() -> None:
    """One that has no contour, as a forearm before the trunk, is judged where it is lost."""
    groups = flag_groups(humanoid())
    none, shown = np.zeros(len(groups), np.bool_), np.ones(groups.shape[1], np.bool_)
    points = np.full(groups.shape[1], 20, np.int32)
    everything = Agreement(points, points.astype(float), points.astype(float))
    assert judged(groups, humanoid(), everything, shown, none).all()
    last = groups[2] & (np.cumsum(groups[2]) == groups[2].sum())
    points = np.where(last, 0, 20).astype(np.int32)
    hidden = Agreement(points, points.astype(float), points.astype(float))
    for lost, seen in ((none, ~last), (~none, ~last), (none, shown)):
        np.testing.assert_array_equal(judged(groups, humanoid(), hidden, seen, lost), np.arange(len(groups)) != 2)
    assert judged(groups, humanoid(), hidden, shown, ~none).all()
    nothing = Agreement(0 * points, 0.0 * points, 0.0 * points)
    assert judged(groups, humanoid(), nothing, shown, none).all()  # it cannot be all


def test_a_limb_that_looks_like_what_is_behind_it_is_not_judged_unless_it_is_lost() -> None:
    groups = flag_groups(humanoid())
    lost, shown = np.zeros(len(groups), np.bool_), np.ones(groups.shape[1], np.bool_)
    points = np.full(groups.shape[1], 20, np.int32)
    telling = np.full(groups.shape[1], 9.0)
    telling[groups[2]] = 7.0
    alike = Agreement(points, telling, telling)
    np.testing.assert_array_equal(judged(groups, humanoid(), alike, shown, lost), np.arange(len(groups)) != 2)
    lost[2] = True
    assert judged(groups, humanoid(), alike, shown, lost).all()


def test_a_thigh_that_tells_says_nothing_of_the_shin() -> None:
    """As a shin just below a picture does, of which a few points are in it."""
    body = humanoid()
    groups, none = flag_groups(body), np.zeros(len(flag_groups(body)), np.bool_)
    shin = np.flatnonzero(outer_segments(groups, body)[2])
    assert len(shin) == 2
    points, shown = np.full(groups.shape[1], 20, np.int32), np.ones(groups.shape[1], np.bool_)
    points[shin] = 5
    telling = points.astype(float)
    assert judged(groups, body, Agreement(points, telling, telling), shown, none).all()
    telling[shin] = 1.0
    silent = Agreement(points, telling, telling)
    np.testing.assert_array_equal(judged(groups, body, silent, shown, none), np.arange(len(groups)) != 2)


def test_the_outer_half_of_an_arm_is_the_forearm_also_with_a_clavicle() -> None:
    for body in (humanoid(), humanoid(clavicles=True)):
        outer = outer_segments(flag_groups(body), body)
        names = {tuple(n for n, own in zip(body.segment_names, half, strict=True) if own) for half in outer}
        assert {("ulna_r", "radius_r"), ("tibia_l", "foot_l"), ("head",), ("torso",)} <= names


def test_the_deviation_of_a_segment_is_the_spread_of_its_middle() -> None:
    body = humanoid("full")
    A = 0.02 * np.random.default_rng(2).normal(size=(body.dof, body.dof))
    q = np.random.default_rng(1).uniform(-0.4, 0.4, len(body.coordinate_names))
    posed, covariance = Posed(body, Pose(np.eye(4), q)), A @ A.T
    small = 1e-3
    steps = np.random.default_rng(3).multivariate_normal(np.zeros(body.dof), small**2 * covariance, size=2000)
    middles = np.array([Posed(body, posed.pose.retract(step)).segment_middles for step in steps])
    widest = [np.sqrt(np.linalg.eigvalsh(np.cov(middles[:, s].T))[-1]) for s in range(len(body.segment_names))]
    np.testing.assert_allclose(widest, small * segment_deviations(posed, covariance), rtol=0.1)


def test_no_sign_lowers_the_probability() -> None:
    rng, rule = np.random.default_rng(0), FlagRule()
    signs, lately, spread = rng.random((2, 6, SIGNS))[0], rng.random((6, SIGNS)), np.full(6, 0.05)
    before = rule.limbs(signs, lately, spread)
    for k in range(SIGNS):
        more = signs.copy()
        more[:, k] += 0.3
        assert np.all(rule.limbs(more, lately, spread) >= before - 1e-12)
    assert np.all(rule.limbs(signs, lately, 3.0 * spread) >= before)


def test_there_is_a_weight_for_each_ramp() -> None:
    signs = np.zeros((6, SIGNS))
    assert ramps(signs, signs, np.full(6, 0.05)).shape == (6, len(FlagRule().limb) - 1)
    wild = np.full((2, SIGNS), 9.0)
    found = ramps(wild, wild, np.array([0.0, np.inf]))
    assert np.all((found >= 0.0) & (found <= 1.0))


def test_a_limb_of_which_nothing_has_been_learnt_is_not_unseen() -> None:
    groups = flag_groups(humanoid())
    S = groups.shape[1]
    rig = Rig((Camera("a", np.diag([100.0, 100.0, 1.0]), np.eye(4), (8, 8)),))
    known = Recollection.blank(humanoid(), rig)
    points = np.full(S, 20, np.int32)
    agreement = Agreement(points, points.astype(float), points.astype(float))
    nothing, some = np.zeros((1, S)), np.full((1, S), 50.0)
    first = Check(nothing, nothing, 1000.0 + nothing, np.ones(1))
    usual = np.zeros((len(groups), 3))
    assert not image_signs(groups, known, first, agreement, np.ones(S), usual).any()
    taught = replace(known, nats=some, pixels=some, fitting=np.ones(1))
    signs = image_signs(groups, taught, first, agreement, np.ones(S), usual)
    assert np.all(signs[:, 6] == 1.0)  # covers nothing of what it used to
    assert np.all(signs[:, 2] > 1.0)  # and much that looks like it is bare
    assert LimbRule().hidden(signs) == list(range(len(groups) - 1))
    assert LimbRule().hidden(0.4 * signs) == []


def test_all_limbs_are_looked_at_where_the_bodys_colours_lie_bare() -> None:
    groups, rule = flag_groups(humanoid()), LimbRule()
    usual, limbs = np.full((2, groups.shape[1]), 50.0), len(groups) - 1
    rig = Rig(tuple(Camera(name, np.diag([100.0, 100.0, 1.0]), np.eye(4), (8, 8)) for name in "ab"))
    known = replace(Recollection.blank(humanoid(), rig), nats=usual, pixels=usual, uncovered=0.2 * usual)
    quiet = Check(usual, usual, known.uncovered, np.ones(2))
    assert not any(rule.due(known, quiet, groups, frame) for frame in range(rule.every * limbs))
    bare = replace(quiet, uncovered=quiet.uncovered + np.where(np.arange(groups.shape[1]) == 3, [[0.0], [60.0]], 0.0))
    looks = [rule.due(known, bare, groups, frame) for frame in range(2 * rule.every)]
    assert [look for look in looks if look] == 2 * [list(range(limbs))]


def test_a_body_of_which_hardly_anything_is_in_sight_is_gone() -> None:
    rule, signs = FlagRule(), np.zeros((6, SIGNS))
    limbs = rule.limbs(signs, signs, np.full(6, 0.01))
    signs[:, 6] = 0.85
    assert rule.whole(limbs, signs) == rule.whole(limbs) < 0.5
    signs[:, 6] = 0.95
    assert rule.whole(limbs, signs) == rule.gone > 0.5
