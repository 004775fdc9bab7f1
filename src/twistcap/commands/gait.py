"""``twistcap gait``: events, strides and cycles of a walk."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from twistcap.commands import terminal

if TYPE_CHECKING:
    from twistcap.evaluate.gait import Gait, Measure
    from twistcap.io.coordinates import Angles


def gait(
    result: Annotated[Path, typer.Argument(help="result.h5 of a track.", metavar="RESULT")],
    out: Annotated[Path | None, typer.Option(help="Folder to write to. Default: beside the result.")] = None,
    cutoff: Annotated[float, typer.Option(help="Hz; angles are filtered (Butterworth, zero lag) below it.")] = 6.0,
    angles: Annotated[str, typer.Option(help="Definition of joint angles: opensim, isb.")] = "opensim",
    frames: Annotated[str | None, typer.Option(help="Frames FIRST:LAST, both included. Default: all.")] = None,
    json: terminal.Json = False,
) -> None:
    """Find heel strikes, toe-offs and strides of a walk; time, length and joint angles over 0 to 100 % of the cycle.

    Writes gait.csv (parameters), strides.csv, cycles.csv (mean and standard deviation) and cycles.png. Angles of the
    pelvis are those of a walk along x, whatever its heading.

    Examples:

      twistcap gait out/result.h5

      twistcap gait out/result.h5 --angles isb --frames 60:400 --json
    """
    from twistcap.evaluate.gait import symmetry
    from twistcap.io.result import read_result

    read, wanted = read_result(result), terminal.frame_range(frames)
    read = read.within(*wanted) if wanted else read
    folder = terminal.output_folder(out or result.parent)
    found, measures, files = run_gait(read, folder, cutoff, cast("Angles", angles))
    if json:
        shown = {side: {name: vars(m) for name, m in values.items()} for side, values in measures.items()}
        about = {
            "strikes": dict(found.strikes),
            "toe_offs": dict(found.toe_offs),
            "symmetry_percent": symmetry(measures),
        }
        terminal.emit({"id": "gait", "parameters": shown, **about, "cutoff_hz": cutoff, "files": files})
        return
    _show(str(result), measures)
    for path in files:
        typer.echo(path)


def run_gait(read: Any, folder: Path, cutoff: float, angles: Angles) -> tuple[Gait, Any, list[Path]]:
    """Measure the walk of a result: its gait, the parameters by side, and the files in the folder."""
    from twistcap.evaluate.gait import gait_of, parameters

    found = gait_of(read.body, read.times, read.poses, read.covariances, read.known)
    measures = parameters(found)
    files = _write_tables(folder, found, measures)
    return found, measures, files + _write_cycles(folder, found, read, cutoff, angles)


def _write_tables(folder: Path, found: Gait, measures: dict[str, dict[str, Measure]]) -> list[Path]:
    from twistcap.evaluate.gait import UNITS

    rows = [
        [side, name, UNITS[name], *(f"{v:.5f}" for v in (m.mean, m.deviation, m.sigma)), m.count]
        for side, values in measures.items()
        for name, m in values.items()
    ]
    head = ["side", "parameter", "unit", "mean", "standard_deviation", "standard_error_by_covariance", "strides"]
    names = list(vars(found.strides[0])) if found.strides else ["side"]
    strides = [
        [value if isinstance(value, str) else f"{value:.5f}" for value in vars(s).values()] for s in found.strides
    ]
    return [_table(folder / "gait.csv", head, rows), _table(folder / "strides.csv", names, strides)]


def _write_cycles(folder: Path, found: Gait, read: Any, cutoff: float, angles: Angles) -> list[Path]:
    from twistcap.evaluate.cycles import cycles_of
    from twistcap.evaluate.gait import PERCENT
    from twistcap.report.plots import cycle_plot

    curves = cycles_of(found, read, cutoff, angles)
    rows = [
        [c.side, f"{p:.0f}", c.coordinate, f"{m:.4f}", f"{s:.4f}", c.strides]
        for c in curves.values()
        for p, m, s in zip(PERCENT, c.mean, c.deviation, strict=True)
    ]
    drawn = {name: (c.mean, c.deviation) for name, c in curves.items()}
    files = [_table(folder / "cycles.csv", ["side", "percent", "coordinate", "mean_deg", "sd_deg", "strides"], rows)]
    return [*files, cycle_plot(folder / "cycles.png", drawn)] if drawn else files


def _table(path: Path, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Path:
    from twistcap.io.files import replacing

    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)
    return path


def _show(title: str, measures: dict[str, dict[str, Measure]]) -> None:
    from twistcap.evaluate.gait import UNITS, symmetry

    uneven = symmetry(measures)
    rows = list[list[str]]()
    for name, m in measures["both"].items():
        sides = [f"{measures[side][name].mean:.3g}" for side in ("r", "l")]
        index = f"{uneven[name]:.1f}" if name in uneven else "–"
        rows.append([f"{name}, {UNITS[name]}", *sides, f"{m.mean:.3g} ± {m.deviation:.2g}", f"{m.sigma:.1g}", index])
    counts = " and ".join(str(measures[side]["stride time"].count) for side in ("r", "l"))
    columns = ["", "right", "left", "both ± SD", "σ", "r − l, %"]
    terminal.show_table(f"{title}: {counts} strides right and left", columns, rows)
