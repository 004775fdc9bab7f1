"""Clocks of cameras: when each image was taken, and which images of a camera belong to the time of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twistcap.arrays import Float
from twistcap.errors import InputError
from twistcap.io.sources import ImageSource, VideoSource

_IN_STEP = 0.02  # frame intervals by which cameras may differ and still be paired by number
_ALONE = 0.02  # fraction of the way between two images at which the nearer one stands for the time
_GAP = 1.6  # image intervals; images farther apart show nothing of the time between them
_SAME_RATE = 0.1  # relative difference of frame rates below which cameras count as equally fast
RATE = 60.0
"""Frames per second where neither a video nor the session says."""


@dataclass(frozen=True)
class Clock:
    """How a camera's own time t becomes the recording's, ``rate t + offset`` (s); t is 0 at its first image.

    `fps` replaces the time stamps of its video.
    """

    offset: float = 0.0
    rate: float = 1.0
    fps: float | None = None


@dataclass(frozen=True)
class Between:
    """Numbers of two images of a camera, and the fraction of the way from the first to the second; 0 is the first."""

    first: int
    second: int
    fraction: float

    @property
    def nearest(self) -> int:
        return self.first if self.fraction <= 0.5 else self.second


def image_times(source: VideoSource | ImageSource, clock: Clock, fps: float | None) -> Float:
    """(N,) s at which the images of a camera were taken, on the recording's clock. `fps` is the session's."""
    said = clock.fps or fps
    stamps = source.times if said is None else None
    own = np.arange(len(source)) / (said or source.fps or RATE) if stamps is None else stamps
    return own if clock == Clock(fps=clock.fps) else clock.rate * own + clock.offset


@dataclass(frozen=True)
class Timeline:
    """When each image of each camera was taken.

    Attributes:
        times: for each camera (N,) s on the recording's clock, rising.
    """

    times: tuple[Float, ...]

    @cached_property
    def intervals(self) -> tuple[float, ...]:
        """s from one image to the next, the median of each camera."""
        return tuple(float(np.median(np.diff(times))) if len(times) > 1 else 1.0 / RATE for times in self.times)

    @cached_property
    def reference(self) -> int:
        """The camera whose images are the frames: the first of the slowest."""
        slowest = max(self.intervals)
        return next(c for c, gap in enumerate(self.intervals) if gap >= slowest * (1.0 - _SAME_RATE))

    @cached_property
    def in_step(self) -> bool:
        """Whether images of the same number were taken together, so that frames are paired by number."""
        frame = self.times[self.reference]
        counts = [min(len(frame), len(times)) for times in self.times]
        off = [np.abs(times[:n] - frame[:n]).max(initial=0.0) for times, n in zip(self.times, counts, strict=True)]
        return max(off) <= _IN_STEP * self.intervals[self.reference]

    @property
    def together(self) -> range:
        """Frames at whose time every camera was running. Raises InputError where there is none."""
        start, end = (bound(t[at] for t in self.times) for bound, at in ((max, 0), (min, -1)))
        slack, frames = _ALONE * self.intervals[self.reference], self.times[self.reference]
        numbers = np.flatnonzero((frames >= start - slack) & (frames <= end + slack))
        if not len(numbers):
            raise InputError("the videos have no time in common; check the offsets in [clocks], or run twistcap sync.")
        return range(int(numbers[0]), int(numbers[-1]) + 1)

    def images(self, camera: int, numbers: Sequence[int]) -> list[Between | None]:
        """A camera's images at the times of frames; None where it has none near enough."""
        if self.in_step:
            return [Between(k, k, 0.0) if k < len(self.times[camera]) else None for k in numbers]
        return [self._around(camera, float(t)) for t in self.times[self.reference][list(numbers)]]

    def _around(self, camera: int, time: float) -> Between | None:
        times, gap = self.times[camera], self.intervals[camera]
        k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, max(0, len(times) - 2)))
        near = min((k, min(k + 1, len(times) - 1)), key=lambda n: abs(times[n] - time))
        if abs(times[near] - time) <= _ALONE * gap:
            return Between(near, near, 0.0)
        if not times[0] < time < times[-1] or times[k + 1] - times[k] > _GAP * gap:
            return None
        return Between(k, k + 1, float((time - times[k]) / (times[k + 1] - times[k])))
