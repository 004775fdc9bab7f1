"""Threads for the cameras of a frame, or the poses of a search: kernels and OpenCV let other threads run. Results do
not depend on them.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")
THREADS = int(os.environ.get("TWISTCAP_THREADS", os.cpu_count() or 1))
"""Threads at most, this one among them; the environment variable of that name says otherwise."""


def ahead(work: Callable[[], object]) -> None:
    """Let another thread, if there is one, begin what will be wanted soon."""
    if THREADS > 1:
        _others().submit(work)


def in_parallel(work: Callable[..., T], *arguments: Sequence[Any]) -> list[T]:
    """What the work gives for each item, in order: this thread begins with the first, others with the last. Such work
    may ask for threads too.
    """
    count = len(arguments[0])
    left, out = deque(range(count)), dict[int, T]()

    def work_off(next_item: Callable[[], int]) -> None:
        while left:
            try:
                k = next_item()
            except IndexError:  # another thread was quicker
                return
            try:
                out[k] = work(*(argument[k] for argument in arguments))
            except BaseException:
                left.clear()  # nobody wants the others any more
                raise

    helpers = [_others().submit(work_off, left.pop) for _ in range(min(THREADS, count) - 1)]
    work_off(left.popleft)
    _finish(helpers)
    return [out[k] for k in range(count)]


def _finish(helpers: Sequence[Future[None]]) -> None:
    """Wait for those that have begun; the others find nothing left to do."""
    for helper in helpers:
        if not helper.cancel():
            helper.result()


@cache
def _others() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS - 1, thread_name_prefix="twistcap")
