"""Threads change the time that a frame takes, and nothing else."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest

from support.faulty_walk import FAULT, empty, tracked_walk
from twistcap import threads
from twistcap.body import Pose
from twistcap.build import build
from twistcap.errors import InputError
from twistcap.search.body import BodySearch
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
    assert threads.in_parallel(lambda i, j: i + j, range(5), range(5)) == [0, 2, 4, 6, 8]
    assert threads.in_parallel(lambda i: i, []) == []


def test_two_threads_share_the_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    both = threading.Barrier(2, timeout=10.0)  # neither can do both views

    def work(_: int) -> str:
        both.wait()
        return threading.current_thread().name

    here, there = threads.in_parallel(work, range(2))
    assert here == threading.current_thread().name and there.startswith("twistcap")


def test_work_in_threads_may_ask_for_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 3)
    found = list[list[list[int]]]()

    def both() -> None:
        found.append(threads.in_parallel(lambda i: threads.in_parallel(lambda j: 10 * i + j, range(4)), range(5)))

    caller = threading.Thread(target=both, daemon=True)
    caller.start()
    caller.join(20.0)  # they may not wait for each other
    assert found == [[[10 * i + j for j in range(4)] for i in range(5)]]


def test_nothing_more_is_begun_after_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    begun, refused = list[int](), threading.Event()

    def work(k: int) -> None:
        begun.append(k)
        if k == 0:
            refused.set()
            raise InputError("view 0: no.")
        assert refused.wait(10.0)

    with pytest.raises(InputError, match="view 0"):
        threads.in_parallel(work, range(40))
    assert len(begun) < 5


def test_an_error_in_any_thread_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    both = threading.Barrier(2, timeout=10.0)

    def work(k: int) -> None:
        both.wait()
        if k == 1:
            raise InputError("view 1: no.")

    with pytest.raises(InputError, match="view 1"):
        threads.in_parallel(work, range(2))


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


def test_a_search_does_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a gap the whole body is looked for."""
    tracks, looks, found = list[list[Pose]](), list[int](), BodySearch.found
    monkeypatch.setattr(BodySearch, "found", lambda self, least=None: looks.append(1) or found(self, least))
    for count in (1, 3):
        monkeypatch.setattr(threads, "THREADS", count)
        threads._others.cache_clear()
        looks.clear()
        tracks.append([t.state.past.last for _, t in islice(tracked_walk(empty), FAULT.stop + 2)])
        assert looks
    for alone, pooled in zip(*tracks, strict=True):
        np.testing.assert_array_equal(alone.q, pooled.q)
        np.testing.assert_array_equal(alone.root, pooled.root)
