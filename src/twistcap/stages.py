"""Stopwatch of the tracker's stages; it costs next to nothing unless `record` is open.

``with stages.record() as times: ...`` fills ``times``: stage -> seconds in each frame. The time of a stage inside
another one is subtracted from the outer one's. One thread at a time.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from time import perf_counter

Times = dict[str, list[float]]

_NOTHING = nullcontext()


class _Recorder:
    def __init__(self) -> None:
        self.times: Times = {}
        self.frames = 0
        self.inner = [0.0]  # seconds of the stages inside each open stage

    def add(self, name: str, seconds: float) -> None:
        entries = self.times.setdefault(name, [])
        entries.extend([0.0] * (self.frames - len(entries)))
        entries[-1] += seconds


_recorder: _Recorder | None = None


@contextmanager
def record() -> Generator[Times]:
    """Record every `stage` until the block ends; yields stage -> seconds per frame, complete at its end."""
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
    """Count all times from here on for the next frame."""
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
