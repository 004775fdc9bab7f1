"""What a recording has taught: how much evidence there is, whatever the scale, the channels and the missing cameras."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from support.faulty_walk import expecting, tracked_walk, walk
from twistcap.build import build
from twistcap.render.view import RenderedView
from twistcap.search.recollection import Recollection
from twistcap.settings import Settings
from twistcap.track import Tracker
from twistcap.track.align import FrameProblem

FRAME = 12


def problem_of(tracker: Tracker) -> FrameProblem:
    """The frame after `FRAME` frames, with the body where it is."""
    return expecting(tracker, FRAME, walk()[0].true_poses[FRAME])


def known_of(tracker: Tracker) -> Recollection:
    return tracker.state.searches["lost body"].known


def test_there_is_as_much_evidence_at_a_scale_that_takes_fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second pixel below 90 px/m, every third above. It counts as that of small pictures, which do not change."""
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), FRAME)
    problem, known = problem_of(tracker), known_of(tracker)
    fit = problem.measured(problem.start)
    checks = list[np.ndarray]()
    for px_per_m in (89.9, 90.1):
        monkeypatch.setattr(RenderedView, "px_per_m", property(lambda _, px=px_per_m: px))
        check = known.check(fit.posed, fit.sights, problem)
        checks.append(np.array([check.nats.sum(axis=1), check.pixels.sum(axis=1)]))
    np.testing.assert_allclose(*checks, rtol=0.1)
    small = known.evidence(problem).of(problem.start) * (36.0 / 45.0) ** 2
    assert checks[0][0].sum() == pytest.approx(small, rel=0.15)


def test_texture_does_not_count_in_small_pictures() -> None:
    """They have none; so the evidence is that of colours, on the body and beside it."""
    scene, frames = walk()
    maps = list[np.ndarray]()
    for channels in ("lab", "lab+texture"):
        tracker = Tracker(build(scene.body, scene.rig, Settings(channels=channels)))
        tracker.start(scene.first_pose)
        for frame in frames[:FRAME]:
            tracker.step(frame)
        problem, known = problem_of(tracker), known_of(tracker)
        evidence = known.evidence(problem)
        nats, pixels = known.nats.sum() / known.pixels.sum(), evidence.by_part(problem.start)[1].sum()
        assert evidence.of(problem.start) / pixels == pytest.approx(nats, rel=0.25)
        maps.append(np.concatenate([view.maps.max(axis=0).ravel() for view in evidence.views]))
    assert np.median(maps[0]) < 0.0
    np.testing.assert_allclose(*(np.median(m) for m in maps), atol=0.2)


def test_a_camera_without_a_picture_is_not_expected_to_tell_anything() -> None:
    scene, _ = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), FRAME)
    known, problem = known_of(tracker), problem_of(tracker)
    np.testing.assert_array_equal(known.nats_in(known.evidence(problem)), known.nats.sum(axis=0))
    alone = replace(
        problem, frame=replace(problem.frame, images=(problem.frame.images[0], *[None] * (len(scene.rig) - 1)))
    )
    np.testing.assert_array_equal(known.nats_in(known.evidence(alone)), known.nats[0])
