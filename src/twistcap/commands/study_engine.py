"""Where the jobs of a study run: processes of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Generator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, Protocol

from twistcap.commands.terminal import say
from twistcap.errors import InputError

LIVES = 3
"""Workers that may die over one job; Dask's own rule is the same (`distributed.scheduler.allowed-failures`)."""


class Engine(Protocol):
    """What a study needs of an executor."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]: ...


class WorkerDied(RuntimeError):
    """The process of a job has died, again and again."""


class Processes:
    """Worker processes of this machine, one job at a time in each.

    Each worker is a pool of its own, so that it is known which job a worker died over; that one is given to a new one.
    """

    def __init__(self, count: int) -> None:
        self._keepers = ThreadPoolExecutor(count, thread_name_prefix="worker")
        self._mine = threading.local()
        self._pools: list[ProcessPoolExecutor] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Raises in the future what the job raises, or `WorkerDied`."""
        return self._keepers.submit(self._done, fn, *args)

    def _done(self, fn: Callable[..., Any], *args: Any) -> Any:
        for _ in range(LIVES):
            pool = self._pool()
            try:
                return pool.submit(fn, *args).result()
            except BrokenExecutor:
                pool.shutdown(wait=False)
                self._mine.pool = None
        raise WorkerDied(f"its worker died {LIVES} times; the memory may be too small")

    def _pool(self) -> ProcessPoolExecutor:
        if getattr(self._mine, "pool", None) is None:
            self._mine.pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))  # threads do not survive a fork
            self._pools.append(self._mine.pool)
        return self._mine.pool

    def close(self) -> None:
        """Let go of what has not begun, and wait for the workers to end."""
        self._keepers.shutdown(wait=False, cancel_futures=True)
        for pool in self._pools:
            pool.shutdown(wait=False, cancel_futures=True)
        self._keepers.shutdown(wait=True)


@contextmanager
def here(workers: int) -> Generator[Engine]:
    """Processes of this machine, which share its cores."""
    before = os.environ.get("TWISTCAP_THREADS")
    os.environ["TWISTCAP_THREADS"] = before or str(max(1, (os.cpu_count() or 1) // workers))  # workers inherit it
    engine = Processes(workers)
    try:
        yield engine
    finally:
        engine.close()
        if before is None:
            del os.environ["TWISTCAP_THREADS"]


@contextmanager
def on_cluster(address: str) -> Generator[Engine]:
    """The workers of a Dask scheduler. Raises InputError where none answers, or a worker has more than one thread."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--cluster needs Dask; install it with pip install 'twistcap[study]'.") from error
    try:
        client = Client(address, timeout="20s")
    except (OSError, ValueError, TypeError) as error:
        mend = "start one with dask scheduler, and give the address that it prints"
        raise InputError(f"--cluster: no Dask scheduler answers at {address!r}; {mend}.") from error
    with client:
        threads: Any = client.nthreads()
        many = [worker for worker, count in threads.items() if count > 1]
        if many:
            raise InputError(f"--cluster: the worker {many[0]} runs jobs in threads; start workers with --nthreads 1.")
        if not threads:
            say(f"{address} has no worker yet; trials wait for the first one: dask worker {address} --nthreads 1")
        yield client.get_executor()
