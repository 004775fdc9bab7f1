"""What ``twistcap gait`` measures and writes: events, strides, parameters and cycles of a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from twistcap.arrays import Float
from twistcap.errors import InputError, check
from twistcap.evaluate.cycles import Cycle, cycles_between, cycles_of, walking_angles
from twistcap.evaluate.events import Event, event_times
from twistcap.evaluate.filters import Filter, Filtered, in_words
from twistcap.evaluate.gait import SIDES, UNITS, Gait, Measure, Stride, gait_of, parameters, symmetry
from twistcap.io.coordinates import Angles
from twistcap.io.norms import PERCENT, Band
from twistcap.io.result import Result
from twistcap.io.tidy import write_rows
from twistcap.report.plots import cycle_plot
from twistcap.report.verdict import grade_of, kept_by_most

_END = "\r\n"  # of a line of CSV, as RFC 4180 has it
_STRIKES = tuple(f"heel_strike_{side}" for side in SIDES)


@dataclass(frozen=True)
class Wishes:
    """How a walk is measured; `limits` names the event from which to which cycles go, None for gait's own strides.

    Raises InputError for norms with `limits`: a norm is of a leg from its own heel strike, and limits are one for all.
    """

    how: Filter = field(default_factory=Filter)
    angles: Angles = "opensim"
    norms: Mapping[str, Band] = field(default_factory=dict[str, Band])
    events: tuple[Event, ...] = ()
    limits: str | None = None

    def __post_init__(self) -> None:
        if self.norms and self.limits is not None:
            why = f"and {self.limits} would start the cycles of both legs"
            raise InputError(f"gait norms: they go from each leg's own heel strike, {why}; leave the one or the other.")


@dataclass(frozen=True)
class Measured:
    """Of a walk: its gait, parameters by side, filtered angles, times (s) of events by name, cycles and the files."""

    gait: Gait
    parameters: Mapping[str, Mapping[str, Measure]]
    walk: Filtered
    events: Mapping[str, Float]
    cycles: Mapping[str, Cycle]
    files: tuple[Path, ...]
    filter: str  # a sentence

    @property
    def cutoffs(self) -> dict[str, float]:
        """Hz, by joint angle."""
        return _cutoffs(self.walk)

    @property
    def sigmas(self) -> dict[str, float]:
        """Degrees, by cycle: the σ that most of it keeps."""
        return cycle_sigmas(self.cycles)


def run_gait(read: Result, folder: Path, wishes: Wishes | None = None) -> Measured:
    """Measure the walk of a result, and write its files into the folder. Raises InputError for a body without feet,
    few frames or uneven times, an event that cannot be found, or two of one name."""
    wishes = wishes or Wishes()
    found = gait_of(read.body, read.times, read.poses, read.covariances, read.known)
    walk = walking_angles(found, read, wishes.how, wishes.angles)
    events = _events(found, read, walk, wishes.events)
    curves = _curves(found, read, walk, events, wishes.limits)
    measures = parameters(found)
    tables = [_write_events(folder, read, events), _write_parameters(folder, measures), _write_strides(folder, found)]
    files = [*tables, _write_cycles(folder, curves)]
    if curves:
        title = f"Cycles from {wishes.limits} to {wishes.limits}: mean ± SD" if wishes.limits else None
        files.append(draw_cycles(folder, curves, wishes.norms, title))
    sentence = in_words(wishes.how, _cutoffs(walk))
    return Measured(found, measures, walk, events, curves, tuple(files), sentence)


def draw_cycles(folder: Path, curves: Mapping[str, Cycle], norms: Mapping[str, Band], title: str | None = None) -> Path:
    """``cycles.png``, with published bands where there are some. What is not reliable is dashed."""
    drawn = {name: (c.mean, c.deviation) for name, c in curves.items()}
    bands = {name: (band.lower, band.upper) for name, band in norms.items()}
    unsure = {name for name, sigma in cycle_sigmas(curves).items() if grade_of(sigma) == "no"}
    return cycle_plot(folder / "cycles.png", drawn, bands, *([title] if title else []), unsure=unsure)


def cycle_sigmas(curves: Mapping[str, Cycle]) -> dict[str, float]:
    """Degrees, by the name of the cycle: the σ that most of it keeps."""
    return {name: float(kept_by_most(cycle.sigma)) for name, cycle in curves.items()}


def angle_sigmas(curves: Mapping[str, Cycle]) -> dict[str, float]:
    """The same by angle: those of the trunk, which have a cycle over the strides of each side, once."""
    out = dict[str, float]()
    for name, sigma in cycle_sigmas(curves).items():
        angle = curves[name].coordinate
        out[angle] = max(sigma, out.get(angle, sigma))
    return out


def _cutoffs(walk: Filtered) -> dict[str, float]:
    each = zip(walk.table.names, walk.table.turning, walk.cutoffs, strict=True)
    return {name: float(cutoff) for name, turns, cutoff in each if turns}


def _events(found: Gait, read: Result, walk: Filtered, wanted: Sequence[Event]) -> dict[str, Float]:
    """Times by name: gait's own, and those wanted."""
    out = {name: found.strikes[side] for name, side in zip(_STRIKES, SIDES, strict=True)}
    out |= {f"toe_off_{side}": found.toe_offs[side] for side in SIDES}
    for event in wanted:
        if event.name in out:
            raise InputError(f"there are two events {event.name!r}; give each a name of its own.")
        out[event.name] = event_times(event, read, walk)
    return out


def _curves(
    found: Gait, read: Result, walk: Filtered, events: Mapping[str, Float], limits: str | None
) -> Mapping[str, Cycle]:
    if limits is None:
        return cycles_of(found, read.times, walk)
    check("cycles", limits in events, f"there is no event {limits!r}; there are {', '.join(events)}")
    return cycles_between(events[limits], read.times, walk)


def _write_events(folder: Path, read: Result, events: Mapping[str, Float]) -> Path:
    """In the order of time; the frame is the nearest."""
    each = sorted((float(time), name) for name, times in events.items() for time in times)
    rows = [[name, f"{time:.4f}", int(read.indices[np.argmin(np.abs(read.times - time))])] for time, name in each]
    return write_rows(folder / "events.csv", ["event", "time_s", "frame"], rows, _END)


def _write_parameters(folder: Path, measures: Mapping[str, Mapping[str, Measure]]) -> Path:
    rows = [
        [side, name, UNITS[name], *(_cell(v) for v in (m.mean, m.deviation, m.sigma)), m.count]
        for side, values in measures.items()
        for name, m in values.items()
    ]
    rows += [["symmetry", name, "%", _cell(index), "", "", ""] for name, index in symmetry(measures).items()]
    head = ["side", "parameter", "unit", "mean", "standard_deviation", "standard_error_by_covariance", "strides"]
    return write_rows(folder / "gait.csv", head, rows, _END)


def _write_strides(folder: Path, found: Gait) -> Path:
    names = [one.name for one in fields(Stride)]
    rows = [[value if isinstance(value, str) else _cell(value) for value in vars(s).values()] for s in found.strides]
    return write_rows(folder / "strides.csv", names, rows, _END)


def _write_cycles(folder: Path, curves: Mapping[str, Cycle]) -> Path:
    reliable = {name: grade_of(sigma) for name, sigma in cycle_sigmas(curves).items()}
    rows = [
        [c.side, f"{p:.0f}", c.coordinate, *(_cell(v, 4) for v in (m, d, s)), c.strides, _cell(c.cutoff, 2),
         reliable[name]]
        for name, c in curves.items()
        for p, m, d, s in zip(PERCENT, c.mean, c.deviation, c.sigma, strict=True)
    ]  # fmt: skip
    head = ["side", "percent", "coordinate", "mean_deg", "sd_deg", "sigma_deg", "strides", "cutoff_hz", "reliable"]
    return write_rows(folder / "cycles.csv", head, rows, _END)


def _cell(value: float, digits: int = 5) -> str:
    """A number; empty where there is none, since not every program reads ``nan``."""
    return f"{value:.{digits}f}" if np.isfinite(value) else ""
