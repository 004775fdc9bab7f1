"""The loop that `demo` and `track` share: step, write, tell."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from twistcap.body import Pose
from twistcap.commands.cameras import ELSEWHERE
from twistcap.commands.clocks import suspects, watched_by
from twistcap.commands.terminal import progress, say
from twistcap.errors import InputError, check
from twistcap.estimate import Estimate, Frame
from twistcap.hindsight import Hindsight, Passed
from twistcap.io.result import Result, ResultWriter, read_result, read_state
from twistcap.io.state import from_bytes, to_bytes
from twistcap.report.words import CONTRADICTS, beside_in_words
from twistcap.track import Tracker

_LEFT_OUT, _BELIEVED = f"is left out; it {CONTRADICTS}", "is believed again"
_TURNED, _STANDS = "was bumped, or sways; its pictures are turned back", "stands again as it was calibrated"
_SWAPPED, _OWN = "gives the pictures of another one; they count as those", "gives its own pictures again"
_HERE = "no longer seems to stand elsewhere"
STATE_EVERY = 10
"""Frames from one saved state to the next; what follows the last one is tracked again, and comes out alike."""


@dataclass
class Timing:
    """Milliseconds of the tracker alone, decoding apart, frame by frame; the frames that were corrected later; and the
    first pose that was given for these frames.
    """

    ms: list[float] = field(default_factory=list[float])
    corrected: set[int] = field(default_factory=set[int])
    given: Pose | None = None

    @property
    def median(self) -> float:
        """Without the first frame, which also compiles; NaN where there is none."""
        times = self.ms[1:] or self.ms
        return float(np.median(times)) if times else float("nan")


@dataclass
class Believed:
    """Which cameras are believed, and what is said the first time that this changes for one."""

    names: tuple[str, ...]
    out: frozenset[int] = frozenset()
    said: set[tuple[int, str]] = field(default_factory=set[tuple[int, str]])
    elsewhere: frozenset[int] = frozenset()
    turned: frozenset[int] = frozenset()
    swapped: frozenset[int] = frozenset()

    def news(self, estimate: Estimate, elsewhere: Collection[int] = ()) -> list[str]:
        """Sentences about the cameras that are left out, believed again, turned, swapped, or seem to be elsewhere since
        the last frame.

        `elsewhere` are those that the watch suspects.
        """
        out, suspects = frozenset(estimate.left_out), frozenset(elsewhere)
        changed = [(c, _LEFT_OUT if c in out else _BELIEVED) for c in sorted(self.out ^ out)]
        changed += [(c, ELSEWHERE if c in suspects else _HERE) for c in sorted(self.elsewhere ^ suspects)]
        turned, swapped = frozenset(estimate.turned), frozenset(estimate.swapped)
        changed += [(c, _TURNED if c in turned else _STANDS) for c in sorted(self.turned ^ turned)]
        changed += [(c, _SWAPPED if c in swapped else _OWN) for c in sorted(self.swapped ^ swapped)]
        fresh = [change for change in changed if change not in self.said]
        self.out, self.elsewhere, self.turned, self.swapped = out, suspects, turned, swapped
        self.said.update(fresh)
        return [f"frame {estimate.index}: camera {self.names[c]} {what}" for c, what in fresh]


def follow(
    frames: Iterable[Frame], total: int, tracker: Tracker, writer: ResultWriter, passed: Iterable[Passed] = (),
    given: Pose | None = None,
) -> Timing:  # fmt: skip
    """Track all frames; each is in the file before the next is touched. The InputError of a bad frame says so.

    `passed` are frames that have been tracked before, `given` is the first pose of those that have not.
    """
    timing, hindsight = Timing(given=given), Hindsight(tracker, passed=passed)
    believed = Believed(tracker.model.rig.names)
    with progress("tracking", total) as advance:
        try:
            for frame in frames:
                if len(writer) % STATE_EVERY == 0:
                    writer.save_state(to_bytes(tracker.state))
                start = time.perf_counter()
                corrected, estimate = hindsight.step(frame)
                timing.ms.append(1000 * (time.perf_counter() - start))
                writer.append(estimate)
                if corrected:
                    writer.save_state(to_bytes(tracker.state, corrected))  # a kill from here on corrects them later
                    writer.correct(corrected)
                    timing.corrected.update(e.index for e in corrected)
                beside = beside_in_words(tracker.model.body, given, estimate) if given is not None else []
                given = None
                for sentence in (*beside, *believed.news(estimate, suspects(watched_by(tracker)))):
                    say(sentence)
                advance(f"{timing.ms[-1]:.0f} ms{'  LOST' if estimate.lost else ''}")
            if len(writer):
                writer.save_state(to_bytes(tracker.state))  # a track that is finished has nothing to do again
        except InputError as error:
            if not len(writer):
                raise
            kept = f"the {len(writer)} frames before it are kept in the result file (go on with --resume)"
            raise InputError(f"{str(error).rstrip('.')}; {kept}.") from error
    return timing


def held(path: Path, overwrite: bool = False) -> Result | None:
    """The result that is there and holds frames, if it is not to be overwritten. Raises InputError for a file that
    cannot be read.
    """
    if overwrite or not path.exists():
        return None
    try:
        done = read_result(path)
    except InputError as error:
        raise InputError(f"{str(error).rstrip('.')}; replace it with --overwrite, or choose another --out.") from error
    return done if len(done) else None


def resumed(tracker: Tracker, path: Path) -> tuple[int, tuple[Estimate, ...]]:
    """Bring a tracker to the last saved state of a file, if it fits its settings; frames that were tracked by then, and
    those before the last of them that it corrects, in the file or not.
    """
    saved = read_state(path)
    if saved is None:
        raise InputError(f"{path} holds no state to go on from; track anew without --resume.")
    tracker.state, corrected = from_bytes(saved[1], tracker.model)
    check(str(path), len(corrected) <= max(0, saved[0] - 1), "its stored state is damaged; track anew")
    return saved[0], corrected
