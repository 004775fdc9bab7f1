"""A limb that was astray for a few frames is put on its way; one that was right stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hindsight.walks import Misled, bent, errors, walk, with_poses
from twistcap import hindsight
from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.hindsight import Passed, between, looked_between, tracked
from twistcap.search.doubt import DoubtRule
from twistcap.search.flag import shortfall
from twistcap.search.limb import LimbRule
from twistcap.search.lost import LostBody
from twistcap.search.memory import LACKED, LostMemory
from twistcap.track import State

ASTRAY = range(16, 20)  # all frames from there to the present one


def with_astray(frames: range) -> tuple[list[Passed], State]:
    """The frames before the present one as if the arm had been astray, and the state after it."""
    scene, _, passed, _, state = walk()
    last, wrong = passed[-1], list(passed[:-1])
    for k in frames:
        wrong[k] = replace(wrong[k], estimate=replace(wrong[k].estimate, pose=bent(scene.body, wrong[k].estimate.pose)))
    state = with_poses(state, wrong, last.estimate.pose)
    ((name, memory),) = state.searches.items()
    assert isinstance(memory, LostMemory)
    lacked = np.zeros((LACKED, len(memory.groups)))
    lacked[[k - 20 for k in frames if k >= 20 - LACKED]] = 1.0
    return wrong, replace(state, searches={name: replace(memory, lacked=lacked)})


def test_an_arm_that_was_astray_is_put_on_its_way() -> None:
    scene, model, right, *_ = walk()
    wrong, state = with_astray(ASTRAY)
    assert errors(scene, [wrong[k].estimate for k in ASTRAY]).min() > 150.0
    after, better = looked_between(model, state, wrong, right[-1].estimate)
    assert [e.index for e in better] == list(ASTRAY)
    assert [e.time for e in better] == [right[k].frame.time for k in ASTRAY]
    assert errors(scene, better).max() < 30.0
    poses = [m.pose for m in after.past.moments]
    assert all(np.array_equal(poses[e.index].q, e.pose.q) for e in better)
    assert np.array_equal(poses[ASTRAY.start - 1].q, right[ASTRAY.start - 1].estimate.pose.q)


def test_nothing_is_searched_for_where_a_limb_is_expected() -> None:
    """A body that is begun anew would be looked for at once, wherever it is in doubt."""
    _, model, right, _, state = walk()
    there = between._expecting(model, state, right[-2].estimate.pose, right[-2].frame.time)
    (memory,) = there.searches.values()
    doubtful = np.ones((len(memory.groups), 11))
    assert memory.waiting and memory.limb_waiting
    assert not DoubtRule().due(memory.doubt, doubtful, doubtful)[0]


def test_what_was_right_stays() -> None:
    _, model, right, *_ = walk()
    wrong, state = with_astray(range(0))
    after, better = looked_between(model, state, wrong, right[-1].estimate)
    assert not better and after is state


def test_a_way_that_the_pictures_do_not_favour_is_not_taken() -> None:
    """The arm is astray in the present frame; so is half of the way to it."""
    scene, model, right, *_ = walk()
    wrong, state = with_astray(range(0))
    ((name, memory),) = state.searches.items()
    assert isinstance(memory, LostMemory) and memory.lacked is not None
    state = replace(state, searches={name: replace(memory, lacked=np.ones_like(memory.lacked))})
    last = right[-1].estimate
    astray = replace(last, pose=bent(scene.body, last.pose))
    assert not looked_between(model, state, wrong, astray)[1]


@pytest.mark.parametrize("shown", [0.0, 500.0])
def test_a_limb_must_be_shown_on_its_way(shown: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind the body or out of the images it would gain by that nothing speaks against it."""
    _, model, right, *_ = walk()
    wrong, state = with_astray(ASTRAY)
    tracked_poses = [one.estimate.pose for one in wrong]

    class Elsewhere:
        """Pictures that favour any other pose, and show each part of the body by as much."""

        def of(self, pose: Pose) -> float:
            return 0.0 if any(pose is one for one in tracked_poses) else 1e4

        def by_part(self, pose: Pose) -> tuple[Float, Float]:
            nats = np.full((1, len(model.body.segment_names)), shown)
            return nats, np.ones_like(nats)

    monkeypatch.setattr(between, "evidence_in", lambda *_: Elsewhere())
    assert bool(looked_between(model, state, wrong, right[-1].estimate)[1]) == bool(shown)


def test_frames_in_which_nothing_was_seen_have_no_way_between() -> None:
    _, model, right, *_ = walk()
    wrong, state = with_astray(ASTRAY)
    last = right[-1].estimate
    blind = replace(wrong[-1], estimate=replace(wrong[-1].estimate, status="no_images"))
    assert not looked_between(model, state, [*wrong[:-1], blind], last)[1]
    assert not looked_between(model, state, wrong, replace(last, status="not_found"))[1]
    assert not looked_between(replace(model, searches=()), replace(state, searches={}), wrong, last)[1]


def test_what_lacked_is_remembered_frame_by_frame() -> None:
    """After a frame the last row is of the frame before."""
    *_, before, state = walk()
    (first,), (then,) = before.searches.values(), state.searches.values()
    assert isinstance(first, LostMemory) and isinstance(then, LostMemory)
    assert first.signs is not None and first.lacked is not None and then.lacked is not None
    assert len(then.lacked) == LACKED and np.array_equal(then.lacked[-1], shortfall(first.signs))
    assert np.array_equal(then.lacked[:-1], first.lacked[1:])
    assert then.begun_anew().lacked is None


def test_an_arm_that_went_astray_in_tracking_is_right_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """No search finds it; it comes back by itself, and what the pictures lacked meanwhile tells of it."""
    scene, plain, *_ = walk()
    never = LimbRule(lacking=9.0, in_view=9.0, late=1.0, slipped=1.0, bare=1.0)
    model = replace(plain, searches=(LostBody(limb=never, doubt=DoubtRule(doubtful=1.0)),))
    model = replace(model, predictors=(Misled(ASTRAY, scene.body, scene.true_poses, back=True), *model.predictors))

    def worst() -> Float:
        return errors(scene, list(tracked(scene.frames(), model, scene.first_pose)))

    after = worst()
    monkeypatch.setattr(hindsight, "looked_between", lambda _model, state, *_: (state, []))
    before = worst()
    assert before[list(ASTRAY)].min() > 150.0 and before[ASTRAY.stop] < 30.0
    assert after.max() < 30.0
