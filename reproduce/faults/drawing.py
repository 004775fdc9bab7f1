"""Pictures of the bench: flag against truth over time, and the reliability of the probability of being lost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from reproduce.faults.measures import BINS, reliability
from reproduce.faults.runs import Run
from twistcap.arrays import Int

_STATES = (
    ("right", "#d9ead3"),
    ("flagged though right", "#e8a33d"),
    ("lost and flagged", "#4a78b5"),
    ("lost and not flagged", "#c0392b"),
    ("nobody in the images", "#c8ccd1"),
    ("nobody, not flagged", "#6d747c"),
    ("", "#ffffff"),
)
_END = len(_STATES) - 1


def states(run: Run) -> Int:
    """(N,) number in the legend of each frame's state."""
    lost, flagged = run.truly_lost, run.flagged
    here = np.where(lost, np.where(flagged, 2, 3), flagged.astype(int))
    return np.where(run.absent, np.where(flagged, 4, 5), here).astype(np.int32)


def course_picture(path: Path, runs: Sequence[Run]) -> Path:
    """Write a PNG: a line for each run, a colour for each frame's state, black marks at the ends of the fault."""
    ordered = sorted(runs, key=lambda r: ([k.kind for k in runs].index(r.kind), r.seed))
    grid = np.full((len(ordered), max(len(r.lost) for r in ordered)), _END)
    for line, run in zip(grid, ordered, strict=True):
        line[: len(run.lost)] = states(run)
    figure = Figure(figsize=(12, 1.4 + 0.2 * len(ordered)), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.add_subplot()
    axis.imshow(
        grid, ListedColormap([c for _, c in _STATES]), vmin=0, vmax=_END, aspect="auto", interpolation="nearest"
    )
    for k, run in enumerate(ordered):
        for end in run.span if run.kind != "clean" else ():
            if end is not None:
                axis.plot([end, end], [k - 0.45, k + 0.45], "k-", lw=1.2)
    labels = [f"{r.kind}, {r.motion}, {r.views} views, {r.fps:g} fps ({r.seed})" for r in ordered]
    axis.set_yticks(range(len(ordered)), labels, fontsize=7)
    axis.set_xlabel("frame")
    patches = [Patch(color=colour, label=name) for name, colour in _STATES[:_END]]
    figure.legend(handles=patches, loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)
    return path


def error_picture(path: Path, runs: Sequence[Run]) -> Path:
    """Write a PNG: for the first run of each kind its largest joint error, with flagged frames shaded."""
    first = list({r.kind: r for r in reversed(runs)}.values())[::-1]
    columns = 3
    figure = Figure(figsize=(13, 1.9 * -(-len(first) // columns)), layout="constrained")
    FigureCanvasAgg(figure)
    for k, run in enumerate(first):
        axis, frames = figure.add_subplot(-(-len(first) // columns), columns, k + 1), np.arange(len(run.lost))
        axis.plot(frames, np.clip(run.error_mm, 1.0, 1e4), color="#1780d6", lw=1.3)
        axis.fill_between(frames, 1.0, 1e4, where=run.flagged.tolist(), color="#c0392b", alpha=0.18, lw=0, step="mid")
        axis.axhline(150.0, color="k", lw=0.6, ls=":")
        for end in run.span:
            if end is not None and run.kind != "clean":
                axis.axvline(end, color="k", lw=0.8)
        axis.set(yscale="log", ylim=(1.0, 1e4))
        axis.set_title(f"{run.kind} ({run.seed}): mm, red: flagged", fontsize=8, loc="left")
        axis.tick_params(labelsize=7)
    figure.savefig(path, dpi=110)
    return path


def reliability_picture(path: Path, runs: Sequence[Run]) -> Path:
    """Write a PNG: how often frames of a claimed probability of being lost were lost, and how many there are."""
    claimed, found, count = reliability(runs)
    figure = Figure(figsize=(5, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot([0, 1], [0, 1], "k--", lw=0.8)
    above.plot(claimed, found, "o-", color="#1780d6")
    above.set(ylabel="lost, share", xlim=(0, 1), ylim=(0, 1))
    below.bar((np.arange(BINS) + 0.5) / BINS, count, 0.9 / BINS, color="#9aa3ad")
    below.set(xlabel="claimed probability of being lost", ylabel="frames", yscale="symlog")
    figure.savefig(path, dpi=110)
    return path
