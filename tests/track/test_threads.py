"""Threads change the time that a frame takes, and nothing else."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from twistcap import threads
from twistcap.build import build
from twistcap.errors import InputError
from twistcap.studio import StudioConfig, capture
from twistcap.track import Tracker


@pytest.fixture(autouse=True)
def pool() -> Iterator[None]:
    """The threads of one test are not those of the next, whose number may differ."""
    threads._others.cache_clear()
    yield
    threads._others.cache_clear()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_the_results_of_views_come_in_their_order(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(threads, "THREADS", count)
    assert threads.each_view(lambda i, j: i + j, range(5), range(5)) == [0, 2, 4, 6, 8]
    assert threads.each_view(lambda i: i, []) == []


def test_two_threads_share_the_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    both = threading.Barrier(2, timeout=10.0)  # neither can do both views

    def work(_: int) -> str:
        both.wait()
        return threading.current_thread().name

    here, there = threads.each_view(work, range(2))
    assert here == threading.current_thread().name and there.startswith("view")


def test_an_error_in_any_thread_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    both = threading.Barrier(2, timeout=10.0)

    def work(k: int) -> None:
        both.wait()
        if k == 1:
            raise InputError("view 1: no.")

    with pytest.raises(InputError, match="view 1"):
        threads.each_view(work, range(2))


def test_work_ahead_is_done_by_another_thread_if_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    done = threading.Event()
    monkeypatch.setattr(threads, "THREADS", 1)
    threads.ahead(done.set)
    assert not done.is_set()
    monkeypatch.setattr(threads, "THREADS", 2)
    threads.ahead(done.set)
    assert done.wait(10.0)


def test_estimates_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    made = capture(StudioConfig(seed=5, views=3, frames=8))
    tracks = []
    for count in (1, 2):
        monkeypatch.setattr(threads, "THREADS", count)
        threads._others.cache_clear()
        tracker = Tracker(build(made.body, made.rig))
        tracker.start(made.first_pose)
        tracks.append([tracker.step(frame) for frame in made.frames()])
    for alone, pooled in zip(*tracks, strict=True):
        np.testing.assert_array_equal(alone.pose.q, pooled.pose.q)
        np.testing.assert_array_equal(alone.pose.root, pooled.pose.root)
        np.testing.assert_array_equal(alone.covariance, pooled.covariance)
