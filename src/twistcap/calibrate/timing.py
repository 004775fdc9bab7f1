"""Which frames of cameras show the same moment: by the time at which each was taken, not by its number.

Moments are whole ticks of a common clock; a tick is a frame of the slowest camera. What a frame between two ticks shows
is moved to the nearer one, along the parabolas of its points through this frame and those beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twistcap.arrays import Float
from twistcap.calibrate.sightings import LONE, Sighting
from twistcap.io.clocks import RATE, Clock, Timeline, image_times
from twistcap.io.video import Source

_ALONE = 0.02  # ticks from a moment up to which a frame stands for it though the board's motion is not known
_ALIKE = 1e-4  # relative difference of intervals up to which cameras are equally fast
_EXACT = 1e-6  # ticks; nothing is moved for less


@dataclass(frozen=True)
class Timing:
    """When each camera's frames were taken.

    Attributes:
        times: by camera (F,) s of its own clock, rising.
        shifts: whole ticks by which each camera shows a later moment than its clock says.
    """

    times: tuple[Float, ...]
    shifts: tuple[int, ...]

    @cached_property
    def intervals(self) -> tuple[float, ...]:
        """s from one frame to the next, by camera."""
        return Timeline(self.times).intervals

    @property
    def interval(self) -> float:
        """s of a tick."""
        return max(self.intervals)

    @property
    def alike(self) -> bool:
        """Whether all cameras are equally fast, so that their clocks can be compared in frames."""
        return max(self.intervals) - min(self.intervals) < _ALIKE * min(self.intervals)

    @cached_property
    def _origin(self) -> int:
        """The tick that is moment 0: that of the first camera's first frame, or an earlier one that another shows."""
        return min(0, *(int(np.floor(t[0] / self.interval)) + n for t, n in zip(self.times, self.shifts, strict=True)))

    def moment(self, camera: int, frame: int) -> float:
        """The moment that a frame shows, between whole ones."""
        return float(self.times[camera][frame]) / self.interval + self.shifts[camera] - self._origin

    def frame(self, camera: int, moment: int) -> int | None:
        """The frame nearest to a moment; None where the camera was not running."""
        time, own = (moment + self._origin - self.shifts[camera]) * self.interval, self.times[camera]
        k = int(np.clip(np.searchsorted(own, time), 1, max(1, len(own) - 1)))
        near = min((k - 1, min(k, len(own) - 1)), key=lambda n: abs(own[n] - time))
        return near if abs(own[near] - time) <= 0.51 * self.interval else None

    def later(self, by: Sequence[int]) -> Timing:
        """The same with cameras that show so many ticks later moments."""
        return replace(self, shifts=tuple(n + more for n, more in zip(self.shifts, by, strict=True)))

    def paired(self, sightings: Iterable[Sighting], still: int | None = None) -> list[Sighting]:
        """Sightings of frames as sightings of moments, their motion in px per tick.

        Where two frames of a camera are nearest to one moment, the nearer one is taken. At the moment `still` the board
        lies still. Pictures of one camera alone stay as they are.
        """
        out, off = dict[tuple[int, int], Sighting](), dict[tuple[int, int], float]()
        for s in sightings:
            exact = float(s.moment) if s.moment >= LONE else self.moment(s.camera, s.moment)
            moment = round(exact)
            key, lag = (s.camera, moment), exact - moment
            unknown = s.motion is None and abs(lag) > _ALONE and moment != still
            if not unknown and abs(lag) < off.get(key, np.inf):
                out[key], off[key] = self._at(s, moment, lag), abs(lag)
        return list(out.values())

    def _at(self, s: Sighting, moment: int, lag: float) -> Sighting:
        """What a frame that was taken `lag` ticks after a moment says of it."""
        if s.motion is None or s.moment >= LONE:
            return replace(s, moment=moment)
        ratio = self.interval / self.intervals[s.camera]
        motion = s.motion * np.array([ratio, ratio * ratio])[:, None, None]
        if abs(lag) < _EXACT:
            return replace(s, moment=moment, motion=motion)
        velocity, bend = motion
        pixels = s.pixels - lag * velocity + lag * lag * bend
        return replace(s, moment=moment, pixels=pixels, motion=np.stack([velocity - 2.0 * lag * bend, bend]))


def started_together(sources: Sequence[Source]) -> Timing:
    """Clocks that begin with each recording. Where a source knows no rate, it has that of the others."""
    rate = next((source.fps for source in sources if source.fps), RATE)
    times = [image_times(source, Clock(), None if source.fps else rate) for source in sources]
    if Timeline(tuple(times)).in_step:
        longest = max(times, key=len)
        times = [longest[: len(own)] for own in times]
    return Timing(tuple(times), (0,) * len(times))


def in_step(sightings: Iterable[Sighting], count: int) -> Timing:
    """Clocks of cameras whose frames of one number were taken together."""
    last = max((s.moment for s in sightings if s.moment < LONE), default=0)
    return Timing((np.arange(last + 3) / RATE,) * count, (0,) * count)
