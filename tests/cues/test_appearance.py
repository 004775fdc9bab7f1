"""Colours of the parts: learnt from what agrees, lent to other cameras."""

from __future__ import annotations

import numpy as np

from support.labels import labels, scene_and_views
from twistcap.cues.appearance import Appearance, AppearanceRule, part_colours
from twistcap.render import render


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
    blank = Appearance.blank(2, [f"part {s}" for s in range(S)], AppearanceRule())
    assert np.all(blank.of(0, 3)[:, 0] == 0.0)
    appearance = blank.learnt(0, views[0], render(truth, views[0].camera), np.ones(S), 1)
    own, borrowed = appearance.of(0, 3), appearance.of(1, 3)
    seen = own[:, 0] > 0
    assert np.all(borrowed[seen, 0] < own[seen, 0])
    np.testing.assert_allclose(borrowed[seen, 1:4], own[seen, 1:4])

    def variance(of: np.ndarray) -> np.ndarray:
        return of[seen, 4:] - of[seen, 1:4] ** 2

    wider = variance(borrowed) - variance(own)
    np.testing.assert_allclose(wider, (AppearanceRule().shading * own[seen, 1:4]) ** 2, rtol=1e-6, atol=1e-9)
    unchanged = appearance.learnt(0, views[0], render(truth, views[0].camera), np.zeros(S), 1)
    np.testing.assert_array_equal(unchanged.of(0, 3), own)  # nothing agreed, so nothing is learnt


def test_while_a_part_is_unknown_it_is_expected_to_look_as_on_the_other_side() -> None:
    scene, truth, views = scene_and_views()
    names = scene.body.segment_names
    left, right = names.index("tibia_l"), names.index("tibia_r")
    agreeing = np.where(np.arange(len(names)) == right, 0.0, 1.0)  # the right one has slipped
    blank = Appearance.blank(2, names, AppearanceRule())
    known = blank.learnt(0, views[0], render(truth, views[0].camera), agreeing, 1)
    sure, expected = known.of(0, 3)[[left, right]]
    np.testing.assert_allclose(expected[1:], sure[1:])
    assert 0.0 < expected[0] < sure[0]
    both = known.learnt(0, views[0], render(truth, views[0].camera), np.ones(len(names)), 1)
    for _ in range(30):
        both = both.learnt(0, views[0], render(truth, views[0].camera), np.ones(len(names)), 1)
    alone = Appearance(both.rule, both.sums, np.arange(len(names), dtype=np.int32))
    np.testing.assert_allclose(both.of(0, 3)[right], alone.of(0, 3)[right], atol=0.05)
