"""A lost body is found by the keypoints of its frame, where the images agree with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from support.elsewhere import BACK, GAP, greatest_error, keypoints, scene
from twistcap.adjust.refinding import with_keypoints
from twistcap.build import build
from twistcap.estimate import Estimate, Frame, Keypoints
from twistcap.track import Tracker


@dataclass(frozen=True)
class Detector:
    """Keypoints of the person, or of one who is beside by so many metres; it notes for which frames it was asked."""

    beside: float = 0.0
    asked: list[int] = field(default_factory=list[int])

    def __call__(self, index: int) -> Keypoints:
        self.asked.append(index)
        return keypoints(index, self.beside)


def _tracked(frames: list[Frame], source: Callable[[int], Keypoints | None] | None) -> list[Estimate]:
    made = scene()[0]
    model = build(made.body, made.rig)
    tracker = Tracker(model if source is None else with_keypoints(model, made.rig, source))
    tracker.start(made.first_pose)
    return [tracker.step(frame) for frame in frames]


def test_a_body_beyond_what_is_searched_is_found_by_its_keypoints() -> None:
    made, frames = scene()
    moved = np.linalg.norm((made.landmarks[BACK] - made.landmarks[GAP[0] - 1]).mean(axis=0))
    assert moved > 3.0
    without, detector = _tracked(frames[: BACK + 3], None), Detector()  # then it is looked for again
    found = _tracked(frames, detector)
    assert all(estimate.status == "not_found" and estimate.lost for estimate in without[BACK:])
    assert all(greatest_error(estimate.index, estimate.pose) < 0.03 and not estimate.lost for estimate in found[BACK:])
    assert detector.asked == [BACK, BACK + 1]  # it is slow, and needed only there, and once more to be sure


def test_images_decide_what_keypoints_propose() -> None:
    _, frames = scene()
    detector = Detector(beside=0.8)
    track = _tracked(frames, detector)
    assert all(estimate.status == "not_found" for estimate in track[BACK:])
    assert detector.asked == [BACK, BACK + 3]  # as often as the images are searched


def test_keypoints_that_nobody_needs_change_nothing() -> None:
    """Not even wrong ones: to the last bit."""
    _, frames = scene()
    detector = Detector(beside=0.8)
    plain, track = (_tracked(frames[: GAP[0]], source) for source in (None, detector))
    for a, b in zip(plain, track, strict=True):
        assert np.array_equal(a.pose.root, b.pose.root) and np.array_equal(a.pose.q, b.pose.q)
        assert np.array_equal(a.covariance, b.covariance) and a.probability == b.probability
    assert not detector.asked


def test_without_keypoints_of_the_frame_it_is_looked_for_as_ever() -> None:
    """None at all, or none on which two views agree."""
    made, frames = scene()
    one = np.zeros((len(made.rig), 1))
    few = Keypoints(("knee_r",), np.zeros((len(made.rig), 1, 2)), one)
    for nothing in (None, few):
        track = _tracked(frames[: BACK + 1], lambda _, given=nothing: given)
        assert track[-1].status == "not_found"
