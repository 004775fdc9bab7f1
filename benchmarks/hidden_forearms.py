"""Where the error of `stereo-mismatch-prior` comes from: `python benchmarks/hidden_forearms.py [--seeds 8]`.

Elbows and wrists whose forearm one of the two cameras does not show (under a quarter of its vertices), and all other
joints; beside the first, the same arms as the prior alone would have them, told by every other joint. Truth says
which forearms are hidden, and scores.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from twistcap._typing import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.evaluate import metrics
from twistcap.evaluate.cases import PRIOR
from twistcap.evaluate.sequence import Pictures, joint_errors_mm, prior_of, tracked
from twistcap.priors import ParzenPrior
from twistcap.render import render
from twistcap.studio import Capture, capture

CASE = next(case for case in PRIOR.cases if case.id == "stereo-mismatch-prior")
SHOWN, TOLERANCE = 0.25, 0.02  # share of a forearm's vertices; m


def hidden(scene: Capture, index: int, side: str) -> bool:
    """Whether some camera shows hardly anything of the true forearm."""
    body, posed = scene.true_body, Posed(scene.true_body, scene.true_poses[index])
    own = np.isin(body.vertex_part, [body.segment(f"{bone}_{side}") for bone in ("ulna", "radius")])
    return min(float(np.mean(seen(posed, camera)[own])) for camera in scene.true_rig) <= SHOWN


def seen(posed: Posed, camera: object) -> Bool:
    """(V,) vertices that nothing of the body lies before."""
    view = render(posed, camera)  # pyright: ignore[reportArgumentType]
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
    for row, e in enumerate(estimates):
        for side in "rl":
            if hidden(scene, e.index, side):
                joints = [names.index(f"elbow_{side}"), names.index(f"wrist_{side}")]
                sight[row, joints] = False
                arms.append(mm[row, joints])
                guess = by_the_prior(prior, body, e.pose, side)
                guessed.append(joint_errors_mm(scene, body, [guess], [e.index])[0, joints])
    return mm[sight], np.array(arms).reshape(-1, 2), np.array(guessed).reshape(-1, 2)


def main() -> None:
    """Print a line per seed and the means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8)
    print("seed  hidden  in sight   elbow, wrist hidden   by the prior")
    rows: list[Float] = []
    for seed in range(parser.parse_args().seeds):
        sight, arms, guessed = errors(seed)
        share = arms.size / (sight.size + arms.size)
        rows.append(np.array([share, sight.mean(), *arms.mean(axis=0), *guessed.mean(axis=0)]))
        print(seed, np.round(rows[-1], 2), flush=True)
    print("mean", np.round(np.mean(rows, axis=0), 2))


if __name__ == "__main__":
    main()
