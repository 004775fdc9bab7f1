"""B-1: a body that is known wrongly is fitted to one second of a walk, and tracks as well as the true one.

The studio's `mismatch` subjects: girths 4 % too large, a bumpy surface, joint centres 6 mm off, cameras a little wrong.

    python -m reproduce B-1 --seeds 0-7
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.running import Tell, over_seeds
from reproduce.sequence import joint_errors_mm, khe_errors_deg
from twistcap.adjust.body_fit.fit import Take, fit_body
from twistcap.adjust.first_pose import girth_groups
from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.body.shape import segment_axes
from twistcap.build import build
from twistcap.estimate import Frame
from twistcap.evaluate.metrics import (
    Row,
    lost_sequence,
    mean_known,
    row,
)
from twistcap.hindsight import tracked
from twistcap.studio import Capture, StudioConfig, capture

BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
GIRTH, LENGTH, KHE = 2.0, 1.0, 0.2  # per cent, per cent, degrees


@dataclass(frozen=True)
class BodyFit:
    """The experiment; see `Experiment`."""

    id: str = "B-1"
    says: str = (
        "a mismatch body fitted to a second of a walk in 4 views, and tracking with it, with the true and the wrong one"
    )

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows alone."""
        del out
        found = over_seeds(fitted_seed, seeds, progress, self.id)
        return Findings(self.rows(found), "error of the body, per cent", ())

    def rows(self, found: Sequence[Mapping[str, float]]) -> list[Row]:
        """Means over the seeds."""
        bars = {"girths, fitted": GIRTH, "lengths, fitted": LENGTH, "KHE, fitted less exact": KHE}
        lost = sum(int(one["lost"]) for one in found)
        lines: list[Row] = []
        for name in (key for key in found[0] if key != "lost"):
            values = [one[name] for one in found]
            unit = "deg" if name.startswith("KHE") else "%"
            lines.append(
                row(self.id, name, float(np.mean(values)), unit, at_most=bars.get(name), seeds=values, lost=lost)
            )
        return lines


def fitted_seed(seed: int) -> dict[str, float]:
    """All measures of one seed; every arm has the same wrong cameras and the same wrong start."""
    scene = capture(StudioConfig(seed=seed, views=4, condition="mismatch"))
    frames = list(scene.frames())
    fit = fit_body(scene.body, [Take(scene.rig, frames, scene.first_pose)])
    out: dict[str, float] = {}
    for name, body in (("fitted", fit.body), ("given", scene.body)):
        girths, lengths = girth_errors(body, scene.true_body), length_errors(body, scene.true_body)
        out |= {f"girths, {name}": float(np.mean(girths)), f"girths, worst kind, {name}": float(np.max(girths))}
        out |= {f"lengths, {name}": float(np.mean(lengths)), f"lengths, worst bone, {name}": float(np.max(lengths))}
    lost = 0
    for name, body in (("exact", scene.true_body), ("given", scene.body), ("fitted", fit.body)):
        out[f"KHE, {name}"], one_lost = _tracked(scene, frames, body)
        lost += one_lost and name == "fitted"
    return out | {"KHE, fitted less exact": out["KHE, fitted"] - out["KHE, exact"], "lost": float(lost)}


def _tracked(scene: Capture, frames: Sequence[Frame], body: Body) -> tuple[float, bool]:
    """KHE, degrees, and whether the sequence was lost."""
    estimates = list(tracked(frames, build(body, scene.rig), scene.first_pose))
    joints = joint_errors_mm(scene, body, [e.pose for e in estimates], [e.index for e in estimates])
    return mean_known(np.abs(khe_errors_deg(scene, body, estimates))), lost_sequence(joints)


def girth_errors(body: Body, truth: Body) -> Float:
    """Per cent, of each kind of segment: the mean distance of its surface from its axis, left and right together."""
    _, axes = segment_axes(truth)

    def radius(of: Body, s: int) -> float:
        own = of.vertices[truth.vertex_part == s]
        across = own - own.mean(axis=0)
        return float(np.linalg.norm(across - np.outer(across @ axes[s], axes[s]), axis=1).mean())

    kinds = girth_groups(truth).values()
    parts = [[truth.segment(name) for name in names] for names in kinds]
    return np.array(
        [100.0 * abs(mean_known(np.array([radius(body, s) / radius(truth, s) for s in p])) - 1) for p in parts]
    )


def length_errors(body: Body, truth: Body) -> Float:
    """Per cent, of each kind of bone, left and right together."""

    def length(of: Body, upper: str, lower: str) -> float:
        marks = of.landmarks
        ends = [[marks.points[marks.index(f"{name}_{s}")] for name in (upper, lower)] for s in "rl"]
        return float(np.mean([np.linalg.norm(a - b) for a, b in ends]))

    return np.array([100.0 * abs(length(body, *bone) / length(truth, *bone) - 1) for bone in BONES])


B1 = BodyFit()
