"""Pictures of an experiment: the error of every arm over the frames, and what each arm made of one image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reproduce.arms import Experiment, Findings, Shot, Trace
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
        _shot(figure.add_subplot(grid[1, column]), next(t.shot for t in findings.traces if t.arm == arm))
    figure.savefig(path, dpi=110)
    return Path(path)


def seed_picture(path: Path | str, experiment: Experiment, findings: Findings, seed: int) -> Path:
    """Write a PNG of one seed: the image under each arm with the true outline, and below it what is watched, over time.

    Where nothing is watched, the arms' errors are drawn.
    """
    traces = [trace for trace in findings.traces if trace.seed == seed]
    figure = Figure(figsize=(4.2 * max(2, len(traces)), 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, len(traces), height_ratios=(1.1, 1.0))
    for column, trace in enumerate(traces):
        _shot(figure.add_subplot(grid[0, column]), trace.shot)
    axis = figure.add_subplot(grid[1, :])
    _courses(axis, traces, findings)
    axis.set_title(f"{experiment.id}, seed {seed}", loc="left", fontsize=9)
    figure.savefig(path, dpi=110)
    return Path(path)


def _shot(axis: Axes, shot: Shot) -> None:
    axis.imshow(draw_overlay(shot.image, shot.camera, shot.posed, opacity=0.3))
    axis.contour(shot.truth, levels=[0.5], colors="white", linewidths=0.8)
    axis.set_axis_off()
    axis.set_title(f"{shot.title}; white: true outline", fontsize=9)


def _courses(axis: Axes, traces: Sequence[Trace], findings: Findings) -> None:
    for trace, colour in zip(traces, _COLOURS, strict=False):
        frames = [e.index for e in trace.estimates]
        values = trace.errors if trace.course is None else trace.course
        axis.plot(frames, values, color=colour, lw=1.6, label=f"{trace.arm}{', lost' if trace.lost else ''}")
    truth = traces[0].true_course
    if truth is not None:
        axis.plot([e.index for e in traces[0].estimates], truth, "k--", lw=1.2, label="truth")
    _span(axis, findings)
    axis.set(xlabel="frame", ylabel=findings.watched or findings.quantity)
    axis.grid(alpha=0.3)
    axis.legend(frameon=False)


def _span(axis: Axes, findings: Findings) -> None:
    if findings.span is not None:
        first, last = findings.span
        axis.axvspan(first - 0.5, last + 0.5, color="#9aa3ad", alpha=0.25, lw=0)


def _curves(axis: Axes, arms: Sequence[str], findings: Findings) -> None:
    for arm, colour in zip(arms, _COLOURS, strict=False):
        for n, trace in enumerate(t for t in findings.traces if t.arm == arm):
            frames = [e.index for e in trace.estimates]
            axis.plot(frames, trace.errors, color=colour, lw=1.2, alpha=0.75, label=arm if n == 0 else None)
    _span(axis, findings)
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
