"""T-1 to T-3 and T-EM: walks followed from brightness alone, in one view and in three, and what support maps are worth.

Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998: people walking across and obliquely
to one camera, and photographic plates in three views, about a dozen exposures in a cycle.

    python -m reproduce T-1 --seeds 0-7 --out out/T-1        # T-2, T-3, T-EM alike
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from reproduce.brightness_trials import DifferentialTrial, Tracked
from reproduce.ellipsoids import ellipsoid_body
from reproduce.norm_picture import norm_picture
from reproduce.passes import PLATES, WALKING
from reproduce.plates import NINETEEN
from reproduce.reanimated import reanimated
from reproduce.scenes.disturbed import loose, plates
from reproduce.scenes.walks import Walk
from twistcap.body import Body
from twistcap.body.simplify import SIDE_VIEW, side_view, simplified
from twistcap.camera import ScaledView
from twistcap.differential.settings import DifferentialConfig, Rule
from twistcap.evaluate import Row, row
from twistcap.studio import Capture, StudioConfig

WITH, ROBUST, WITHOUT = "support maps by EM", "robust weights", "the projected shape"
# Settings of the tracker: grey, as the paper's pictures.
_SIDE = DifferentialConfig(turns="planar", colour=False)
_OBLIQUE = DifferentialConfig(colour=False, perspective=True)
_PLATES, _FEW = DifferentialConfig(search_deg=30.0, stray_deg=12.0), Rule(levels=3, carry=0.6, update=0.1)
_SIDE_STUDIO = StudioConfig(frames=101)


def _planar(scene: Capture) -> Body:
    """Trunk, head, and the right arm and leg, turning in the image plane."""
    at, axis = scene.first_pose.q, ScaledView.of(scene.rig[0], scene.first_pose.root).rotation[2]
    return ellipsoid_body(side_view(scene.body, "r", at=at, axis=axis))


def _both_legs(scene: Capture) -> Body:
    """Trunk, head, the near arm and both legs, since either leg hides the other; the surface of the body itself."""
    kept = [n for n in scene.body.coordinate_names if n.removesuffix("_r").removesuffix("_l") in SIDE_VIEW]
    far_arm = ("humerus_l", "ulna_l", "radius_l")
    kept = [n for n in kept if n not in ("arm_flex_l", "elbow_flex_l")]
    return simplified(scene.body, kept, at=scene.first_pose.q, without=far_arm)


def _nineteen(scene: Capture) -> Body:
    """Both sides with 19 joint angles, and the surface of the body itself."""
    return simplified(scene.body, NINETEEN, at=scene.first_pose.q)


@dataclass(frozen=True)
class _OneView:
    """Rows of T-1 and T-2: hip, knee, lost sequences, and how the scale was followed."""

    id: str
    most_deg: float
    most_scale: float | None = None

    def __call__(self, traces: Sequence[Tracked]) -> list[Row]:
        lost = [float(t.lost) for t in traces]
        out = [_errors(self.id, joint, traces, self.most_deg) for joint in ("hip_flexion", "knee_angle")]
        out += [_errors(self.id, joint, traces, None) for joint in ("ankle_angle", "arm_flex", "elbow_flex")]
        scale = [100.0 * float(np.mean(t.scale_error)) for t in traces if t.scale_error is not None]
        out.append(row(self.id, "error of the scale", float(np.mean(scale)), "%", at_most=self.most_scale, seeds=scale))
        out.append(row(self.id, "lost sequences", sum(lost), "sequences", at_most=0.0, seeds=lost, lost=int(sum(lost))))
        return out


def _errors(case: str, joint: str, traces: Sequence[Tracked], most: float | None) -> Row:
    values = [t.mean_deg(joint) for t in traces]
    return row(case, joint, float(np.mean(values)), "deg", at_most=most, seeds=values)


def _plate_rows(traces: Sequence[Tracked]) -> list[Row]:
    whole = [float(not t.lost) for t in traces]
    angles, tracked = [t.mean_deg() for t in traces], [t.share_tracked for t in traces]
    needed = 7 / 8 * len(traces)
    return [
        row(
            "T-3",
            "all exposures tracked",
            sum(whole),
            "sequences",
            at_least=needed,
            seeds=whole,
            lost=int(len(whole) - sum(whole)),
        ),
        row("T-3", "exposures tracked", float(np.mean(tracked)), "share", seeds=tracked),
        row("T-3", "all 19 angles", float(np.mean(angles)), "deg", at_most=5.0, seeds=angles),
        *(_errors("T-3", joint, traces, None) for joint in ("hip_flexion", "knee_angle", "arm_flex", "elbow_flex")),
    ]


def _support_rows(traces: Sequence[Tracked]) -> list[Row]:
    out: list[Row] = []
    for arm in dict.fromkeys(t.arm for t in traces):
        own = [t for t in traces if t.arm == arm]
        values, lost = [t.mean_deg("hip_flexion", "knee_angle") for t in own], sum(t.lost for t in own)
        out.append(row(f"T-EM {arm}", "hip and knee", float(np.mean(values)), "deg", seeds=values, lost=lost))
    on, off = (
        np.array([t.mean_deg("hip_flexion", "knee_angle") for t in traces if t.arm == arm]) for arm in (WITH, WITHOUT)
    )
    out.append(
        row("T-EM", "with maps to without", float(on.mean() / off.mean()), "ratio", at_most=2 / 3, seeds=list(on / off))
    )
    return out


def _norm_picture(out: Path, walk: Walk, traces: Sequence[Tracked]) -> None:
    norm_picture(out / "T-1-norms.png", walk, traces)


def _reanimation(out: Path, walk: Walk, traces: Sequence[Tracked]) -> None:
    trace = min(traces, key=lambda t: t.mean_deg())
    reanimated(out / f"T-3-seed-{trace.seed}.mp4", _nineteen(walk.scene(trace.seed)), [e.pose for e in trace.estimates])


T1 = DifferentialTrial(
    "T-1",
    "one view, walking across it, 100 frames: trunk, head, one arm and one leg of ellipsoids",
    Walk((-90.0,), 8.0, _SIDE_STUDIO),
    _planar,
    (("tracked", _SIDE),),
    _OneView("T-1", 3.0),
    picture=_norm_picture,
    sequence=WALKING,
)
T2 = DifferentialTrial(
    "T-2",
    "one view, walking obliquely towards it, 100 frames; the scale grows: trunk, head, one arm and both legs",
    Walk((-50.0,), 6.0, _SIDE_STUDIO),
    _both_legs,
    (("tracked", _OBLIQUE),),
    _OneView("T-2", 5.0, 3.0),
    sequence=WALKING,
)
T3 = DifferentialTrial(
    "T-3",
    "plates: three views, a dozen exposures in a cycle, grain, flicker, low contrast, 19 joint angles",
    Walk(
        (-90.0, -30.0, -150.0),
        10.0,
        StudioConfig(frames=14, colour=False, sensor_noise=0.0),
        per_cycle=12,
        disturbed=plates,
    ),
    _nineteen,
    (("tracked", _PLATES),),
    _plate_rows,
    picture=_reanimation,
    sequence=PLATES,
    rule=_FEW,
)
T_EM = DifferentialTrial(
    "T-EM",
    "as T-1, the clothes loose and clutter moving behind: support maps on, against off",
    Walk((-90.0,), 8.0, replace(_SIDE_STUDIO, frames=61), disturbed=partial(loose, cloth=0.012, passers=4)),
    _planar,
    ((WITH, replace(_SIDE, support="em")), (ROBUST, _SIDE), (WITHOUT, replace(_SIDE, support="shape"))),
    _support_rows,
)
