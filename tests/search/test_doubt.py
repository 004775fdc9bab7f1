"""A body that is in doubt is looked for again near where it is fitted."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from support.faulty_walk import expecting, tracked_walk, walk
from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.model import partners
from twistcap.search import Problem
from twistcap.search.doubt import Doubt, DoubtRule
from twistcap.search.lost import LostBody
from twistcap.search.memory import LostMemory
from twistcap.search.recollection import fitted_at
from twistcap.track import Tracker

FRAME = 12


def test_it_is_looked_for_ever_more_seldom_while_it_is_not_found() -> None:
    rule, doubt, asked = DoubtRule(again=2, longest=8), Doubt(), list[int]()
    doubtful = np.ones((6, 11))
    assert rule.probability(0.0 * doubtful, 0.0 * doubtful) < rule.doubtful < rule.probability(doubtful, doubtful)
    for k in range(40):
        due, doubt = rule.due(doubt, doubtful, doubtful)
        if due:
            doubt, asked = rule.in_vain(doubt), [*asked, k]
    assert np.diff(asked).tolist() == [3, 5, 9, 9, 9]
    assert rule.due(Doubt(), None, None) == rule.due(Doubt(), 0.0 * doubtful, 0.0 * doubtful) == (False, Doubt())
    for _ in range(8):
        _, doubt = rule.due(doubt, 0.0 * doubtful, 0.0 * doubtful)
    assert doubt == Doubt()
    assert rule.due(rule.settled, doubtful, doubtful) == (False, Doubt(rule.again - 1))


def test_it_is_looked_for_again_for_a_while_after_it_has_been_found() -> None:
    """Nothing speaks against it; the doubt in what has been found fades."""
    rule, doubt, asked = DoubtRule(), DoubtRule().begun, list[int]()
    quiet = np.zeros((6, 11))
    for k in range(40):
        due, doubt = rule.due(doubt, quiet, quiet, LostBody().doubted ** k)
        if due:
            doubt, asked = rule.in_vain(doubt), [*asked, k]
    assert asked == [1, 5]


@pytest.mark.parametrize("torn_away", [False, True])
def test_a_body_that_has_been_found_is_looked_for_again_one_and_five_frames_later(
    torn_away: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a gap, and where its fit was lost."""
    searched, looked_for = list[int](), LostBody._searched

    def noted(self: LostBody, memory: LostMemory, problem: Problem, *rest: Any) -> Pose | None:
        searched.append(problem.frame.index)
        return looked_for(self, memory, problem, *rest)

    monkeypatch.setattr(LostBody, "_searched", noted)
    _, frames = walk()
    *_, (_, before) = islice(tracked_walk(lambda frame: frame), FRAME)
    tracker, past = Tracker(before.model), before.state.past
    tracker.state = before.state
    if torn_away:
        away = replace(past.last, root=se3.transform(np.eye(3), np.array([0.6, 0.4, 0.0])) @ past.last.root)
        moment = replace(past.moments[-1], pose=away)
        tracker.state = before.state.with_past(replace(past, moments=(moment,)))
    else:
        frames = [replace(frame, images=(None,) * len(frame.images)) if frame.index < 18 else frame for frame in frames]
    for frame in frames[FRAME:30]:
        tracker.step(frame)
    found = FRAME if torn_away else 18
    assert searched == [found, found + 1, found + 5]


@pytest.mark.parametrize(("wrong", "gain", "found"), [(True, 0.04, True), (True, 9.0, False), (False, 0.04, False)])
def test_limbs_that_are_wrong_together_are_found_together(wrong: bool, gain: float, found: bool) -> None:
    """All limbs are where those of the other side belong."""
    scene, _ = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), FRAME)
    here = scene.true_poses[FRAME]
    start = Pose(here.root, here.q[partners(scene.body.coordinate_names)]) if wrong else here
    problem = expecting(tracker, FRAME, start)
    fit, memory = problem.measured(start), tracker.state.searches["lost body"]
    doubtful = np.ones_like(memory.lately)
    memory = replace(memory, doubt=Doubt(), signs=doubtful, lately=doubtful)
    now = fitted_at(memory.known, problem, fit)
    revision, after = LostBody(doubt=DoubtRule(gain=gain))._reconsidered(memory, now)
    assert (revision is not None) == found
    assert after.doubt == (DoubtRule().settled if found else Doubt(DoubtRule().again, DoubtRule().again))
    if revision is not None:
        assert revision.fit is not None
        off = np.linalg.norm(Posed(scene.body, revision.fit.pose).landmarks - scene.landmarks[FRAME], axis=1).max()
        wide = np.linalg.norm(Posed(scene.body, start).landmarks - scene.landmarks[FRAME], axis=1).max()
        assert off < 0.05 < 0.2 < wide
