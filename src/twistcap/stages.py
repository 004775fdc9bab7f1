"""Stopwatch of the tracker's stages: off unless `record` is open, so that the normal path pays next to nothing.

``with stages.record() as times: ...`` fills ``times``: stage -> seconds in each frame. A stage inside another one is
taken out of the outer one's time. Seconds of several threads are summed.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from threading import Lock, local
from time import perf_counter

Times = dict[str, list[float]]

_NOTHING = nullcontext()


class _Recorder:
    def __init__(self) -> None:
        self.times: Times = {}
        self.frames = 0
        self.lock = Lock()
        self.open = local()  # of each thread, per open stage: the seconds that stages inside it took

    @property
    def inner(self) -> list[float]:
        if not hasattr(self.open, "inner"):
            self.open.inner = [0.0]
        return self.open.inner

    def add(self, name: str, seconds: float) -> None:
        with self.lock:
            entries = self.times.setdefault(name, [])
            entries.extend([0.0] * (self.frames - len(entries)))
            entries[-1] += seconds


_recorder: _Recorder | None = None


@contextmanager
def record() -> Generator[Times]:
    """Record every `stage` until the block ends; yields stage -> seconds per frame, complete once it has ended."""
    global _recorder
    before, _recorder = _recorder, _Recorder()
    mine = _recorder
    try:
        yield mine.times
    finally:
        _recorder = before
        for entries in mine.times.values():
            entries.extend([0.0] * (mine.frames - len(entries)))


def next_frame() -> None:
    """What is timed from here on belongs to the next frame."""
    if _recorder is not None:
        _recorder.frames += 1


def stage(name: str) -> AbstractContextManager[None]:
    """Time the block as part of stage `name`."""
    return _NOTHING if _recorder is None else _timed(_recorder, name)


@contextmanager
def _timed(recorder: _Recorder, name: str) -> Generator[None]:
    recorder.frames = max(recorder.frames, 1)
    recorder.inner.append(0.0)
    start = perf_counter()
    try:
        yield
    finally:
        spent = perf_counter() - start
        recorder.add(name, spent - recorder.inner.pop())
        recorder.inner[-1] += spent
