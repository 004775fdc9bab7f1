"""One picture of an experiment: the error of every arm over the frames, and what each arm made of one image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twistcap.evaluate.experiments import Experiment, Findings
from twistcap.report.overlay import draw_overlay

_COLOURS = ("#e8790c", "#1780d6", "#3d8f6d", "#8a4fbf")


def experiment_picture(path: Path | str, experiment: Experiment, findings: Findings) -> Path:
    """Write a PNG: one line per seed, one colour per arm; below it the same image under each arm, first seed.

    Findings without curves are drawn as bars, one for each row of the first row's unit.
    """
    arms = list(dict.fromkeys(t.arm for t in findings.traces))
    figure = Figure(figsize=(4.2 * max(2, len(arms)), 7.6 if arms else 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, len(arms), height_ratios=(1.0, 1.1)) if arms else figure.add_gridspec(1, 1)
    axis = figure.add_subplot(grid[0, :])
    axis.set_title(f"{experiment.id}: {experiment.says}", loc="left", fontsize=9, wrap=True)
    if arms:
        _curves(axis, arms, findings)
    else:
        _bars(axis, findings)
    for column, arm in enumerate(arms):
        shot = next(t.shot for t in findings.traces if t.arm == arm)
        below = figure.add_subplot(grid[1, column])
        below.imshow(draw_overlay(shot.image, shot.camera, shot.posed))
        below.set_axis_off()
        below.set_title(shot.title, fontsize=9)
    path = Path(path)
    figure.savefig(path, dpi=110)
    return path


def _curves(axis: Axes, arms: Sequence[str], findings: Findings) -> None:
    for arm, colour in zip(arms, _COLOURS, strict=False):
        for n, trace in enumerate(t for t in findings.traces if t.arm == arm):
            frames = [e.index for e in trace.estimates]
            axis.plot(frames, trace.errors, color=colour, lw=1.2, alpha=0.75, label=arm if n == 0 else None)
    axis.set(xlabel="frame", ylabel=findings.quantity, yscale="symlog")
    axis.grid(alpha=0.3)
    axis.legend(frameon=False)


def _bars(axis: Axes, findings: Findings) -> None:
    rows = [r for r in findings.rows if r["unit"] == findings.rows[0]["unit"]]
    values = [r["value"] or 0.0 for r in rows]
    bars = axis.barh([r["metric"] for r in rows], values, color=_COLOURS[1])
    axis.bar_label(bars, [f"{value:,.4g}" for value in values], padding=4, fontsize=9)
    axis.set(xlabel=findings.quantity, xscale="log")
    axis.invert_yaxis()
    axis.margins(x=0.2)
