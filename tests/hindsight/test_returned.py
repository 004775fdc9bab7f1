"""A limb that few cameras saw, and that came back elsewhere, is doubted in the frames before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hindsight.walks import ARM, Misled, bent, errors, walk
from twistcap import hindsight
from twistcap.arrays import Float
from twistcap.body.limbs import named_limbs
from twistcap.estimate import Estimate
from twistcap.hindsight import Passed, tracked
from twistcap.hindsight.returned import doubted
from twistcap.search.doubt import DoubtRule
from twistcap.search.flag import FEW, JUMPED
from twistcap.search.limb import LimbRule, regained
from twistcap.search.lost import LostBody
from twistcap.search.memory import LostMemory
from twistcap.search.recollection import Judged, Recollection
from twistcap.track import State

FEWER = range(12, 20)  # frames that one of three cameras shows; the last one of the walk is 20


def with_signs(state: State, few: float, off: float) -> State:
    """The state as if so few cameras short of three saw the right arm, so many m off."""
    ((name, memory),) = state.searches.items()
    assert isinstance(memory, LostMemory) and memory.signs is not None
    arm = memory.groups[:, named_limbs(walk()[0].body)[ARM]].any(axis=1)
    signs = memory.signs.copy()
    signs[:, FEW], signs[:, JUMPED] = few, np.where(arm, off, 0.0)
    return replace(state, searches={name: replace(memory, signs=signs)})


def doubts(
    off: float = 0.4, fewer: Sequence[int] = FEWER, few: float = 2.0, **last: object
) -> tuple[list[Passed], list[Estimate]]:
    """The frames before the present one, and what is doubted of them: the arm was off, and is back."""
    scene, model, right, before, state = walk()
    passed = [
        replace(
            p,
            estimate=replace(
                p.estimate,
                brightness=np.array([0.4, *[np.nan if k in fewer else 0.4] * 2]),
                pose=bent(scene.body, p.estimate.pose),
            ),
        )
        for k, p in enumerate(right[:-1])
    ]
    passed[-1] = replace(passed[-1], estimate=replace(passed[-1].estimate, **last))
    found = doubted(model, with_signs(before, few, 0.0), with_signs(state, 0.0, off), passed, right[-1].estimate)
    return passed, found


def test_the_arm_is_doubted_more_and_more_and_nothing_else() -> None:
    passed, found = doubts()
    assert [e.index for e in found] == [*FEWER]
    arm = named_limbs(walk()[0].body)[ARM]
    chances = [e.part_probability[arm].max() for e in found if e.part_probability is not None]
    assert np.all(np.diff(chances) > 0.0) and chances[0] < 0.05 and chances[-1] == pytest.approx(0.4 / 0.55)
    assert [e.lost for e in found] == [k >= 16 for k in FEWER]  # (5 / 8)² of 0.4 m are more than 0.15 m
    for one, e in zip(passed[FEWER.start :], found, strict=True):
        assert e.part_probability is not None and one.estimate.part_probability is not None
        np.testing.assert_array_equal(e.part_probability[~arm], one.estimate.part_probability[~arm])
        assert np.array_equal(e.pose.q, one.estimate.pose.q)
    grown = found[-1].covariance - passed[-1].estimate.covariance
    swing = np.deg2rad(70.0)
    assert np.sqrt(grown.max()) == pytest.approx(swing, rel=0.2) and np.count_nonzero(np.diag(grown) > 1e-3) == 2


def test_limbs_that_are_not_judged_stay_so() -> None:
    _, _, right, *_ = walk()
    by_part, limbs = right[-2].estimate.part_probability, named_limbs(walk()[0].body)
    assert by_part is not None
    passed, found = doubts(part_probability=np.where(limbs[ARM], np.nan, by_part))
    assert found[-1].part_probability is not None and np.isnan(found[-1].part_probability[limbs[ARM]]).all()
    assert not found[-1].lost and found[-2].lost
    for unknown in (None, np.full_like(by_part, np.nan)):
        passed, found = doubts(part_probability=unknown)
        assert found[-1].probability < 0.5
        assert np.trace(found[-1].covariance) > 1.0 + np.trace(passed[-1].estimate.covariance)


@pytest.mark.parametrize(
    "about",
    [
        {"off": 0.1},
        {"fewer": ()},
        {"few": 0.0},
        {"fewer": range(12, 19)},
        {"fewer": range(18, 20)},
        {"status": "no_images"},
    ],
)
def test_nothing_is_doubted_without_reason(about: dict[str, object]) -> None:
    """The arm came back nearly where it was, or no camera more shows it, or one alone did for two frames only, or what
    it did in a gap is not known.
    """
    assert not doubts(**about)[1]  # type: ignore[arg-type]


def test_a_track_that_one_camera_led_astray_claims_less_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, plain, *_ = walk()
    astray = range(16, 20)
    misled = Misled(astray, scene.body, scene.true_poses, back=False)
    model = replace(
        plain, searches=(LostBody(doubt=DoubtRule(doubtful=1.0)),), predictors=(misled, *plain.predictors)
    )  # fmt: skip
    frames = [replace(f, images=(f.images[0], None, None)) if f.index in FEWER else f for f in scene.frames()]

    def claimed() -> Float:
        estimates = list(tracked(frames, model, scene.first_pose))
        assert errors(scene, estimates)[[*astray]].min() > 150.0
        return np.array([np.trace(e.covariance[6:, 6:]) for e in estimates])

    def found(rule: LimbRule, known: Recollection, now: Judged, *about: Any, sure: bool) -> Any:
        return None if now.problem.frame.index in FEWER else regained(rule, known, now, *about, sure=sure)

    monkeypatch.setattr("twistcap.search.lost.regained", found)
    monkeypatch.setattr(hindsight, "looked_back", lambda _rule, _model, _before, state, _passed: (state, []))
    monkeypatch.setattr(hindsight, "looked_between", lambda _model, state, *_: (state, []))
    after = claimed()
    monkeypatch.setattr(hindsight, "doubted", lambda *_: [])
    before = claimed()
    changed = np.flatnonzero(after != before).tolist()
    assert changed == [*FEWER] and np.all(after >= before)
    assert np.sqrt(after - before)[19] > np.deg2rad(60.0)
