"""clicks: the built-in humanoid's first pose from six joints clicked in two views, and whether the tracker takes it up.

Nothing of the person is known but the clicks: not the stature, not the lengths. Four views are then tracked.

    python -m reproduce clicks --seeds 0-7 --out out/clicks
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reproduce.arms import Findings, Trace, shot_of, slim
from reproduce.running import Tell, over_seeds
from reproduce.sequence import joint_errors_mm
from twistcap.adjust.first_pose import fit_keypoints
from twistcap.body import Posed
from twistcap.body.humanoid import humanoid
from twistcap.build import build
from twistcap.estimate import Keypoints
from twistcap.evaluate.metrics import Row, row
from twistcap.hindsight import tracked
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.config import stream

JOINTS = ("shoulder_r", "wrist_r", "wrist_l", "hip_l", "ankle_r", "ankle_l")
VIEWS, NOISE_PX = (0, 1), 1.5  # clicked views, and how surely people click
FRAMES = 30  # an elbow that the clicks do not tell may take that long to come home
WITHIN_MM = 15.0  # mean joint error from which on a generic body is on the person


@dataclass(frozen=True)
class Clicked(Trace):
    """A track that began with clicks.

    Attributes:
        clicked_mm: mean error of the joints before it.
    """

    clicked_mm: float = np.nan


@dataclass(frozen=True)
class Clicks:
    """The experiment; see `Experiment`."""

    id: str = "clicks"
    says: str = (
        "the first pose from 6 joints clicked in 2 of 4 views, the person's size unknown: the tracker takes it up"
    )

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows and the error over time."""
        del out
        found = over_seeds(clicked_seed, seeds, progress, self.id)
        return Findings(self.rows(found), "mean error of the joints, mm", found)

    def rows(self, traces: Sequence[Clicked]) -> list[Row]:
        """Of clicks, of the last frame, and how many seeds the tracker took up."""
        first, last = [t.clicked_mm for t in traces], [float(t.errors[-1]) for t in traces]
        missed = [float(at > WITHIN_MM or t.lost) for at, t in zip(last, traces, strict=True)]
        lost = sum(t.lost for t in traces)
        return [
            row(self.id, "joints, as clicked", float(np.mean(first)), "mm", seeds=first),
            row(self.id, "joints, last frame", float(np.mean(last)), "mm", seeds=last, lost=lost),
            row(self.id, "seeds not taken up", sum(missed), "", at_most=0.0, seeds=missed, lost=lost),
        ]


def clicked(scene: Capture) -> Keypoints:
    """Six joints in two views, each click a little off."""
    marks = [scene.true_body.landmarks.index(joint) for joint in JOINTS]
    pixels = np.full((len(scene.rig), len(JOINTS), 2), np.nan)
    for c in VIEWS:
        pixels[c] = scene.true_rig[c].project(scene.landmarks[0][marks])[0]
    noise = stream(scene.config.seed, "clicks").normal(0.0, NOISE_PX, pixels.shape)
    return Keypoints(JOINTS, pixels + noise, np.isfinite(pixels[..., 0]).astype(np.float64))


def clicked_seed(seed: int) -> Clicked:
    """Click, fit, and track half a second."""
    scene = capture(StudioConfig(seed=seed, views=4, frames=FRAMES))
    start = fit_keypoints(humanoid(), scene.rig, clicked(scene))
    frames = list(scene.frames())
    estimates = list(tracked(frames, build(start.body, scene.rig), start.pose))
    before = joint_errors_mm(scene, start.body, [start.pose], [0])
    joints = joint_errors_mm(scene, start.body, [e.pose for e in estimates], [e.index for e in estimates])
    shot = shot_of("as clicked", scene, frames[0], Posed(start.body, start.pose))
    return Clicked("tracked", seed, joints.mean(axis=1), joints, slim(estimates), shot, clicked_mm=float(before.mean()))


CLICKS = Clicks()
