"""The loop that `demo` and `track` share: step, write, tell."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from twistcap.commands.terminal import progress
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.io.result import ResultWriter, read_state
from twistcap.io.state import from_bytes, to_bytes
from twistcap.track import Tracker

STATE_EVERY = 10
"""Frames from one saved state to the next; what follows the last one is tracked again, and comes out alike."""


@dataclass
class Timing:
    """Milliseconds of the tracker alone, decoding apart, frame by frame."""

    ms: list[float] = field(default_factory=list[float])

    @property
    def median(self) -> float:
        """Without the first frame, which also compiles; NaN where there is none."""
        times = self.ms[1:] or self.ms
        return float(np.median(times)) if times else float("nan")


def follow(frames: Iterable[Frame], total: int, tracker: Tracker, writer: ResultWriter) -> Timing:
    """Track all frames; each is in the file before the next is touched. The InputError of a bad frame says so."""
    timing = Timing()
    with progress("tracking", total) as advance:
        try:
            for frame in frames:
                if len(writer) % STATE_EVERY == 0:
                    writer.save_state(to_bytes(tracker.state))
                start = time.perf_counter()
                estimate = tracker.step(frame)
                timing.ms.append(1000 * (time.perf_counter() - start))
                writer.append(estimate)
                advance(f"{timing.ms[-1]:.0f} ms{'  LOST' if estimate.lost else ''}")
        except InputError as error:
            kept = f"the {len(writer)} frames before it are kept in the result file (go on with --resume)"
            raise InputError(f"{str(error).rstrip('.')}; {kept}.") from error
    return timing


def resumed(tracker: Tracker, path: Path) -> int:
    """Bring a tracker to the last saved state of a file, if it fits its settings; frames that were tracked by then."""
    saved = read_state(path)
    if saved is None:
        raise InputError(f"{path} holds no state to go on from; track anew without --resume.")
    tracker.state = from_bytes(saved[1], tracker.model)
    return saved[0]
