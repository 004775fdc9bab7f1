"""hidden-forearms: where the error of the line `stereo-mismatch-prior` comes from.

Elbows and wrists whose forearm one of the two cameras does not show (under a quarter of its vertices), and all other
joints; beside the first, the same arms as the prior alone predicts them from every other joint. Truth says which
forearms are hidden, and scores.

    python -m reproduce hidden-forearms --seeds 0-7
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.cases import PRIOR
from reproduce.running import Tell, over_seeds
from reproduce.sequence import Pictures, joint_errors_mm, prior_of, tracked
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera
from twistcap.evaluate import Row, metrics, row
from twistcap.priors import ParzenPrior
from twistcap.render import render
from twistcap.studio import Capture, capture

CASE = next(case for case in PRIOR.cases if case.id == "stereo-mismatch-prior")
SHOWN, TOLERANCE = 0.25, 0.02  # fraction of a forearm's vertices; m
SEEN, HIDDEN, GUESSED = "joints in sight", "hidden forearms", "hidden forearms, by the prior"


@dataclass(frozen=True)
class HiddenForearms:
    """The experiment; see `Experiment`."""

    id: str = "hidden-forearms"
    says: str = "where the joint error of stereo-mismatch-prior comes from: forearms that one camera does not show"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows alone."""
        del out
        found = over_seeds(errors, seeds, progress, self.id)
        return Findings(self.rows(found), "", ())

    def rows(self, found: Sequence[tuple[Float, Float, Float]]) -> list[Row]:
        """Means over the seeds, elbows and wrists apart."""
        hidden = [arms.size / (seen.size + arms.size) for seen, arms, _ in found]
        seen = [float(one.mean()) for one, _, _ in found]
        out = [
            row(self.id, "joints of hidden forearms", float(np.mean(hidden)), "share", seeds=hidden),
            row(self.id, SEEN, float(np.mean(seen)), "mm", seeds=seen),
        ]
        for name, which in ((HIDDEN, 1), (GUESSED, 2)):
            for column, joint in enumerate(("elbow", "wrist")):
                values = [metrics.mean_known(one[which][:, column]) for one in found]
                out.append(row(self.id, f"{name}: {joint}", metrics.mean_known(np.array(values)), "mm", seeds=values))
        return out


def hidden(scene: Capture, index: int, side: str) -> bool:
    """Whether some camera shows hardly anything of the true forearm."""
    body, posed = scene.true_body, Posed(scene.true_body, scene.true_poses[index])
    own = np.isin(body.vertex_part, [body.segment(f"{bone}_{side}") for bone in ("ulna", "radius")])
    return min(float(np.mean(visible(posed, camera)[own])) for camera in scene.true_rig) <= SHOWN


def visible(posed: Posed, camera: Camera) -> Bool:
    """(V,) vertices that nothing of the body lies before."""
    view = render(posed, camera)
    x, y = np.round(view.pixels).astype(int).T
    height, width = view.nearness_image.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    front = view.nearness_image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    depth, nearest = 1.0 / np.maximum(view.nearness, 1e-9), 1.0 / np.maximum(front, 1e-6)
    return np.asarray(inside & (nearest > depth - TOLERANCE), np.bool_)


def by_the_prior(prior: ParzenPrior, body: Body, pose: Pose, side: str) -> Pose:
    """The pose with one arm as the prior has it, given all other joints."""
    columns = np.array([body.coordinate(name) for name in prior.names])
    arm = np.array([n.startswith(("arm_", "elbow", "pro_sup")) and n.endswith(f"_{side}") for n in prior.names])
    q = pose.q.copy()
    q[columns[arm]] = prior.mean(q[columns], np.where(arm, 0.0, 1.0))[arm]
    return replace(pose, q=q)


def errors(seed: int) -> tuple[Float, Float, Float]:
    """mm: of the joints in sight, of hidden forearms' elbows and wrists (N, 2), and of these by the prior (N, 2)."""
    pictures = Pictures(capture(replace(CASE.studio, seed=seed)))
    scene = pictures.scene
    body, _, estimates, _ = tracked(CASE, pictures)
    prior = prior_of(CASE.prior, scene)
    assert prior is not None
    names = [name for name in metrics.JOINT_CENTRES if name in body.landmarks.names]
    mm = joint_errors_mm(scene, body, [e.pose for e in estimates], [e.index for e in estimates])
    sight, arms, guessed = np.ones(mm.shape, np.bool_), list[Float](), list[Float]()
    for n, e in enumerate(estimates):
        for side in "rl":
            if hidden(scene, e.index, side):
                joints = [names.index(f"elbow_{side}"), names.index(f"wrist_{side}")]
                sight[n, joints] = False
                arms.append(mm[n, joints])
                guess = by_the_prior(prior, body, e.pose, side)
                guessed.append(joint_errors_mm(scene, body, [guess], [e.index])[0, joints])
    return mm[sight], np.array(arms).reshape(-1, 2), np.array(guessed).reshape(-1, 2)


HIDDEN_FOREARMS = HiddenForearms()
