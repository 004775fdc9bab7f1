"""What tables, experiments and timings share: processes of one thread each, and what a table is."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import NotRequired, Protocol, TypedDict, TypeVar

from twistcap.errors import InputError
from twistcap.evaluate.metrics import Row

_THREADS = (
    "TWISTCAP_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)  # fmt: skip

_T = TypeVar("_T")


class Table(TypedDict):
    """What is printed as JSON; "seeds" of a row holds its value on every seed, in order.

    A `text` is shown to people instead of the rows.
    """

    id: str
    rows: list[Row]
    text: NotRequired[str]


class Tell(Protocol):
    """Is called with how far a table is."""

    def __call__(self, note: str, done: int = 0, total: int | None = None) -> None: ...


@contextmanager
def one_thread_processes(workers: int) -> Generator[ProcessPoolExecutor]:
    """Fresh processes of one thread each: numerical libraries read their thread numbers when they are loaded."""
    with _environment(dict.fromkeys(_THREADS, "1")):
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, context) as pool:
            try:
                yield pool
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


def jobs(usual: int) -> int:
    """How many processes are to work at a time: the environment variable JOBS, or as usual.

    Raises:
        InputError: where JOBS is no number above 0.
    """
    given = os.environ.get("JOBS", str(usual))
    if not given.isdecimal() or int(given) < 1:
        raise InputError(f"the environment variable JOBS is {given!r}; it must be a number of processes, 1 or more.")
    return int(given)


def over_seeds(work: Callable[[int], _T], seeds: Sequence[int], tell: Tell, id: str, workers: int = 2) -> list[_T]:
    """What `work`, which other processes can import, finds on each seed, in their order; `workers` at a time."""
    found: dict[int, _T] = {}
    with one_thread_processes(min(workers, len(seeds))) as pool:
        waiting = {pool.submit(work, seed): seed for seed in seeds}
        for done, future in enumerate(as_completed(waiting), 1):
            found[waiting[future]] = future.result()
            tell(f"{id}, seed {waiting[future]}", done, len(seeds))
    return [found[seed] for seed in seeds]


@contextmanager
def _environment(values: dict[str, str]) -> Generator[None]:
    """Environment variables for a while: child processes inherit them."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
