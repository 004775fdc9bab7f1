"""What is remembered of a body that a search has put elsewhere, and when limbs are believed to be elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import islice
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from support.faulty_walk import expecting, tracked_walk, walk
from twistcap.body import Pose
from twistcap.body.model import partners
from twistcap.search import limb
from twistcap.search.doubt import Doubt
from twistcap.search.flag import FOUND, JUMPED, LACKING
from twistcap.search.limb import LimbRule
from twistcap.search.lost import LostBody
from twistcap.search.memory import LostMemory
from twistcap.search.recollection import fitted_at
from twistcap.track import Tracker

FRAME = 12


@cache
def tracker() -> Tracker:
    *_, (_, found) = islice(tracked_walk(lambda frame: frame), FRAME)
    return found


def test_a_corrected_body_keeps_its_motion_and_its_signs_are_those_of_the_new_place() -> None:
    """All limbs are where those of the other side belong; the neck, which is right, was expected elsewhere."""
    scene, _ = walk()
    true, neck = scene.true_poses[FRAME], scene.body.coordinate("neck_rotation")
    wrong = Pose(true.root, true.q[partners(scene.body.coordinate_names)])
    turned = np.where(np.arange(len(true.q)) == neck, 0.3, 0.0)
    problem = expecting(tracker(), FRAME, Pose(wrong.root, wrong.q + turned))
    memory: LostMemory = tracker().state.searches["lost body"]
    doubtful = np.ones((len(memory.groups), 11))
    memory = replace(memory, doubt=Doubt(), signs=doubtful, lately=doubtful, jumped=0.0 * memory.jumped)
    now = fitted_at(memory.known, problem, problem.measured(wrong))
    revision, after = LostBody()._reconsidered(memory, now)
    assert revision is not None and revision.fit is not None and after.signs is not None
    before = problem.past.moments[-1].pose.q
    assert abs(revision.fit.pose.q[neck] - wrong.q[neck]) < np.deg2rad(2.0) < abs(turned[neck])
    assert revision.last.pose.q[neck] == before[neck]
    legs = [scene.body.coordinate(f"hip_flexion_{side}") for side in "rl"]
    np.testing.assert_array_equal(revision.last.pose.q[legs], revision.fit.pose.q[legs])
    assert (after.signs[:, FOUND] == after.found).all() and after.found.max() == 1.0
    assert after.signs[:, JUMPED].max() > 0.1
    assert after.signs[:, LACKING].max() < 0.5  # of the wrong place all are 1


def test_bare_colours_are_looked_at_though_a_limb_slips(monkeypatch: pytest.MonkeyPatch) -> None:
    memory: LostMemory = tracker().state.searches["lost body"]
    memory, now = replace(memory, signs=np.ones((len(memory.groups), 11))), cast("Any", SimpleNamespace(check=None))
    search, all_limbs = LostBody(), list(range(len(memory.groups) - 1))
    monkeypatch.setattr(LimbRule, "slipping", lambda self, signs: [1])
    for due in (all_limbs, []):
        monkeypatch.setattr(LimbRule, "due", lambda self, *about, due=due: due)
        assert search._due_limbs(memory, now) == (due or [1])


def test_a_contour_of_a_few_points_says_nothing_against_a_limb() -> None:
    """As that of an arm before the trunk."""
    scene, _ = walk()
    memory: LostMemory = tracker().state.searches["lost body"]
    problem = expecting(tracker(), FRAME, scene.true_poses[FRAME])
    now, groups = fitted_at(memory.known, problem, problem.measured(problem.start)), memory.groups
    none = np.zeros(len(groups), np.bool_)
    said = [limb._wrong(memory.known, now, groups, telling) for telling in (none, ~none)]
    seen = [limb.lacking(groups, memory.known, now.check)[0], limb.hidden(groups, memory.known, now.check)]
    np.testing.assert_array_equal(said[0], np.maximum(np.max(seen, axis=0), 0.0))
    assert (said[1] >= said[0]).all() and (said[1] > said[0]).any()


def test_parts_are_shown_where_a_picture_has_a_pixel_of_them() -> None:
    problem = expecting(tracker(), FRAME, walk()[0].true_poses[FRAME])
    fit = problem.measured(problem.start)
    assert fit.shown.all()
    assert not replace(fit, sights=()).shown.any()
    away = [replace(s, seen=replace(s.seen, face_index=np.full_like(s.seen.face_index, -1))) for s in fit.sights]
    assert not replace(fit, sights=away).shown.any()
