"""Fit the weights of `twistcap.search.flag` on captures with truth, and judge them on captures that were left out.

    python benchmarks/fit_flag.py --seeds 1000-1131 --keep DIR

Each seed is a capture of the fault bench; with every fourth comes a walk without faults whose body and cameras are not
exact: there contours agree less, and nothing is lost. What was measured of each is kept in DIR, so that a run can be
broken off and go on. Six folds of whole captures give the honest figures; the printed weights are fitted on all.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from reproduce.faults.kinds import kind_of, take_of
from reproduce.faults.runs import PARTS, errors_mm
from reproduce.faults.staged import staged
from reproduce.faults.take import Take, own_pictures
from twistcap.arrays import Bool, Float
from twistcap.body import Posed
from twistcap.build import build
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import LOST_FRAME_MM
from twistcap.hindsight import Hindsight
from twistcap.search.flag import SIGNS, FlagRule, beyond, flag_groups, ramps, segment_deviations
from twistcap.studio import StudioConfig, capture
from twistcap.track import Tracker

FOLDS = 6
SMOOTH = 1.0  # of the weights, as of a Gaussian prior


@dataclass(frozen=True)
class Seen:
    """N frames of one capture with G limbs: signs of loss now and lately (N, G, SIGNS), standard deviation of
    each limb's place (N, G), which limbs (N, G) are lost and which are judged, s that the body is unseen (0: seen),
    and which frames (N,) were tracked again in hindsight; limbs that it left as they were count with them.
    """

    signs: Float
    lately: Float
    deviation: Float
    limbs: Bool
    judged: Bool
    unseen: Float
    again: Bool

    @property
    def body(self) -> Bool:
        """(N,) frames in which a limb is lost that is judged."""
        return (self.limbs & self.judged).any(axis=1)

    @property
    def seen(self) -> Bool:
        """(N,) frames that show the body."""
        return self.unseen == 0.0

    @property
    def features(self) -> Float:
        """(N, G, R + 1) of the frames that show the body; the last is 1 in those that were tracked again."""
        frames = zip(self.signs[self.seen], self.lately[self.seen], self.deviation[self.seen], strict=True)
        rising = np.array([ramps(*frame) for frame in frames]).reshape(int(self.seen.sum()), self.limbs.shape[1], -1)
        again = np.broadcast_to(self.again[self.seen, None, None], (*rising.shape[:2], 1)).astype(float)
        return np.concatenate([rising, again], axis=2)

    @property
    def blind(self) -> Float:
        """(M, 2) features of the other frames."""
        hidden = ~self.seen
        return np.stack([np.log10(self.unseen[hidden]), beyond(self.deviation[hidden].max(axis=1))], axis=1)


@dataclass(frozen=True)
class Noting(FlagRule):
    """The flag, which notes by what it judges: signs now and lately, and deviations, by limb and probability."""

    notes: dict[tuple[int, float], tuple[Float, Float, Float]] = field(default_factory=dict[Any, Any])

    def limbs(self, signs: Float, lately: Float, deviation: Float) -> Float:
        """See `FlagRule`."""
        found = super().limbs(signs, lately, deviation)
        self.notes.update({(g, float(p)): (signs, lately, deviation) for g, p in enumerate(found)})
        return found

    def of(self, limbs: Float) -> tuple[Float, Float, Float]:
        """By what limbs (G,) of one frame were judged; each by its own, should they be of two tracks. One that
        hindsight has doubted since then is as the others of its frame.
        """
        each = {g: self.notes[g, float(p)] for g, p in enumerate(limbs) if (g, float(p)) in self.notes}
        signs, lately, deviation = (array.copy() for array in next(iter(each.values())))
        for g, own in each.items():
            signs[g], lately[g], deviation[g] = (array[g] for array in own)
        return signs, lately, deviation


def measured(take: Take) -> Seen:
    """A capture tracked with today's tracker, and with hindsight."""
    body, noting = take.scene.body, Noting()
    tracker, groups = Tracker(replace(build(body, take.scene.rig), flag=noting)), flag_groups(body)
    tracker.start(take.first_pose)
    hindsight, again = Hindsight(tracker), np.zeros(take.count, np.bool_)
    estimates, unseen = list[Estimate](), list[float]()
    for frame in take.frames():
        corrected, estimate = hindsight.step(frame)
        again[len(estimates) - len(corrected) : len(estimates)] = True
        estimates[len(estimates) - len(corrected) :] = [*corrected, estimate]
        unseen.append(max(frame.time - tracker.state.past.seen_time, 1e-3))
    poses = [estimate.pose for estimate in estimates]
    far = {name: errors_mm(take, poses, marks).max(axis=1) > LOST_FRAME_MM for name, marks in PARTS.items()}
    limbs = np.stack([far[_part(body.segment_names, group)] for group in groups], axis=1)
    said = [_said(noting, groups, Posed(body, estimate.pose), estimate) for estimate in estimates]
    signs, lately, deviation, judged = (np.array(each) for each in zip(*said, strict=True))
    seen = np.array([estimate.part_probability is not None for estimate in estimates])
    return Seen(signs, lately, deviation, limbs, judged, np.where(seen, 0.0, unseen), again)


def _said(noting: Noting, groups: Bool, posed: Posed, estimate: Estimate) -> tuple[Float, Float, Float, Bool]:
    """By what the limbs of a frame were judged, and whether they were (G,)."""
    if estimate.part_probability is None:
        blank, deviation = np.zeros((len(groups), SIGNS)), segment_deviations(posed, estimate.covariance)
        return blank, blank, np.full(len(groups), deviation.max()), np.ones(len(groups), np.bool_)
    limbs = estimate.part_probability[groups.argmax(axis=1)]
    return *noting.of(limbs), ~np.isnan(limbs)


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


def rising(A: Float, lost: Bool) -> Float:
    """Constant and weights (F,), none of them negative, of the logistic model of lost (N,) by A (N, F)."""
    X, y = np.column_stack([np.ones(len(A)), A]), lost.astype(float)

    def loss(w: Float) -> tuple[float, Float]:
        z = X @ w
        gradient = X.T @ (1.0 / (1.0 + np.exp(-z)) - y) + SMOOTH * np.append(0.0, w[1:])
        return float(np.logaddexp(0.0, z).sum() - y @ z + 0.5 * SMOOTH * w[1:] @ w[1:]), gradient

    bounds = [(None, None), *[(0.0, None)] * A.shape[1]]
    return minimize(loss, np.append(-5.0, np.zeros(A.shape[1])), jac=True, method="L-BFGS-B", bounds=bounds).x


def two_most(limb: Float, A: Float, judged: Bool) -> Float:
    """(N, 2) log odds of the second most and the most doubtful limb of those judged (N, G), of features (N, G, R)."""
    return np.sort(np.where(judged, np.clip(limb[0] + A @ limb[1:], -20.0, 20.0), -20.0), axis=1)[:, -2:]


def fitted(runs: Sequence[Seen]) -> tuple[Float, Float, Float]:
    """Weights of limbs, of the body, and of a body that is not seen."""
    A, limbs = np.concatenate([run.features for run in runs]), np.concatenate([run.limbs[run.seen] for run in runs])
    judged = np.concatenate([run.judged[run.seen] for run in runs])
    limb = rising(A[judged], limbs[judged])
    body = rising(two_most(limb, A, judged), np.concatenate([run.body[run.seen] for run in runs]))
    gone = np.concatenate([run.body[~run.seen] for run in runs])
    return limb, body, rising(np.concatenate([run.blind for run in runs]), gone)


def probabilities(run: Seen, weights: tuple[Float, Float, Float]) -> Float:
    """(N,) that the body is lost."""
    limb, body, unseen = weights
    z = np.zeros(len(run.body))
    z[run.seen] = body[0] + two_most(limb, run.features, run.judged[run.seen]) @ body[1:]
    z[~run.seen] = unseen[0] + run.blind @ unseen[1:]
    return 1.0 / (1.0 + np.exp(-z))


def judge(p: Float, lost: Bool) -> None:
    """Print how good probabilities (N,) are."""
    for threshold in (0.3, 0.5, 0.75):
        flag = p >= threshold
        precision, recall = (flag & lost).sum() / max(flag.sum(), 1), (flag & lost).sum() / lost.sum()
        silent = (lost & ~flag).mean()
        print(f"from {threshold}: precision {precision:.3f}, recall {recall:.3f}, lost and not flagged {silent:.2%}")
    for k in range(10):
        within = (10 * p).astype(int).clip(0, 9) == k
        share = lost[within].mean() if within.any() else np.nan
        said = p[within].mean() if within.any() else np.nan
        print(f"  {k / 10:.1f}-{k / 10 + 0.1:.1f}: {within.sum():6d} frames, lost {share:.2f}, said {said:.2f}")


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="1000-1131")
    parser.add_argument("--keep", type=Path, required=True)
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    runs = list(captures(range(int(first), int(last or first) + 1), options.keep))
    p, lost = list[Float](), list[Bool]()
    for fold in range(FOLDS):
        weights = fitted([run for k, run in enumerate(runs) if k % FOLDS != fold])
        p += [probabilities(run, weights) for run in runs[fold::FOLDS]]
        lost += [run.body for run in runs[fold::FOLDS]]
    print(f"{len(runs)} captures, {sum(map(len, p))} frames, {sum(int(a.sum()) for a in lost)} lost")
    judge(np.concatenate(p), np.concatenate(lost))
    limb, body, blind = fitted(runs)
    print(f"AGAIN = {limb[-1]:.4g}")
    for name, weights in (("LIMB", limb[:-1]), ("BODY", body), ("BLIND", blind)):
        print(f"{name} = ({', '.join(f'{w:.4g}' for w in weights)})")


if __name__ == "__main__":
    main()
