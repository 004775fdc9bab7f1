"""One thread for each camera: kernels and OpenCV let other threads run."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")
THREADS = int(os.environ.get("TWISTCAP_THREADS", os.cpu_count() or 1))
"""Threads at most; the environment variable of that name says otherwise. The results do not depend on it."""


_WORTHWHILE = 400_000
"""Pixels of all views together from which on a second thread saves more than it costs."""


def each_view(pixels: int, work: Callable[..., T], *arguments: Sequence[Any]) -> list[T]:
    """What the work gives for each view, in their order; the views have so many pixels together."""
    if min(THREADS, len(arguments[0])) < 2 or pixels < _WORTHWHILE:
        return [work(*each) for each in zip(*arguments, strict=True)]
    return list(_pool().map(work, *arguments))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS, thread_name_prefix="view")
