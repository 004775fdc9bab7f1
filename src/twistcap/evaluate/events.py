"""Events that a user defines by a short expression, such as ``landing = heel_r.z falls below 0.05``.

    NAME = [speed of] SIGNAL rises above NUMBER
    NAME = [speed of] SIGNAL falls below NUMBER
    NAME = [speed of] SIGNAL maximum
    NAME = [speed of] SIGNAL minimum

A signal is a landmark's coordinate in the world (``heel_r.z``, m; z is up), a landmark itself (``heel_r``, only with
``speed of``: how fast it moves) or a joint angle of the exports (``knee_angle_r``, degrees). The speed of a coordinate
or angle has a sign.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from twistcap.arrays import Float, runs
from twistcap.doors.text import brief, finite_number
from twistcap.errors import InputError
from twistcap.evaluate.filters import Filtered
from twistcap.evaluate.gait import frame_rate, places
from twistcap.evaluate.smoothing import butterworth
from twistcap.io.result import Result

Condition = Literal["rises above", "falls below", "maximum", "minimum"]
_FORM = re.compile(
    r"(?P<name>\w+)\s*=\s*(?P<speed>speed\s+of\s+)?(?P<signal>[\w.]+)\s+"
    r"(?:(?P<crosses>rises\s+above|falls\s+below)\s+(?P<level>\S+)|(?P<turns>maximum|minimum))"
)
_SHAPE = "write NAME = [speed of] SIGNAL rises above NUMBER, falls below NUMBER, maximum or minimum"
_AXES = ("x", "y", "z")
_PEAK = 0.3  # least prominence of a maximum, of the whole range of the signal; smaller ones are ripples
_HZ = 6.0  # cutoff of landmarks, as for heel strikes


@dataclass(frozen=True)
class Event:
    """What an expression asks for; `level` (m, degrees, or these per second) belongs to the two crossings."""

    name: str
    signal: str
    speed: bool
    condition: Condition
    level: float = 0.0


def parsed_event(text: str) -> Event:
    """An event of its expression. Raises InputError for one that is not of the form above."""
    found = _FORM.fullmatch(text.strip())
    if found is None:
        raise InputError(f"the event {brief(text)} cannot be read; {_SHAPE}.")
    crosses = found["crosses"]
    condition = " ".join(crosses.split()) if crosses else found["turns"]
    level = finite_number(found["level"], f"the event {found['name']!r}") if crosses else 0.0
    return Event(found["name"], found["signal"], bool(found["speed"]), cast("Condition", condition), level)


def event_times(event: Event, result: Result, angles: Filtered) -> Float:
    """Times (E,) s at which an event happens, between frames where it crosses a level.

    Landmarks are filtered below 6 Hz, `angles` are given as filtered. Nothing happens in frames that are lost or
    unseen, or across them. Raises InputError for a signal that there is not.
    """
    signal = _signal(event, result, angles)
    known = signal[np.isfinite(signal)]
    span = float(np.ptp(known)) if len(known) else 0.0
    found = [_within(event, result.times[a:b], signal[a:b], span) for a, b in runs(np.isfinite(signal))]
    return np.concatenate([np.zeros(0), *found])


def _signal(event: Event, result: Result, angles: Filtered) -> Float:
    """(N,) the signal of an event, NaN where it is not known."""
    point, dot, axis = event.signal.partition(".")
    if point in result.body.landmarks.names:
        return _of_landmark(event, result, point, axis if dot else None)
    if event.signal not in angles.table.names or not angles.table.turning[angles.table.names.index(event.signal)]:
        raise InputError(
            f"the event {event.name!r}: there is no {brief(event.signal)}; name a landmark, as in heel_r.z, or a joint "
            "angle of the exports, as in knee_angle_r."
        )
    values = angles.values[:, angles.table.names.index(event.signal)]
    return _speed(values, result) if event.speed else values


def _of_landmark(event: Event, result: Result, point: str, axis: str | None) -> Float:
    place = butterworth(places(result.body, result.poses, point), frame_rate(result.times), _HZ, result.known)
    if axis is None and event.speed:
        return np.linalg.norm(_speed(place, result), axis=1)
    if axis not in _AXES:
        mend = f"write {point}.x, {point}.y or {point}.z, or speed of {point}"
        raise InputError(f"the event {event.name!r}: {event.signal} is no number; {mend}.")
    values = place[:, _AXES.index(axis)]
    return _speed(values, result) if event.speed else values


def _speed(values: Float, result: Result) -> Float:
    return np.gradient(values, result.times, axis=0)


def _within(event: Event, times: Float, signal: Float, span: float) -> Float:
    """Times in one run of known frames; `span` is the range of the signal in all."""
    from scipy.signal import find_peaks  # slow to import

    if event.condition in ("maximum", "minimum"):
        upward = signal if event.condition == "maximum" else -signal
        peaks, _ = find_peaks(upward, prominence=_PEAK * span) if span else (np.zeros(0, np.int64), {})
        return times[peaks]
    beyond = (signal - event.level) * (1.0 if event.condition == "rises above" else -1.0)
    k = np.flatnonzero((beyond[:-1] < 0) & (beyond[1:] >= 0))
    return times[k] + beyond[k] / (beyond[k] - beyond[k + 1]) * (times[k + 1] - times[k])
