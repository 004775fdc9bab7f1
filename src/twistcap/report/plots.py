"""Plots of joint angles with their uncertainty, and of joint position errors, as PNG files."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from twistcap.arrays import AnyArray, Bool, Float, runs
from twistcap.body.model import split_side
from twistcap.evaluate.metrics import percentile_known
from twistcap.io.files import replacing
from twistcap.io.norms import PERCENT

_COLOURS = {"r": "#e8790c", "l": "#1780d6", "": "#3d8f6d"}
_DARK = {"r": "#6e3500", "l": "#0a3a66", "": "#16452f"}
_SIDES = {"r": "right", "l": "left", "": "middle"}
_LEAST_SPAN_DEG = 10.0
_COLUMNS = 360  # of pixels in a panel, about
_PANEL = (3.2, 1.9)  # inches of a panel with its labels and title
_LABELS, _TITLE, _BELOW = 0.45, 0.32, 0.25  # inches of these, and from a panel down to the label at its foot
_HEAD, _LEGEND, _FOOT = 0.25, 0.28, 0.4  # inches of the figure's title, a legend below it, and the labels at the foot
_WIDE = 3  # columns from which on the legend is beside the title
_LOST, _DROPPED, _NORM = "#e5484d", "#9aa3ad", "#aab2bd"

literal = rc_context({"text.parse_math": False})
"""Decorates what draws names of cameras and joints, which may have dollar signs; between two would be a formula."""


@dataclass(frozen=True)
class AngleSeries:
    """Joint angles over time."""

    times: Float  # (N,) s
    names: tuple[str, ...]  # J coordinates
    angles: Float  # (N, J) rad, NaN where there is none
    sigma: Float | None = None  # (N, J) standard deviations, rad; None where they are not known


@literal
def angle_plot(
    path: Path | str, estimate: AngleSeries, truth: AngleSeries | None = None, lost: Bool | None = None,
    dropped: Bool | None = None, title: str = "",
) -> Path:  # fmt: skip
    """A PNG of small multiples of joint angles, right and left in one panel, with bands of ± 2σ. The truth is drawn
    dashed, on its own times; `lost` and `dropped` (N,) are frames to shade red and grey. The panels are as high as the
    other frames need: a band may be whole turns wide where the body is lost."""
    names = estimate.names
    every = [flags for flags in (lost, dropped, np.zeros(len(estimate.times))) if flags is not None]
    unknown = np.asarray(np.any(every, axis=0), np.bool_)
    drawn = [(estimate, ~unknown), *([] if truth is None else [(truth, np.isfinite(truth.times))])]
    figure, panels = _grid(names, title, np.concatenate([series.times for series, _ in drawn]))
    for panel, axis in panels.items():
        own = [name for name in names if split_side(name)[0] == panel]
        _fit_height(axis, drawn, own)
        for flags, colour in ((lost, _LOST), (dropped, _DROPPED)):
            for start, end in spans(estimate.times, flags) if flags is not None else ():
                axis.axvspan(start, end, color=colour, alpha=0.22, lw=0, zorder=0)
        for name in own:
            _draw_angle(axis, estimate, name, unknown)
            if truth is not None and name in truth.names:
                colour = _DARK[split_side(name)[1]]
                values = np.degrees(truth.angles[:, truth.names.index(name)])
                axis.plot(truth.times, values, "--", color=colour, lw=1.1, dashes=(4, 2.5), zorder=4)
        _finish_angles(axis, panel)
    more: list[Line2D | Patch] = []
    if estimate.sigma is not None:
        more.append(Patch(color="#777777", alpha=0.25, label="± 2σ"))
    if truth is not None:
        more.append(Line2D([], [], color="#333333", ls="--", label="reference"))
    for flags, colour, label in ((lost, _LOST, "lost"), (dropped, _DROPPED, "dropped")):
        if flags is not None and np.any(flags):
            more.append(Patch(color=colour, alpha=0.3, label=label))
    return _saved(path, figure, names, more)


def _draw_angle(axis: Axes, series: AngleSeries, name: str, unknown: Bool) -> None:
    """The curve and its band, as tall in each column of pixels as its frames are. In frames (N,) of which nothing is
    known the curve is dotted, without a band: it would hide how they are shaded."""
    colour, (values, band) = _COLOURS[split_side(name)[1]], _in_degrees(series, name)
    known, guessed = np.where(unknown, np.nan, values), np.where(unknown, values, np.nan)
    if series.sigma is not None:
        edges = envelope(series.times, known - band, known + band)
        axis.fill_between(*edges, color=colour, alpha=0.3, lw=0, zorder=2)
    axis.fill_between(*envelope(series.times, known, known), color=colour, alpha=0.75, lw=1.2, zorder=3)
    axis.plot(series.times, guessed, ":", color=colour, lw=0.9, zorder=3)


def _in_degrees(series: AngleSeries, name: str) -> tuple[Float, Float]:
    """An angle and 2σ (N,)."""
    k = series.names.index(name)
    values = np.degrees(series.angles[:, k])
    return values, np.zeros_like(values) if series.sigma is None else 2 * np.degrees(series.sigma[:, k])


def _fit_height(axis: Axes, drawn: Sequence[tuple[AngleSeries, Bool]], names: Sequence[str]) -> None:
    """The axis as high as some angles and their bands, in the frames (N,) given with each series."""
    curves = [
        np.concatenate([values - band, values + band])[np.tile(rows, 2)]
        for series, rows in drawn
        for values, band in (_in_degrees(series, name) for name in names if name in series.names)
    ]
    heights = np.concatenate(curves)
    heights = heights[np.isfinite(heights)]
    if len(heights):
        pad = max(0.05 * float(np.ptp(heights)), 0.5)  # an angle that never changes has a height too
        axis.set_ylim(float(heights.min()) - pad, float(heights.max()) + pad)


def envelope(times: Float, low: Float, high: Float, columns: int = _COLUMNS) -> tuple[Float, Float, Float]:
    """First time, lowest `low` and highest `high` (N,) of each column of an axis; NaN only where all of it is NaN."""
    column = np.floor((times - times[0]) / max(np.ptp(times), 1e-9) * columns)
    starts = np.flatnonzero(np.diff(column, prepend=-1.0))
    return times[starts], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def _finish_angles(axis: Axes, panel: str) -> None:
    """Title of a panel, at least 10° high, so that a very small motion does not fill it."""
    low, high = axis.get_ylim()
    extra = max(0.0, _LEAST_SPAN_DEG - (high - low)) / 2
    axis.set_ylim(low - extra, high + extra)
    _titled(axis, f"{panel.replace('_', ' ')} (°)")


def _titled(axis: Axes, text: str) -> None:
    """The height is given: else it is found anew in each drawing, from all the labels of the axis."""
    axis.set_title(text, loc="left", y=1.02, fontsize=9, fontweight="bold")


@literal
def cycle_plot(
    path: Path | str, curves: Mapping[str, tuple[Float, Float]], norms: Mapping[str, tuple[Float, Float]] | None = None,
    title: str = "Gait cycles: mean ± standard deviation", unsure: Collection[str] = (),
) -> Path:  # fmt: skip
    """Mean and standard deviation (101,) in degrees of coordinates over 0 to 100 % of the cycle, right and left in
    one panel; a coordinate of the middle has a curve over the strides of each side. `norms` are lower and upper edges
    (101,) of published bands, by the name of the panel, drawn grey behind. `unsure` curves are dashed."""
    names, bands = list(curves), norms or {}
    figure, panels = _grid(names, title, PERCENT, "% of the cycle")
    for panel, axis in panels.items():
        if panel in bands:
            axis.fill_between(PERCENT, *bands[panel], color=_NORM, alpha=0.45, lw=0, zorder=1)
        for name in (name for name in names if split_side(name)[0] == panel):
            (mean, sd), colour = curves[name], _COLOURS[split_side(name)[1]]
            axis.fill_between(PERCENT, mean - sd, mean + sd, color=colour, alpha=0.22, lw=0, zorder=2)
            axis.plot(PERCENT, mean, color=colour, lw=1.6, zorder=3, ls="--" if name in unsure else "-")
        _finish_angles(axis, panel)
    shown: list[Line2D | Patch] = []
    if set(panels) & set(bands):
        shown.append(Patch(color=_NORM, alpha=0.45, label="norm ± 1 SD"))
    if set(names) & set(unsure):
        shown.append(Line2D([], [], color="#333333", ls="--", label="not reliable"))
    return _saved(path, figure, names, shown)


@literal
def joint_error_plot(path: Path | str, times: Float, names: Sequence[str], errors_mm: Float) -> Path:
    """Position error of each joint (N, L) in mm over time, one panel per joint; in grey the median of all."""
    figure, panels = _grid(names, "Joint position error (mm)", times)
    top, median = _ceiling(errors_mm), [percentile_known(errors, 50) for errors in errors_mm]
    for panel, axis in panels.items():
        axis.plot(times, median, color="#b9c0c8", lw=1.2, zorder=2)
        for k, name in enumerate(names):
            if split_side(name)[0] == panel:
                axis.plot(times, errors_mm[:, k], color=_COLOURS[split_side(name)[1]], lw=1.5, zorder=3)
        axis.set_ylim(0, top)
        _titled(axis, panel.replace("_", " "))
    return _saved(path, figure, names, [Line2D([], [], color="#b9c0c8", label="median of all joints")])


def _ceiling(errors: Float) -> float:
    """Top of the error axis: the largest error, but at most five times the 90th percentile."""
    known = errors[np.isfinite(errors)]
    if not known.size:
        return 1.0
    return 1.08 * float(min(known.max(), max(5.0 * np.percentile(known, 90), 1.0))) or 1.0


def _grid(names: Sequence[str], title: str, across: Float, along: str = "time (s)") -> tuple[Figure, dict[str, Axes]]:
    """A figure and one panel for both sides of a name, as wide as all values `across`."""
    stems = list(dict.fromkeys(split_side(name)[0] for name in names))
    panels, columns = len(stems), min(4, max(1, math.ceil(math.sqrt(len(stems)))))
    rows = math.ceil(panels / columns)
    head = _HEAD + (_LEGEND if columns < _WIDE else 0.0)
    width, height = _PANEL[0] * columns, _PANEL[1] * rows + head + _FOOT
    figure = Figure(figsize=(width, height), dpi=130)
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, y=1.0 - 0.08 / height, ha="left", va="top", fontsize=12, fontweight="bold")
    # Places and widths are given: finding them would draw all text of all panels several times, a second or more.
    low, high = float(across.min()), float(across.max())
    pad = 0.05 * (high - low) or 0.05
    cells = figure.subplots(
        rows, columns, squeeze=False,
        gridspec_kw={
            "left": _LABELS / width, "right": 1.0 - 0.1 / width, "wspace": _LABELS / (_PANEL[0] - _LABELS),
            "bottom": (_FOOT + 0.05) / height, "top": 1.0 - (head + _TITLE) / height,
            "hspace": _TITLE / (_PANEL[1] - _TITLE),
        },
    ).ravel().tolist()  # fmt: skip
    for k, axis in enumerate(cells):
        axis.set_visible(k < panels)
        axis.set_xlim(low - pad, high + pad)
        for line in (axis.xaxis, axis.yaxis):
            line.set_label_coords(0.5, -_BELOW / (_PANEL[1] - _TITLE))
        axis.grid(True, color="#e6e9ed", lw=0.8)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=8, length=2, color="#9aa3ad", labelbottom=k + columns >= panels)
        axis.spines[["top", "right"]].set_visible(False)
        axis.spines[["left", "bottom"]].set_color("#9aa3ad")
        if k + columns >= panels:
            axis.set_xlabel(along, fontsize=8)
    return figure, dict(zip(stems, cells, strict=False))


def spans(times: Float, flags: AnyArray) -> list[tuple[float, float]]:
    """Stretches of flagged frames, each frame from half way to half way between its neighbours."""
    edges = np.concatenate([times[:1], (times[1:] + times[:-1]) / 2, times[-1:]])
    return [(float(edges[a]), float(edges[b])) for a, b in runs(flags)]


def _saved(path: Path | str, figure: Figure, names: Sequence[str], more: Sequence[Line2D | Patch]) -> Path:
    """The figure in a file, with a legend."""
    sides = dict.fromkeys(split_side(name)[1] for name in names)
    entries = [*(Line2D([], [], color=_COLOURS[s], lw=2, label=_SIDES[s]) for s in sides), *more]
    gridspec = figure.axes[0].get_gridspec()
    below = _LEGEND if gridspec is not None and gridspec.ncols < _WIDE else 0.0
    figure.legend(
        handles=entries, loc="upper right", ncols=len(entries), frameon=False, fontsize=9, borderaxespad=0.1,
        bbox_to_anchor=(1.0, 1.0 - below / figure.get_figheight()), columnspacing=1.2, handlelength=1.6,
    )  # fmt: skip
    with replacing(path) as part:
        figure.savefig(part, facecolor="white")
    return Path(path)
