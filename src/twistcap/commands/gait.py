"""``twistcap gait``: events, strides and cycles of a walk."""

from __future__ import annotations

from collections.abc import Mapping
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from twistcap.commands import terminal
from twistcap.commands.terminal import number

if TYPE_CHECKING:
    from twistcap.commands.gait_files import Measured
    from twistcap.evaluate.filters import Kind
    from twistcap.evaluate.gait import Measure
    from twistcap.io.coordinates import Angles
    from twistcap.io.result import Result


def gait(
    result: terminal.ResultFile,
    out: Annotated[Path | None, typer.Option(help="Folder to write to. Default: beside the result.")] = None,
    filter_: Annotated[str, typer.Option("--filter", help="Of angles: butterworth, smoother.")] = "butterworth",
    cutoff: Annotated[
        float | None, typer.Option(help="Hz, of the Butterworth filter. Default: by spectrum and covariance.")
    ] = None,
    angles: Annotated[str, typer.Option(help="Definition of joint angles: opensim, isb.")] = "opensim",
    frames: terminal.Frames = None,
    norms: Annotated[Path | None, typer.Option(help="JSON of published bands, drawn behind the cycles.")] = None,
    norms_speed: Annotated[str, typer.Option(help="Which speed of these bands.")] = "Free",
    event: Annotated[
        list[str] | None, typer.Option(metavar="NAME = …", help="An event of your own; may be given more than once.")
    ] = None,
    cycles: Annotated[str | None, typer.Option(metavar="EVENT", help="Cycles go from this event to the next.")] = None,
    json: terminal.Json = False,
) -> None:
    """Find heel strikes, toe-offs and strides of a walk; time, length and joint angles over 0 to 100 % of the cycle.

    Writes events.csv, gait.csv (parameters), strides.csv, cycles.csv (mean, standard deviation, σ) and cycles.png.
    Angles of the pelvis are those of a walk along x, whatever its heading.

    An event is NAME = SIGNAL rises above NUMBER, falls below NUMBER, maximum or minimum. A signal is a landmark's x, y
    or z in m (heel_r.z), or a joint angle in degrees (knee_angle_r). With speed of before it, it is its speed.

    Examples:

      twistcap gait out/result.h5

      twistcap gait out/result.h5 --angles isb --frames 60:400 --json

      twistcap gait out/result.h5 --event "landing = heel_r.z falls below 0.05" --cycles landing
    """
    from twistcap.commands.gait_files import Wishes, angle_sigmas, run_gait
    from twistcap.evaluate.events import parsed_event
    from twistcap.evaluate.filters import Filter
    from twistcap.io.norms import read_norms
    from twistcap.report.verdict import TURNS, graded

    wanted = tuple(parsed_event(text) for text in event or [])
    bands = read_norms(norms, norms_speed) if norms else {}
    wishes = Wishes(Filter(cast("Kind", filter_), cutoff), cast("Angles", angles), bands, wanted, cycles)
    read = terminal.tracked(result, frames)
    found = run_gait(read, terminal.output_folder(out or result.parent), wishes)
    if json:
        _emit(found)
        return
    if found.gait.strides:
        _show(str(result), found.parameters)
    else:
        typer.echo(_why_none(read))
    if found.cycles:
        for sentence in (found.filter, *(statement.text for statement in graded(angle_sigmas(found.cycles))), TURNS):
            typer.echo(sentence)
    for name in (one.name for one in wanted):
        typer.echo(f"{name}: {', '.join(f'{time:.3f}' for time in found.events[name]) or 'never'} s")
    for path in found.files:
        typer.echo(path)


def _why_none(read: Result) -> str:
    """That no stride was found, why, and what to do."""
    from twistcap.arrays import runs
    from twistcap.report.words import in_spans

    none = f"No stride was found in {len(read)} frames ({read.times[-1] - read.times[0]:.1f} s)"
    if read.known.all():
        return f"{none}; film two steps of each foot, or give --event and --cycles."
    longest = max((read.times[b - 1] - read.times[a] for a, b in runs(read.known)), default=0.0)
    unknown = f"{int((~read.known).sum())} of them are lost or unseen: {in_spans(read.indices, ~read.known)}"
    return (
        f"{none}; {unknown}. Strides with such frames are left out, and the longest part without them has "
        f"{longest:.1f} s. A stride needs two steps of each foot that the cameras see."
    )


def _emit(found: Measured) -> None:
    from twistcap.evaluate.gait import symmetry
    from twistcap.report.verdict import grade_of

    gait = found.gait
    shown = {side: {name: vars(m) for name, m in values.items()} for side, values in found.parameters.items()}
    terminal.emit({
        "id": "gait",
        "parameters": shown,
        "strikes": dict(gait.strikes), "toe_offs": dict(gait.toe_offs), "events": dict(found.events),
        "symmetry_percent": symmetry(found.parameters), "filter": found.filter, "cutoff_hz": found.cutoffs,
        "sigma_deg": found.sigmas, "reliable": {name: grade_of(sigma) for name, sigma in found.sigmas.items()},
        "files": list(found.files),
    })  # fmt: skip


def _show(title: str, measures: Mapping[str, Mapping[str, Measure]]) -> None:
    from twistcap.evaluate.gait import UNITS, symmetry

    uneven = symmetry(measures)
    rows = list[list[str]]()
    for name, m in measures["both"].items():
        sides = [number(measures[side][name].mean, ".3g") for side in ("r", "l")]
        both = f"{number(m.mean, '.3g')} ± {number(m.deviation, '.2g')}"
        last = number(m.sigma, ".1g"), number(uneven.get(name, nan), ".1f")
        rows.append([f"{name}, {UNITS[name]}", *sides, both, *last])
    counts = " and ".join(str(measures[side]["stride time"].count) for side in ("r", "l"))
    columns = ["", "right", "left", "both ± SD", "σ", "r − l, %"]
    terminal.show_table(f"{title}: {counts} strides right and left", columns, rows)
