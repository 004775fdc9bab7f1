"""unaided: the first pose from the images alone, and whether the tracker takes it up or it is refused.

Nothing is given but cameras and body: no plate, no keypoints, no clicks, no colours. A walk, and DeepMimic's motions,
in 4 and 3 views at 30 frames per second. TWISTCAP_DATA names the folder of the motions.

    python -m reproduce unaided --seeds 0-3
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.recorded import Recording
from reproduce.running import Tell, over_seeds
from reproduce.scenes.motion_cases import MIMIC
from reproduce.sequence import joint_errors_mm
from twistcap.adjust.unaided import Proof, ProofRule, Unaided, middle_of_sight, scenery_of
from twistcap.build import build
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.evaluate.metrics import row
from twistcap.hindsight import tracked
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.scene import default_body

MOTIONS = ("walk", "run", "jog", "jump", "kick", "punch", "spin", "roll")
VIEWS = (4, 3)
FRAMES, FPS = 60, 30.0
AFTER, WITHIN_MM = 10, 20.0  # the frame whose mean joint error tells whether a start was taken up
_PICTURES = 25


@dataclass(frozen=True)
class Start:
    """One start.

    Attributes:
        motion, views, seed: what was filmed.
        error_mm: mean joint error in the tenth frame after the first; NaN where the start was refused.
    """

    motion: str
    views: int
    seed: int
    error_mm: float

    @property
    def wrong(self) -> bool:
        """Whether it was believed and is not the person's pose."""
        return self.error_mm > WITHIN_MM


def scene_of(motion: str, views: int, seed: int) -> Capture:
    """The studio's walk, or a recorded motion."""
    config = StudioConfig(seed=seed, views=views, frames=FRAMES, fps=FPS)
    if motion == "walk":
        return capture(config)
    body = default_body(config)
    poses = Recording(f"{MIMIC}_{motion}.txt").clip(body, FPS).poses()[:FRAMES]
    return capture(replace(config, frames=len(poses)), body, poses)


def proved(scene: Capture, frames: Sequence[Frame]) -> Proof:
    """The first pose as a session without one has it. Raises InputError where it is refused."""
    model, middle = build(scene.body, scene.rig), middle_of_sight(scene.rig)
    spread = frames[:: max(1, len(frames) // _PICTURES)]
    pictures = list(zip(*(frame.images for frame in spread), strict=True))
    scenery = scenery_of(scene.rig, pictures, middle, model.channels)
    search = Unaided(
        ProofRule(), model, scenery, lambda at: frames[at.start : at.stop], len(frames), scene.config.fps
    )  # fmt: skip
    return search.found()


def started(motion: str, views: int, seed: int) -> Start:
    """Find the first pose, and track from it: all frames, as users do, for later ones tell which way a limb went."""
    scene = scene_of(motion, views, seed)
    frames = list(scene.frames())
    try:
        first = proved(scene, frames).first
    except InputError:
        return Start(motion, views, seed, np.nan)
    then = list(tracked(frames, build(scene.body, scene.rig), first))[AFTER]
    return Start(motion, views, seed, float(joint_errors_mm(scene, scene.body, [then.pose], [then.index]).mean()))


def starts_of_seed(seed: int) -> list[Start]:
    """All motions and numbers of views."""
    return [started(motion, views, seed) for motion, views in product(MOTIONS, VIEWS)]


@dataclass(frozen=True)
class FirstPoses:
    """The experiment; see `Experiment`."""

    id: str = "unaided"
    says: str = "the first pose from the images alone, 8 motions in 4 and 3 views: taken up, or refused, never wrong"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows."""
        del out
        starts = [start for of_seed in over_seeds(starts_of_seed, seeds, progress, self.id) for start in of_seed]
        refused = float(np.mean([np.isnan(s.error_mm) for s in starts]))
        wrong = float(sum(s.wrong for s in starts))
        errors = [s.error_mm for s in starts if s.error_mm <= WITHIN_MM]
        rows = [
            row(self.id, "taken up", len(errors) / len(starts), ""),
            row(self.id, "refused", refused, ""),
            row(self.id, "wrong and believed", wrong, "", at_most=0.0),
            row(self.id, "joints after ten frames", float(np.mean(errors)) if errors else np.nan, "mm"),
        ]
        return Findings(rows, "", ())


UNAIDED = FirstPoses()
