"""Frames that were wrong are tracked again from what is found later; frames that were right stay as they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hindsight.walks import ARM, WRONG, Misled, bent, errors, walk, with_found, with_poses
from twistcap import hindsight, stages
from twistcap.body import Pose
from twistcap.body.limbs import named_limbs
from twistcap.build import build
from twistcap.commands.follow import follow, resumed
from twistcap.differential.model import DifferentialModel
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.hindsight import Again, Hindsight, LookBack, Passed, back, looked_back, tracked
from twistcap.hindsight.back import looked_again
from twistcap.hindsight.passed import corrected, evidence_in, with_limbs
from twistcap.io.result import ResultWriter, read_result
from twistcap.io.result_schema import COLUMNS
from twistcap.search.doubt import DoubtRule
from twistcap.search.flag import flag_groups
from twistcap.search.limb import LimbRule, regained
from twistcap.search.lost import LostBody
from twistcap.search.recollection import Judged, Recollection
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, Tracker


@pytest.mark.parametrize("limb", [ARM, None])
def test_frames_with_a_wrong_arm_are_put_right_and_no_others(limb: str | None) -> None:
    scene, model, passed, before, state = walk()
    last, passed = passed[-1], passed[:-1]
    wrong = [
        replace(p, estimate=replace(p.estimate, pose=bent(scene.body, p.estimate.pose), relit=k == WRONG[2]))
        if k in WRONG
        else p
        for k, p in enumerate(passed)
    ]
    assert errors(scene, [wrong[k].estimate for k in WRONG]).min() > 150.0
    state = with_poses(with_found(state, limb), wrong, last.estimate.pose)
    after, better = looked_back(LookBack(), model, before, state, wrong)
    assert [e.index for e in better] == list(WRONG)
    assert errors(scene, better).max() < 30.0
    assert [e.relit for e in better] == [k == WRONG[2] for k in WRONG]  # when the light changed, the first track knows
    assert [e.time for e in better] == [passed[k].frame.time for k in WRONG]
    poses = [m.pose for m in after.past.moments]
    assert all(np.array_equal(poses[e.index].q, e.pose.q) for e in better)
    assert all(np.array_equal(poses[k].q, passed[k].estimate.pose.q) for k in range(WRONG.start))


def test_a_limb_that_was_found_turned_is_right_after_the_corrected_frames() -> None:
    """A search puts a thigh in its place, but turned by 40°; the frames before say how it is turned."""
    scene, model, passed, before, state = walk()
    last, right = passed[-1], [p.estimate for p in passed[:-1]]
    q = last.estimate.pose.q.copy()
    q[hip := scene.body.coordinate("hip_rotation_r")] -= np.deg2rad(40.0)
    turned = replace(last.estimate, pose=Pose(last.estimate.pose.root, q))
    found = corrected(with_poses(state, passed[:-1], turned.pose), right)
    after, again = looked_again(LookBack(), model, before, found, last.frame, turned)
    assert abs(again.pose.q[hip] - scene.true_poses[-1].q[hip]) < np.deg2rad(5.0)
    assert np.array_equal(after.past.last.q, again.pose.q) and len(after.past.moments) == len(found.past.moments)
    same, as_it_was = looked_again(LookBack(), model, before, state, last.frame, last.estimate)
    assert same is state and as_it_was is last.estimate


def test_what_was_found_wrongly_corrects_nothing() -> None:
    scene, model, passed, before, state = walk()
    last, passed = passed[-1], passed[:-1]
    state = with_poses(with_found(state, ARM), passed, bent(scene.body, last.estimate.pose))
    after, better = looked_back(LookBack(), model, before, state, passed)
    assert not better and after is state


def test_a_limb_of_a_second_track_brings_its_own_flag_and_no_other() -> None:
    _, model, passed, *_ = walk()
    groups, first = flag_groups(model.body), passed[-1].estimate
    limbs, arm = named_limbs(model.body), named_limbs(model.body)[ARM]

    def said(probability: float, pose: Pose) -> Estimate:
        return replace(first, pose=pose, part_probability=np.full(groups.shape[1], probability))

    coordinates = np.asarray(model.body.chain[arm].any(axis=0) & ~model.body.chain[limbs["trunk"]].any(axis=0))
    before, second = said(0.9, first.pose), said(0.1, first.pose.retract(np.full(model.body.dof, 0.1)))
    found = with_limbs(model, before, second, coordinates, arm)
    assert found.part_probability is not None and found.lost
    np.testing.assert_array_equal(found.part_probability, np.where(arm, 0.1, 0.9))
    np.testing.assert_array_equal(found.pose.q, np.where(coordinates, second.pose.q, first.pose.q))
    np.testing.assert_array_equal(found.pose.root, first.pose.root)
    unseen = replace(before, part_probability=None, status="not_found", lost=True)
    assert with_limbs(model, unseen, second, coordinates, arm).lost  # what is not seen is not found by a limb


@pytest.mark.parametrize(
    ("gains", "end", "believed"),
    [
        ((900.0, 800.0), "beside", 2), ((900.0, -5.0), "beside", 1), ((900.0, -200.0), "beside", 1),
        ((900.0, -300.0), "beside", 0), ((12.0, 11.0), "beside", 0), ((), "beside", 0), ((12.0, 11.0), "met", 2),
        ((3.0, 2.0), "met", 0), ((9000.0, 800.0), "led back", 2), ((60.0, 50.0), "led back", 0),
    ],
)  # fmt: skip
def test_how_far_a_second_track_is_believed(
    gains: tuple[float, ...], end: str, believed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Up to where it gains no more; not if it gains little, nor if it loses much of that again."""
    _, model, passed, before, state = walk()
    way = [Again(p.estimate, gain) for p, gain in zip(reversed(passed[:-1]), gains, strict=False)]
    monkeypatch.setattr(back, "_tracked_again", lambda *_: ((way, []), end))
    _, better = looked_back(LookBack(), model, before, with_found(state, ARM), passed[:-1])
    assert [e.index for e in better] == list(range(20 - believed, 20))


def test_a_limb_to_which_a_second_track_jumps_back_must_gain_without_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rest may be that of somebody else, with better evidence."""
    _, model, passed, before, state = walk()
    body, alone = ([Again(passed[-2].estimate, gain)] for gain in (9e4, -9e3))
    for end, believed in (("met", True), ("beside", True), ("led back", False)):
        monkeypatch.setattr(back, "_tracked_again", lambda *_, end=end: ((body, alone), end))
        assert bool(looked_back(LookBack(), model, before, with_found(state, ARM), passed[:-1])[1]) == believed


def test_a_second_track_that_jumps_back_is_believed_only_if_the_pictures_say_plenty_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The arm was found wrongly; the track that runs backward finds the true one by a search of its own."""
    scene, model, passed, before, state = walk()
    wrong, last = [*passed[:-1]], passed[-1].estimate.pose
    for k in WRONG:
        wrong[k] = replace(
            passed[k], estimate=replace(passed[k].estimate, pose=bent(scene.body, passed[k].estimate.pose))
        )
    state = with_poses(with_found(state, ARM), wrong, last)
    original = back._backward

    def jumping(*arguments: Any) -> Iterator[Any]:
        for one, estimate, put in original(*arguments):
            yield one, estimate, put | (one.frame.index == 12)

    sure = LookBack(plenty=100.0)
    assert looked_back(sure, model, before, state, wrong)[1]
    monkeypatch.setattr(back, "_backward", jumping)
    assert not looked_back(sure, model, before, state, wrong)[1]
    assert looked_back(LookBack(), model, before, state, wrong)[1]


def test_where_nothing_was_found_the_tracker_is_as_it_is() -> None:
    scene, model, passed, before, state = walk()
    after, better = looked_back(LookBack(), model, before, state, passed[:-1])
    assert not better and after is state
    found = list(tracked(scene.frames(), model, scene.first_pose))
    assert [e.index for e in found] == list(range(21))
    assert all(np.array_equal(e.pose.q, p.estimate.pose.q) for e, p in zip(found, passed, strict=True))


def test_estimates_come_when_nothing_can_correct_them() -> None:
    scene, model, passed, *_ = walk()
    one = passed[0].size / 1e6
    for rule, late in ((LookBack(frames=5), 5), (LookBack(megabytes=int(4.5 * one) or 1), None)):
        tracker, read = Tracker(model), list[int]()
        tracker.start(scene.first_pose)

        def frames(read: list[int] = read) -> Iterator[Frame]:
            for p in passed:
                read.append(p.frame.index)
                yield p.frame

        first = next(Hindsight(tracker, rule).through(frames()))
        assert first.index == 0 and (late is None or len(read) == late + 1)
        assert len(read) * one < rule.megabytes + 2 * one or late is not None


def test_what_came_before_the_first_frame_is_corrected_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracker that goes on gives estimates of the frames that it gets, whatever it finds out of those before."""
    _, model, passed, before, _ = walk()
    tracker = Tracker(model)
    tracker.state = before
    monkeypatch.setattr(hindsight, "looked_back", lambda *given: (given[3], [p.estimate for p in passed[-3:-1]]))
    found = Hindsight(tracker, passed=passed[:-1]).through([passed[-1].frame])
    assert [e.index for e in found] == [20]


def test_the_poses_of_all_frames_that_may_be_corrected_are_remembered() -> None:
    with pytest.raises(InputError, match="frames is 128; it must be a whole number from 1 to 127"):
        LookBack(frames=128)


def test_passed_frames_are_judged_in_pictures_like_those_that_were_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    _, model, passed, _, state = walk()
    image, judged = passed[0].seen.images[0], list[Any]()
    assert image is not None
    noisy = np.where(np.random.default_rng(0).random(image.shape[:2])[..., None] < 0.2, 255 - image, image)
    monkeypatch.setattr(Recollection, "evidence", lambda _, problem: judged.append(problem.frame.images[0]))
    seen = replace(passed[0].frame, images=(noisy, *passed[0].seen.images[1:]))
    evidence_in(model, state, replace(passed[0], frame=seen))
    assert np.array_equal(judged[0], cv2.medianBlur(noisy, 3))


def test_a_limb_may_be_put_elsewhere_twice_in_a_row() -> None:
    """It was found wrongly in the frame before. A frame in which no search could see anything finds nothing."""
    _, model, _, before, state = walk()
    search = next(s for s in model.searches if isinstance(s, LostBody))
    first, then = (with_found(s, ARM).searches[search.name] for s in (before, state))
    assert search.put_elsewhere(first, then).tolist() == (then.found > 0.0).tolist()
    assert not search.put_elsewhere(first, first).any()
    assert not search.put_elsewhere(first, replace(then, found=search.doubted * first.found)).any()


def test_frames_that_are_tracked_again_count_as_one_in_the_stopwatch() -> None:
    scene, model, passed, before, state = walk()
    state = with_poses(with_found(state, ARM), passed[:-1], bent(scene.body, passed[-1].estimate.pose))
    with stages.record() as times:
        stages.next_frame()
        looked_back(LookBack(), model, before, state, passed[:-1])
    assert times and {len(seconds) for seconds in times.values()} == {1}


def test_the_differential_tracker_does_not_look_back() -> None:
    scene = capture(StudioConfig(0, 2, (192, 140), frames=3))
    found = list(tracked(scene.frames(), DifferentialModel(scene.body, rig=scene.rig), scene.first_pose))
    assert [e.index for e in found] == [0, 1, 2]


THROWN_OFF = range(13, 21)
"""Frames in which an arm is astray, whatever the pictures say; the search finds it in the next one."""


@cache
def thrown_off() -> tuple[Capture, list[Frame], Model]:
    """A walk whose right arm is thrown off for some frames."""
    scene = capture(StudioConfig(seed=3, views=3, frames=29))
    model = build(scene.body, scene.rig)
    misled = Misled(THROWN_OFF, scene.body, scene.true_poses, back=False)
    late = LostBody(doubt=DoubtRule(doubtful=1.0))
    return scene, list(scene.frames()), replace(model, predictors=(misled, *model.predictors), searches=(late,))


@pytest.fixture(scope="module")
def late_search() -> Iterator[None]:
    """Until the arm is free again, no search finds it."""

    def found(rule: LimbRule, known: Recollection, now: Judged, *about: Any, sure: bool) -> Any:
        return None if now.problem.frame.index in THROWN_OFF else regained(rule, known, now, *about, sure=sure)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twistcap.search.lost.regained", found)
        yield


@pytest.mark.usefixtures("late_search")
def test_a_limb_that_was_thrown_off_is_right_in_the_end() -> None:
    scene, frames, model = thrown_off()
    tracker = Tracker(model)
    tracker.start(scene.first_pose)
    at_once = errors(scene, [tracker.step(frame) for frame in frames])
    assert at_once[list(THROWN_OFF)].min() > 150.0 and at_once[THROWN_OFF.stop :].max() < 30.0
    assert errors(scene, list(tracked(frames, model, scene.first_pose))).max() < 30.0


class Killed(Exception):
    """In the middle of a run."""


def torn_after_two(writer: ResultWriter, estimates: list[Estimate]) -> None:
    for row, estimate in list(enumerate(estimates, len(writer) - 1 - len(estimates)))[:2]:
        writer._put_row(row, estimate)
    raise Killed


def until_killed(frames: list[Frame]) -> Iterator[Frame]:
    yield from frames
    raise Killed


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, late_search: None) -> Path:
    """The result of the whole track."""
    scene, frames, model = thrown_off()
    path, tracker = tmp_path_factory.mktemp("whole") / "whole.h5", Tracker(model)
    tracker.start(scene.first_pose)
    with ResultWriter(path, scene.body, scene.rig, {}, room=len(frames)) as writer:
        follow(frames, len(frames), tracker, writer)
    return path


@pytest.mark.parametrize(("stop", "torn", "begun"), [(21, False, 20), (22, False, 22), (23, True, 22), (28, False, 25)])
def test_a_track_that_is_resumed_looks_back_alike(
    undisturbed: Path, tmp_path: Path, stop: int, torn: bool, begun: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frame 21 corrects those before it; what a kill leaves undone, the resumed run does."""
    monkeypatch.setattr("twistcap.commands.follow.STATE_EVERY", 5)
    scene, frames, model = thrown_off()
    body, rig = scene.body, scene.rig

    def started() -> Tracker:
        tracker = Tracker(model)
        tracker.start(scene.first_pose)
        return tracker

    with monkeypatch.context() as patch:
        if torn:
            patch.setattr(ResultWriter, "correct", torn_after_two)
        with ResultWriter(tmp_path / "cut.h5", body, rig, {}, room=len(frames)) as writer, pytest.raises(Killed):
            follow(until_killed(frames[:stop]), len(frames), started(), writer)
    tracker = started()
    count, corrected = resumed(tracker, tmp_path / "cut.h5")
    assert count == begun
    with ResultWriter.resume(tmp_path / "cut.h5", count, len(frames)) as writer:
        writer.correct(corrected)
    passed = map(Passed, frames[:count], read_result(tmp_path / "cut.h5").estimates)
    with ResultWriter.resume(tmp_path / "cut.h5", count, len(frames)) as writer:
        follow(frames[count:], len(frames), tracker, writer, passed)
    whole, cut = (read_result(path) for path in (undisturbed, tmp_path / "cut.h5"))
    for name in (column.of_result for column in COLUMNS.values()):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name))
    assert all(a < b for a, b in pairwise(whole.times))
