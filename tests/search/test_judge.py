"""The judge: only pixels that change hands are asked, and the images prefer the true pose."""

from __future__ import annotations

import numpy as np
import pytest

from support.labels import labels, scene_and_views
from twistcap.body import Pose, Posed
from twistcap.cues.appearance import Appearance, AppearanceRule
from twistcap.region.compare import _FALLBACK, BLOCK, background_moments, label_evidence
from twistcap.render import render
from twistcap.search.judge import JudgeRule, judge_of


def test_background_is_gathered_where_it_surely_is() -> None:
    features, part, other = labels(5)
    off = (part < 0) & (other < 0)
    everywhere = np.ones_like(off)
    out = background_moments(features, off, everywhere, 1)
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
    np.testing.assert_array_equal(background_moments(spoilt, off, everywhere, 1), out)


def test_evidence_is_the_clipped_log_ratio_of_the_pixels_that_change_hands() -> None:
    features, part, other = labels(6)
    rng = np.random.default_rng(7)
    mean, sd = rng.uniform(size=(2, 3)), rng.uniform(0.1, 0.3, size=(2, 3))
    colours = np.concatenate([np.ones((2, 1)), mean, mean**2 + sd**2], axis=1)
    background = background_moments(features, (part < 0) & (other < 0), part != other, 1)
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


def test_the_images_prefer_the_true_pose() -> None:
    scene, truth, views = scene_and_views()
    S = len(scene.body.segment_names)
    appearance = Appearance.blank(2, scene.body.segment_names, AppearanceRule())
    for i, view in views.items():
        appearance = appearance.learnt(i, view, render(truth, view.camera), np.ones(S), 1)
    colours = [appearance.of(i, 3) for i in views]
    q = truth.pose.q.copy()
    q[scene.body.coordinate("arm_flex_r")] += np.deg2rad(40)
    astray = Pose(truth.pose.root, q)
    rule, seen = JudgeRule(), list(views.values())
    assert judge_of(rule, seen, colours, Posed(scene.body, astray)).evidence(truth.pose) > 30.0
    assert judge_of(rule, seen, colours, truth).evidence(astray) < -30.0
