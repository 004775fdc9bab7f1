"""Threads change the time that a frame takes, and nothing else."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from twistcap.studio import StudioConfig, capture
from twistcap.track import Tracker, build, threads


@pytest.fixture
def pooled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads, for images of every size."""
    monkeypatch.setattr(threads, "THREADS", 2)
    monkeypatch.setattr(threads, "_WORTHWHILE", 0)


def test_the_views_results_come_in_their_order_from_other_threads(pooled: None) -> None:
    found = threads.each_view(1, lambda i, j: (i + j, threading.current_thread().name), range(5), range(5))
    assert [n for n, _ in found] == [0, 2, 4, 6, 8]
    assert all(name.startswith("view") for _, name in found)


def test_small_images_stay_in_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    here = threading.current_thread().name
    assert threads.each_view(1000, lambda _: threading.current_thread().name, range(3)) == [here] * 3


def test_estimates_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    made = capture(StudioConfig(seed=5, views=3, frames=8))
    monkeypatch.setattr(threads, "_WORTHWHILE", 0)
    tracks = []
    for count in (1, 2):
        monkeypatch.setattr(threads, "THREADS", count)
        tracker = Tracker(build(made.body, made.rig))
        tracker.start(made.first_pose)
        tracks.append([tracker.step(frame) for frame in made.frames()])
    for alone, pooled in zip(*tracks, strict=True):
        np.testing.assert_array_equal(alone.pose.q, pooled.pose.q)
        np.testing.assert_array_equal(alone.pose.root, pooled.pose.root)
        np.testing.assert_array_equal(alone.covariance, pooled.covariance)
