"""refine, refine-walk: a body of wrong lengths and joint centres is tracked, and put right by its own sequence.

After Bregler and Malik (CVPR 1998, section 2.5, DOI 10.1109/CVPR.1998.698581), who refine a sequence's angles and
lengths together.

    python -m reproduce refine --seeds 0-7
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from reproduce.arms import Findings, Trace, shot_of, slim
from reproduce.running import Tell, over_seeds
from reproduce.scenes.subjects import limbering
from reproduce.sequence import joint_errors_mm, khe_angles, khe_errors_deg
from twistcap.adjust.first_pose import girth_groups
from twistcap.adjust.refine import Refined, refine
from twistcap.arrays import Float
from twistcap.body import Body, Posed, rescaled
from twistcap.build import build
from twistcap.estimate import Estimate, Frame
from twistcap.evaluate.metrics import Row, row
from twistcap.hindsight import tracked
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.mismatch import with_joint_noise
from twistcap.studio.scene import default_body

# The wrong body: each kind of segment is longer or shorter by this fraction, each joint offset by so many metres.
LENGTH, JOINT = 0.05, 0.015
AGAIN = "refined, tracked and refined again"
BONES = tuple(
    (f"{a}_{side}", f"{b}_{side}")
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
    for side in ("r", "l")
)
"""Between the joint centres at whose distance a body's lengths are judged."""


def limbering_scene(seed: int) -> Capture:
    """Four cameras see somebody swing every joint, three seconds at 30 frames per second."""
    config = StudioConfig(seed=seed, views=4, frames=90, fps=30.0)
    body = default_body(config)
    return capture(config, body, limbering(body, config.frames))


def walking_scene(seed: int) -> Capture:
    """Four cameras see a walk of one and a half seconds."""
    return capture(StudioConfig(seed=seed, views=4, frames=90))


def wrong_shape(body: Body, seed: int) -> Body:
    """The body with each kind of segment 5 % too long or too short, and every joint centre 15 mm off."""
    rng = stream(seed, "wrong shape")
    factors: dict[str, float] = {}
    for group in girth_groups(body).values():
        factors.update(dict.fromkeys(group, 1.0 + LENGTH * float(rng.choice([-1.0, 1.0]))))
    return with_joint_noise(rescaled(body, factors), JOINT, rng)


def length_errors(body: Body, truth: Body) -> Float:
    """(8,) errors of the bones of arms and legs, per cent."""
    ours, theirs = (np.array([_bone(b, *ends) for ends in BONES]) for b in (body, truth))
    return 100.0 * (ours / theirs - 1.0)


def _bone(body: Body, one: str, other: str) -> float:
    marks = body.landmarks
    return float(np.linalg.norm(marks.points[marks.index(one)] - marks.points[marks.index(other)]))


@dataclass(frozen=True)
class Shaped(Trace):
    """A track and the body that it is of.

    Attributes:
        lengths: (8,) errors of the bones, per cent.
        khe_deg: mean error of knees, hips and elbows.
        within: fraction of these errors within two standard deviations.
    """

    lengths: Float | None = None
    khe_deg: float = np.nan
    within: float = np.nan


@dataclass(frozen=True)
class Refinement:
    """Scenes that are tracked with a wrong body and then refined; an `Experiment`.

    Attributes:
        id, says: as of every experiment.
        scene: the capture of a seed.
        length, joints: bars: mean error of the bones, per cent, and of joint centres, mm; None where there is none.
    """

    id: str
    says: str
    scene: Callable[[int], Capture]
    length: float | None = None
    joints: float | None = None

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """All seeds, two at a time."""
        found = over_seeds(partial(run_seed, self.id), seeds, progress, self.id)
        traces = [trace for arms in found for trace in arms]
        return Findings(self.rows(traces), "mean error of the joints, mm", traces)

    def rows(self, traces: Sequence[Shaped]) -> list[Row]:
        """The table's lines, of all arms."""
        out: list[Row] = []
        for arm, bars in (("tracked", (None, None)), ("refined", (None, None)), (AGAIN, (self.length, self.joints))):
            out += _rows(f"{self.id}, {arm}", [t for t in traces if t.arm == arm], *bars)
        return out


def _rows(case: str, traces: Sequence[Shaped], length: float | None, joints: float | None) -> list[Row]:
    lost = sum(t.lost for t in traces)
    sizes = [np.abs(t.lengths) if t.lengths is not None else np.full(len(BONES), np.nan) for t in traces]
    measures: list[tuple[str, list[float], str, float | None]] = [
        ("lengths", [float(s.mean()) for s in sizes], "%", length),
        ("lengths, worst bone", [float(s.max()) for s in sizes], "%", None),
        ("joints", [float(t.joints_mm.mean()) for t in traces], "mm", joints),
        ("joints, worst", [float(t.joints_mm.mean(axis=0).max()) for t in traces], "mm", None),
        ("KHE", [t.khe_deg for t in traces], "deg", None),
        ("KHE within 2σ", [t.within for t in traces], "share", None),
    ]
    return [
        row(case, name, float(np.mean(v)), unit, at_most=bar, seeds=v, lost=lost) for name, v, unit, bar in measures
    ]


def run_seed(id: str, seed: int) -> list[Shaped]:
    """Track and refine one scene, then track it with the refined body and refine again."""
    experiment = next(e for e in REFINEMENTS if e.id == id)
    scene = experiment.scene(seed)
    frames, body = list(scene.frames()), wrong_shape(scene.true_body, seed)
    estimates = list(tracked(frames, build(body, scene.rig), scene.first_pose))
    first: Refined = refine(frames, body, scene.rig, estimates)
    anew = list(tracked(frames, build(first.body, scene.rig), first.estimates[0].pose))
    second = refine(frames, first.body, scene.rig, anew, shape=first.shape)
    return [
        _traced("tracked", scene, frames, body, estimates),
        _traced("refined", scene, frames, first.body, first.estimates),
        _traced(AGAIN, scene, frames, second.body, second.estimates),
    ]


def _traced(arm: str, scene: Capture, frames: Sequence[Frame], body: Body, estimates: Sequence[Estimate]) -> Shaped:
    joints = joint_errors_mm(scene, body, [e.pose for e in estimates], [e.index for e in estimates])
    errors, sigma = khe_errors_deg(scene, body, estimates), khe_angles(scene, body, estimates)[2]
    shot = shot_of(arm, scene, frames[-1], Posed(body, estimates[-1].pose))
    return Shaped(
        arm, scene.config.seed, joints.mean(axis=1), joints, slim(estimates), shot,
        lengths=length_errors(body, scene.true_body), khe_deg=float(np.abs(errors).mean()),
        within=float(np.mean(np.radians(np.abs(errors)) < 2.0 * sigma)),
    )  # fmt: skip


REFINE = Refinement(
    "refine",
    "lengths wrong by 5 %, joint centres by 15 mm, refined over the sequence: every joint swung, 4 views",
    limbering_scene,
    length=1.5,
    joints=6.0,
)
REFINE_WALK = Refinement(
    "refine-walk",
    "the same in a walk, which moves few joints much: what a sequence cannot tell stays as it was given",
    walking_scene,
)
REFINEMENTS = (REFINE, REFINE_WALK)
