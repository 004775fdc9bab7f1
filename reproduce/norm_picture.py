"""Hip, knee and ankle of a walk by the phase of its cycle, over the band of normal gait."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reproduce.arms import Trace
from reproduce.measures.gait_norms import FILE, GRID, at_phases, gait_norm
from reproduce.recorded import data_file
from reproduce.scenes.walks import Walk
from twistcap.arrays import Float

JOINTS = ("hip_flexion", "knee_angle", "ankle_angle")


def norm_picture(path: Path, walk: Walk, traces: Sequence[Trace], side: str = "r") -> Path:
    """Write a PNG: every seed's tracked angles, and the mean ± one deviation of children at a free speed."""
    curves = {joint: [(_curve(walk, t, f"{joint}_{side}"), f"seed {t.seed}") for t in traces] for joint in JOINTS}
    return draw_norms(path, curves)


def draw_norms(path: Path, curves: dict[str, list[tuple[Float, str]]]) -> Path:
    """Write a PNG of curves (51,) in degrees by joint, each with its name, over the norms' bands."""
    figure = Figure(figsize=(12.5, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    for axis, (joint, lines) in zip(np.atleast_1d(figure.subplots(1, len(curves))), curves.items(), strict=True):
        band = gait_norm(data_file(FILE), joint)
        axis.fill_between(GRID, band.lower, band.upper, color="#9aa3ad", alpha=0.35, lw=0, label="norm ± 1 SD")
        for curve, name in lines:
            axis.plot(GRID, curve, lw=1.3, label=name)
        axis.set(title=joint.replace("_", " "), xlabel="% of the cycle", ylabel="degrees")
        axis.grid(alpha=0.3)
    figure.axes[0].legend(frameon=False, fontsize=7)
    figure.savefig(path, dpi=110)
    return path


def _curve(walk: Walk, trace: Trace, name: str) -> Float:
    scene = walk.scene(trace.seed)
    names = getattr(trace, "names", ())
    angles = np.degrees([e.pose.q[names.index(name)] for e in trace.estimates])
    return at_phases(angles, walk.phases(scene)[1 : 1 + len(angles)])
