"""Rival poses: the doubt that proposes them, and the images that judge them."""

from __future__ import annotations

import numpy as np
import pytest

from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.cues.appearance import Appearance, AppearanceRule, part_colours
from twistcap.cues.rivals import RivalRule, Rivals, doubted_limbs, segment_doubts
from twistcap.cues.view import View, crop_view
from twistcap.region.compare import _FALLBACK, BLOCK, background_moments, label_evidence
from twistcap.render import render
from twistcap.studio import Capture, StudioConfig, capture

BODY = humanoid("full")


def random_covariance(seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(BODY.dof, BODY.dof)) * 0.02
    return A @ A.T


def bent(seed: int) -> Posed:
    q = np.random.default_rng(seed).uniform(-0.4, 0.4, len(BODY.coordinate_names))
    return Posed(BODY, Pose(np.eye(4), q))


def test_a_segments_doubt_is_the_spread_of_its_middle() -> None:
    posed, covariance = bent(1), random_covariance(2)
    sd, directions = segment_doubts(posed, covariance)
    small = 1e-3
    steps = np.random.default_rng(3).multivariate_normal(np.zeros(BODY.dof), small**2 * covariance, size=2000)
    middles = np.array([Posed(BODY, posed.pose.retract(step)).segment_middles for step in steps])
    for s in range(len(BODY.segment_names)):
        widest = np.linalg.eigvalsh(np.cov(middles[:, s].T))[-1]
        assert np.sqrt(widest) == pytest.approx(small * sd[s], rel=0.1)
        moved = Posed(BODY, posed.pose.retract(1e-6 * directions[s])).segment_middles[s] - posed.segment_middles[s]
        assert np.linalg.norm(moved) == pytest.approx(1e-6 * sd[s], rel=1e-3)


def test_limbs_in_doubt_are_named_once() -> None:
    doubt = np.full(len(BODY.segment_names), 0.001)
    for name, value in (("radius_r", 0.08), ("ulna_r", 0.05), ("humerus_r", 0.04), ("radius_l", 0.06)):
        doubt[BODY.segment(name)] = value
    names = [BODY.segment_names[s] for s in doubted_limbs(BODY, doubt, 0.03)]
    assert names == ["radius_r", "radius_l"]


def test_doubt_outlives_a_sudden_certainty() -> None:
    rivals, posed = Rivals(BODY, RivalRule(every=1, memory=0.9)), bent(4)
    unsure, sure = np.eye(BODY.dof) * 0.2**2, np.eye(BODY.dof) * 1e-4**2
    assert rivals.poses(posed, unsure)
    later = rivals.poses(posed, sure)
    assert later and not Rivals(BODY, RivalRule(every=1)).poses(posed, sure)
    reach = np.linalg.norm(Posed(BODY, later[0]).segment_middles - posed.segment_middles, axis=1).max()
    assert reach > 0.03  # as far as the doubt that is remembered, not as what is claimed now


def test_a_rival_takes_over_when_two_frames_in_turn_prefer_it() -> None:
    rule = RivalRule(every=100)
    covariance, posed = np.eye(BODY.dof) * 0.2**2, bent(4)
    later, other = bent(5), Pose(np.eye(4), bent(4).pose.q + 0.1)
    rivals = Rivals(BODY, rule)
    assert not rivals.takes_over(posed, other, rule.margin)
    assert not rivals.poses(later, covariance)  # no clear preference, so nothing is asked again
    assert not rivals.takes_over(posed, other, rule.margin + 1.0)
    (again,) = rivals.poses(later, covariance)  # out of turn, and as far off the later pose as it was off the first
    np.testing.assert_allclose(again.q - later.pose.q, 0.1, atol=1e-12)
    assert rivals.takes_over(later, again, rule.margin + 1.0)
    assert not rivals.poses(later, covariance)


def test_a_second_frame_may_refuse_a_rival() -> None:
    rule = RivalRule(every=100)
    covariance, posed = np.eye(BODY.dof) * 0.2**2, bent(4)
    rivals = Rivals(BODY, rule)
    assert not rivals.takes_over(posed, bent(6).pose, rule.margin + 1.0)
    (again,) = rivals.poses(posed, covariance)
    assert not rivals.takes_over(posed, again, 0.0)
    assert not rivals.poses(posed, covariance)
    assert not rivals.takes_over(posed, again, rule.margin + 1.0)  # it must win twice anew


def labels(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    part = np.full((22, 30), -1, dtype=np.int32)
    part[4:15, 5:12], part[8:20, 10:16] = 0, 1
    other = np.roll(part, (1, 4), axis=(0, 1))
    return rng.uniform(size=(22, 30, 3)).astype(np.float32), part, other


def test_background_is_gathered_where_it_surely_is() -> None:
    features, part, other = labels(5)
    off = (part < 0) & (other < 0)
    out = background_moments(features, off, 1)
    whole = features[off].astype(float)
    fallback = _FALLBACK * (3 * BLOCK) ** 2
    for r, c in ((0, 0), (2, 3), (4, 2), (5, 7)):
        rows, columns = slice(max(r - 1, 0) * BLOCK, (r + 2) * BLOCK), slice(max(c - 1, 0) * BLOCK, (c + 2) * BLOCK)
        here = features[rows, columns][off[rows, columns]].astype(float)
        for k, power in ((slice(0, 3), 1), (slice(3, 6), 2)):
            total = (here**power).sum(axis=0) + fallback * (whole**power).mean(axis=0)
            np.testing.assert_allclose(out[r, c, k], total / (len(here) + fallback), rtol=1e-6)
    spoilt = features.copy()
    spoilt[~off] = 1e3
    np.testing.assert_array_equal(background_moments(spoilt, off, 1), out)


def test_evidence_is_the_clipped_log_ratio_of_the_pixels_that_change_hands() -> None:
    features, part, other = labels(6)
    rng = np.random.default_rng(7)
    mean, sd = rng.uniform(size=(2, 3)), rng.uniform(0.1, 0.3, size=(2, 3))
    colours = np.concatenate([np.ones((2, 1)), mean, mean**2 + sd**2], axis=1)
    background = background_moments(features, (part < 0) & (other < 0), 1)
    floor, clip = 1e-3, 2.0

    def log_density(label: int, r: int, c: int) -> float:
        moments = background[r // BLOCK, c // BLOCK] if label < 0 else colours[label, 1:]
        variance = moments[3:] - moments[:3] ** 2 + floor
        return float(-0.5 * np.sum((features[r, c] - moments[:3]) ** 2 / variance + np.log(variance)))

    places = np.argwhere(part != other)
    expected = sum(
        np.clip(log_density(other[r, c], r, c) - log_density(part[r, c], r, c), -clip, clip) for r, c in places
    )
    assert label_evidence(features, background, colours, part, other, floor, clip) == pytest.approx(expected, rel=1e-4)
    unknown = colours.copy()
    unknown[:, 0] = 0.0
    assert label_evidence(features, background, unknown, part, other, floor, clip) == 0.0


def scene_and_views() -> tuple[Capture, Posed, dict[int, View]]:
    scene = capture(StudioConfig(seed=1, views=2, frames=1))
    truth = Posed(scene.true_body, scene.true_poses[0])
    frame = next(iter(scene.frames()))
    views = {}
    for i, image in enumerate(frame.images):
        assert image is not None
        view = crop_view(image, scene.rig[i], truth, 0.2, "lab")
        assert view is not None
        views[i] = view
    return scene, truth, views


def test_the_images_prefer_the_true_pose() -> None:
    scene, truth, views = scene_and_views()
    appearance = Appearance(2, len(scene.body.segment_names), AppearanceRule())
    for i, view in views.items():
        appearance.learn(i, view, render(truth, view.camera), np.ones(len(scene.body.segment_names)), 1)
    colours = [appearance.of(i, 3) for i in views]
    q = truth.pose.q.copy()
    q[scene.body.coordinate("arm_flex_r")] += np.deg2rad(40)
    astray = Pose(truth.pose.root, q)
    rivals = Rivals(scene.body, RivalRule())
    assert rivals.judge(list(views.values()), colours, Posed(scene.body, astray)).evidence(truth.pose) > 30.0
    assert rivals.judge(list(views.values()), colours, truth).evidence(astray) < -30.0


def test_colours_are_those_of_the_parts_inner_pixels() -> None:
    features, part, _ = labels(8)
    sums = part_colours(features, part, np.array([True, False]))
    inner = np.zeros_like(part, dtype=bool)
    inner[1:-1, 1:-1] = True
    for shift in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        inner &= np.roll(part, shift, axis=(0, 1)) == part
    mine = features[inner & (part == 0)]
    assert sums[0, 0] == len(mine) and np.all(sums[1] == 0.0)
    np.testing.assert_allclose(sums[0, 1:4], mine.sum(axis=0), rtol=1e-5)
    np.testing.assert_allclose(sums[0, 4:], (mine.astype(float) ** 2).sum(axis=0), rtol=1e-5)


def test_colours_from_another_camera_are_trusted_less_and_less_sure() -> None:
    scene, truth, views = scene_and_views()
    S = len(scene.body.segment_names)
    appearance = Appearance(2, S, AppearanceRule())
    assert np.all(appearance.of(0, 3)[:, 0] == 0.0)
    appearance.learn(0, views[0], render(truth, views[0].camera), np.ones(S), 1)
    own, borrowed = appearance.of(0, 3), appearance.of(1, 3)
    seen = own[:, 0] > 0
    assert np.all(borrowed[seen, 0] < own[seen, 0])
    np.testing.assert_allclose(borrowed[seen, 1:4], own[seen, 1:4])

    def variance(of: np.ndarray) -> np.ndarray:
        return of[seen, 4:] - of[seen, 1:4] ** 2

    wider = variance(borrowed) - variance(own)
    np.testing.assert_allclose(wider, (AppearanceRule().shading * own[seen, 1:4]) ** 2, rtol=1e-6, atol=1e-9)
    appearance.learn(0, views[0], render(truth, views[0].camera), np.zeros(S), 1)  # nothing agreed: nothing is learnt
    np.testing.assert_array_equal(appearance.of(0, 3), own)
