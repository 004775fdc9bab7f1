"""Fit the weights of `twistcap.search.flag` on captures with truth, and judge them on captures that were left out.

    python benchmarks/fit_flag.py --seeds 1000-1199 --keep DIR

Each seed is a capture of the fault bench; with every fourth comes a walk without faults whose body and cameras are not
exact: there contours agree less, and nothing is lost. What was measured of each is kept in DIR, so that a run can be
broken off and go on. Six folds of whole captures give the honest figures; the printed weights are fitted on all.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from reproduce.faults.kinds import kind_of, take_of
from reproduce.faults.runs import JOINT_CENTRES, PARTS, errors_mm
from reproduce.faults.staged import staged
from reproduce.faults.take import Take, own_pictures
from twistcap.arrays import Bool, Float
from twistcap.body import Pose, Posed
from twistcap.build import build
from twistcap.evaluate.metrics import LOST_FRAME_MM
from twistcap.search.flag import SIGNS, features, flag_groups
from twistcap.search.uncertain import segment_deviations
from twistcap.studio import StudioConfig, capture
from twistcap.track import Tracker

FOLDS = 6
SMOOTH = 5.0  # of the weights, as of a Gaussian prior


@dataclass(frozen=True)
class Seen:
    """N frames of one capture with G limbs: features, which limbs and whether the body is lost, s unseen (0: seen)."""

    features: Float
    limbs: Bool
    body: Bool
    unseen: Float


def measured(take: Take) -> Seen:
    """A capture tracked with today's tracker."""
    body = take.scene.body
    tracker, groups = Tracker(build(body, take.scene.rig)), flag_groups(body)
    tracker.start(take.first_pose)
    rows, unseen, poses = list[Float](), list[float](), list[Pose]()
    for frame in take.frames():
        estimate = tracker.step(frame)
        signs = tracker.state.searches["lost body"].signs
        deviation, _ = segment_deviations(Posed(body, estimate.pose), estimate.covariance)
        spread = np.array([deviation[group].max() for group in groups])
        rows.append(features(np.zeros((len(groups), SIGNS)) if signs is None else signs, spread))
        blind = estimate.part_probability is None
        unseen.append(max(frame.time - tracker.state.past.seen_time, 1e-3) if blind else 0.0)
        poses.append(estimate.pose)
    far = {name: errors_mm(take, poses, marks).max(axis=1) > LOST_FRAME_MM for name, marks in PARTS.items()}
    part = [_part(body.segment_names, group) for group in groups]
    lost = errors_mm(take, poses, JOINT_CENTRES).max(axis=1) > LOST_FRAME_MM
    return Seen(np.array(rows), np.stack([far[p] for p in part], axis=1), lost, np.array(unseen))


def _part(names: tuple[str, ...], group: Bool) -> str:
    """The name in `PARTS` of a group of segments."""
    first = names[int(np.flatnonzero(group)[0])]
    limb = {"arm": ("humerus", "ulna", "radius", "hand"), "leg": ("femur", "tibia", "foot")}
    return next((f"{p}_{first[-1]}" for p, segments in limb.items() if first.startswith(segments)), "trunk")


def captures(seeds: range, folder: Path) -> Iterator[Seen]:
    """What was measured of each seed, kept in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, exact in ((seed, exact) for seed in seeds for exact in (True, False) if exact or seed % 4 == 0):
        path = folder / f"{seed}{'' if exact else '-inexact'}.npz"
        if not path.exists():
            take = take_of(seed, kind_of(seed)) if exact else inexact(seed)
            np.savez(path, **vars(measured(take)))
        with np.load(path) as held:
            yield Seen(**dict(held))
        print(path.stem, flush=True)


def inexact(seed: int) -> Take:
    """A walk without faults before a tracker whose body and cameras are not exact."""
    rates = (15.0, 30.0, 60.0)
    config = StudioConfig(seed, 2 + seed % 3, (320, 240), 50, rates[seed // 4 % 3], "mismatch")
    scene = staged(capture(config))
    return Take("inexact", "walk", scene, scene.first_pose, own_pictures(config.frames, config.views), (0, None))


def logistic(A: Float, lost: Bool, smooth: float) -> Float:
    """Constant and weights (F,) of the logistic model of lost (N,) by A (N, F)."""
    mean, sd = A.mean(axis=0), A.std(axis=0) + 1e-9
    X, y = np.column_stack([np.ones(len(A)), (A - mean) / sd]), lost.astype(float)

    def loss(w: Float) -> tuple[float, Float]:
        z, pull = X @ w, smooth * np.append(0.0, w[1:])
        gradient = X.T @ (1.0 / (1.0 + np.exp(-z)) - y) + pull
        return float(np.logaddexp(0.0, z).sum() - y @ z + 0.5 * pull @ w), gradient

    w = minimize(loss, np.zeros(X.shape[1]), jac=True, method="L-BFGS-B").x
    return np.append(w[0] - (w[1:] * mean / sd).sum(), w[1:] / sd)


def two_most(limb: Float, A: Float) -> Float:
    """(N, 2) logits of the second most and the most doubtful limb, of features (N, G, F)."""
    return np.sort(np.clip(limb[0] + A @ limb[1:], -20.7, 20.7), axis=1)[:, -2:]


def fitted(runs: list[Seen]) -> tuple[Float, Float]:
    """Weights of limbs and body."""
    seen = [run.unseen == 0.0 for run in runs]
    A = np.concatenate([run.features[s] for run, s in zip(runs, seen, strict=True)])
    limbs = np.concatenate([run.limbs[s] for run, s in zip(runs, seen, strict=True)])
    limb = logistic(A.reshape(-1, A.shape[2]), limbs.ravel(), SMOOTH)
    lost = np.concatenate([run.body[s] for run, s in zip(runs, seen, strict=True)])
    return limb, logistic(two_most(limb, A), lost, 1.0)


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="1000-1109")
    parser.add_argument("--keep", type=Path, required=True)
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    runs = list(captures(range(int(first), int(last or first) + 1), options.keep))
    probabilities, truth = list[Float](), list[Bool]()
    for fold in range(FOLDS):
        limb, body = fitted([run for k, run in enumerate(runs) if k % FOLDS != fold])
        for run in runs[fold::FOLDS]:
            z = body[0] + two_most(limb, run.features) @ body[1:]
            probabilities.append(1.0 / (1.0 + np.exp(-z[run.unseen == 0.0])))
            truth.append(run.body[run.unseen == 0.0])
    p, lost = np.concatenate(probabilities), np.concatenate(truth)
    flag = p >= 0.5
    print(f"{len(runs)} captures, {len(p)} frames seen, {lost.sum()} lost")
    print(f"precision {(flag & lost).sum() / max(flag.sum(), 1):.3f}, recall {(flag & lost).sum() / lost.sum():.3f}")
    for k in range(10):
        within = (10 * p).astype(int).clip(0, 9) == k
        print(f"  {k / 10:.1f}-{k / 10 + 0.1:.1f}: {within.sum():6d} frames, lost {lost[within].mean():.2f}")
    limb, body = fitted(runs)
    gaps, gone = (np.concatenate(a) for a in ([r.unseen for r in runs], [r.body for r in runs]))
    blind = logistic(np.log10(gaps[gaps > 0.0])[:, None], gone[gaps > 0.0], 1.0)
    for name, weights in (("LIMB", limb), ("BODY", body), ("UNSEEN", blind)):
        print(f"{name} = ({', '.join(f'{w:.4g}' for w in weights)})")


if __name__ == "__main__":
    main()
