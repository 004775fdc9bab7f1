"""The probability of loss: its shape, its bounds, and that signs of loss raise it."""

from __future__ import annotations

import numpy as np

from twistcap.body.humanoid import humanoid
from twistcap.search.flag import SIGNS, FlagRule, features, flag_groups, support_signs


def test_groups_part_the_segments() -> None:
    body = humanoid()
    groups = flag_groups(body)
    np.testing.assert_array_equal(groups.sum(axis=0), np.ones(len(body.segment_names)))


def test_a_quiet_body_is_not_lost_and_a_contradicted_one_is() -> None:
    rule, groups = FlagRule(), flag_groups(humanoid())
    good = np.full(len(groups), 0.01)
    quiet = rule.limbs(support_signs(groups, np.ones(groups.shape[1])), good)
    assert rule.whole(quiet) < 0.02
    signs = support_signs(groups, np.ones(groups.shape[1]))
    signs[1] = [1.0, 1.0, 0.5, 0.9, 0.9, 0.3, 0.2]
    lost = rule.limbs(signs, np.where(np.arange(len(groups)) == 1, 0.2, good))
    assert lost.argmax() == 1
    assert lost[1] > 0.5
    assert rule.whole(lost) > 0.5


def test_what_is_not_seen_is_the_less_sure_the_longer() -> None:
    blind = [FlagRule().blind(s) for s in (0.0, 0.02, 0.1, 0.5, 5.0)]
    assert np.all(np.diff(blind) >= 0.0)
    assert blind[1] < 0.2
    assert blind[-1] > 0.95


def test_there_is_a_weight_for_each_feature() -> None:
    found = features(np.zeros((6, SIGNS)), np.full(6, 0.05))
    assert found.shape == (6, len(FlagRule().limb) - 1)
    assert np.all(np.isfinite(features(np.full((2, SIGNS), 9.0), np.array([0.0, np.inf]))))
