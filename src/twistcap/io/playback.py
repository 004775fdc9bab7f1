"""The motion of a result as programs of animation play it, with the flag of its frames.

GLB has a key for each frame, at its time. BVH has lines at an even rate, so that the poses of other clocks are
interpolated. Neither has empty frames: `Playback.flags` says which are predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray, Bool, Float, even_clock, runs
from twistcap.body import Pose
from twistcap.errors import check
from twistcap.io.result import Result
from twistcap.motion.clip import interpolated_angles, interpolated_roots

_ALONE_HZ = 60.0  # rate of a result of one frame, which has none
_UNEVEN = 0.02  # of a frame by which times may be off an even clock, whose poses are then taken as they are


@dataclass(frozen=True)
class Playback:
    """Poses at `times` (T,) s from the first; `known` (T,) ones, which are neither lost nor predicted without images.

    `start` is the recording's time (s) of the first.
    """

    start: float
    times: Float
    poses: tuple[Pose, ...]
    known: Bool

    @property
    def rate(self) -> float:
        """Frames per second; dropped frames do not count."""
        return even_clock(self.times)[0] if len(self.times) > 1 else _ALONE_HZ

    @property
    def flags(self) -> dict[str, Any]:
        """For JSON: rate, number of frames, time of the first, and first and last of each span that is not known."""
        lost = [[first, end - 1] for first, end in runs(~self.known)]
        return {"fps": round(self.rate, 6), "frames": len(self.times), "start_s": self.start, "lost": lost}

    def even(self, fps: float | None = None) -> Playback:
        """The same motion at an even rate (1/s), by default its own. A pose is known where both neighbours are, and no
        frame was dropped between them.

        Raises InputError for a rate that is not positive.
        """
        rate = self.rate if fps is None else fps
        check("export: fps", np.isfinite(rate) and rate > 0, f"it is {rate}; it must be positive")
        times = np.arange(int(np.floor(self.times[-1] * rate + _UNEVEN)) + 1) / rate
        if len(times) == len(self.times) and np.abs(times - self.times).max() * rate < _UNEVEN:
            return Playback(self.start, times, self.poses, self.known)
        at = np.interp(times, self.times, np.arange(len(self.times)))
        roots = interpolated_roots(np.array([pose.root for pose in self.poses]), at)
        q = interpolated_angles(np.array([pose.q for pose in self.poses]), at)
        known = np.interp(times, self.times, self.known.astype(float)) > 1.0 - 1e-9
        on = np.abs(times - self.times[np.round(at).astype(int)]) * self.rate < _UNEVEN
        known &= on | self._whole_after(np.floor(at).astype(int))
        return Playback(self.start, times, tuple(Pose(*both) for both in zip(roots, q, strict=True)), known)

    def _whole_after(self, n: AnyArray) -> Bool:
        """Whether no frame was dropped between pose n and the next."""
        ticks = even_clock(self.times)[1] if len(self.times) > 1 else np.zeros(1)
        return np.append(np.diff(ticks) == 1, True)[n]


def playback(result: Result) -> Playback:
    """The motion of a result of one frame or more."""
    start = float(result.times[0])
    return Playback(start, result.times - start, result.poses, result.known)
