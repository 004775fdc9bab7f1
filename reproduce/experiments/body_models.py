"""B-2: which body is fitted better to whom: ours and Anny, each to a person of our making and to one of Anny's.

Nothing of the person is known but keypoints of the first frame, 2 px off, and the pictures; the cameras are a little
wrong, as in B-1. It needs the extra ``twistcap[anny]``.

    python -m reproduce B-2 --seeds 0-1
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.measures.surfaces import surface_distances
from reproduce.running import Tell, over_seeds
from reproduce.sequence import joint_errors_mm, noisy_keypoints
from twistcap.adjust.body_fit import FitRule, Fitted, Take, fit_body
from twistcap.adjust.body_fit.fields import Build
from twistcap.adjust.body_fit.parametric import carried_pose, matched
from twistcap.adjust.first_pose import fit_keypoints
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.anny import AnnyModel
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.evaluate.metrics import Row, row
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.mismatch import bumpy
from twistcap.studio.scene import default_body

SUBJECTS, BODIES = ("humanoid", "Anny"), ("humanoid", "Anny")
FRAMES, FITTED, NOISE_PX, BUMPS = 30, 10, 2.0, 0.004
_WHOLE, _PARTS = 0.7, 0.3  # of Anny's spreads, by which its people differ: as a whole, and in single parts
_MEASURES = ("surface, mean", "surface, p95", "joints")


@dataclass(frozen=True)
class BodyModels:
    """The experiment; see `Experiment`."""

    id: str = "B-2"
    says: str = "the humanoid and Anny fitted to half a second of people of either making, 4 views: surface error"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows alone.

        Raises:
            InputError: without the extra.
        """
        del out
        AnnyModel()  # here, so that a missing extra is reported before any work
        found = over_seeds(models_seed, seeds, progress, self.id)
        return Findings(self.rows(found), "distance between surfaces, mm", ())

    def rows(self, found: Sequence[dict[str, float]]) -> list[Row]:
        """Means over the seeds."""
        values = {name: [one[name] for one in found] for name in found[0]}
        return [row(self.id, name, float(np.mean(v)), "mm", seeds=v) for name, v in values.items()]


def models_seed(seed: int) -> dict[str, float]:
    """Both bodies fitted to both subjects of a seed."""
    anny, out = AnnyModel(), dict[str, float]()
    for subject in SUBJECTS:
        scene = scene_of(anny, subject, seed)
        start = fit_keypoints(humanoid(), scene.rig, noisy_keypoints(scene, NOISE_PX), sigma_px=NOISE_PX)
        for name in BODIES:
            body, pose, build = start.body, start.pose, None
            if name == "Anny":
                body, pose, build = as_anny(anny, start.body, start.pose, scene)
            frames = list(scene.frames())
            out |= _fitted(scene, body, Take(scene.rig, frames, pose), build, f"{name} on {subject}'s person")
    return out


def _fitted(scene: Capture, body: Body, take: Take, build: Build | None, case: str) -> dict[str, float]:
    """The errors before and after; infinite where the fit refuses, for what it cannot follow it cannot fit."""
    try:
        return _errors(scene, fit_body(body, [take], FitRule(frames=FITTED), build=build), case)
    except InputError:
        return {f"{case}, {when}: {name}": np.inf for when in ("before", "after") for name in _MEASURES}


def scene_of(anny: AnnyModel, subject: str, seed: int) -> Capture:
    """Half a second of a walk; either person has bumps of 4 mm that no model knows."""
    config = StudioConfig(seed=seed, views=4, frames=FRAMES, condition="mismatch")
    rng = stream(seed, "another build")
    if subject == "humanoid":
        return capture(config, bumpy(default_body(config), BUMPS, rng))
    parameters = anny.parameters
    usual, spread = np.array([p.usual for p in parameters]), np.array([p.spread for p in parameters])
    variety = np.array([_WHOLE if p.low == 0.0 else _PARTS for p in parameters])
    values = usual + variety * spread * rng.standard_normal(len(usual))
    values = np.clip(values, [p.low for p in parameters], [p.high for p in parameters])
    return capture(config, bumpy(anny.bodies(values[None])[0], BUMPS, rng))


def as_anny(anny: AnnyModel, body: Body, pose: Pose, scene: Capture) -> tuple[Body, Pose, Build]:
    """Anny of a body's lengths, in its pose."""
    build = matched(anny, body)
    own = anny.bodies(build.start[None])[0]
    return own, carried_pose(body, pose, own, scene.rig), build


def _errors(scene: Capture, fitted: Fitted, case: str) -> dict[str, float]:
    out: dict[str, float] = {}
    for when, body, poses in (
        ("before", fitted.begun, fitted.begun_poses[0]),
        ("after", fitted.body, fitted.poses[0]),
    ):
        shown = sorted(poses)[:: max(1, len(poses) // 3)]
        away = np.concatenate([_between(scene, body, poses[k], k) for k in shown])
        joints = joint_errors_mm(scene, body, [poses[k] for k in shown], shown)
        found = away.mean(), np.percentile(away, 95), joints.mean()
        out |= {f"{case}, {when}: {name}": float(v) for name, v in zip(_MEASURES, found, strict=True)}
    return out


def _between(scene: Capture, body: Body, pose: Pose, index: int) -> Float:
    """Distances of the true surface from the body's, mm."""
    true = Posed(scene.true_body, scene.true_poses[index])
    here = Posed(body, pose)
    return 1000.0 * surface_distances(true.vertices, scene.true_body.faces, here.vertices, body.faces)


B2 = BodyModels()
