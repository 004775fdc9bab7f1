"""How true the claimed covariance is: `python benchmarks/claimed_covariance.py [--json] [--seeds 0-7] [CASE …]`.

The share of errors within two standard deviations in studio captures, for each kind of coordinate; 0.90 to 0.98 is
asked for. Docs: docs/concepts/covariance.md. Two minutes for a case of eight seeds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.build import build
from twistcap.evaluate.metrics import angle_differences_deg
from twistcap.studio import StudioConfig, capture
from twistcap.studio.config import Condition
from twistcap.track import Settings, Tracker

KINDS: Mapping[str, tuple[str, ...]] = {
    "hip flexion": ("hip_flexion",),
    "hip adduction": ("hip_adduction",),
    "hip rotation": ("hip_rotation",),
    "knee": ("knee_angle",),
    "ankle": ("ankle_angle",),
    "subtalar": ("subtalar",),
    "shoulder": ("arm_add", "arm_flex"),
    "upper arm rotation": ("arm_rot",),
    "elbow": ("elbow_flex",),
    "pronation": ("pro_sup",),
    "trunk": ("lumbar",),
    "lumbar rotation": ("lumbar_rotation",),
    "neck": ("neck",),
}
"""Kinds of joint coordinates by how their names begin; the root's turn and place come beside them."""

_METHODS = {"direct": Settings(), "levelset": Settings(method="levelset")}


def _cases() -> dict[str, tuple[StudioConfig, Settings, int]]:
    """Scene, settings and step between frames of each case, by name."""
    conditions: tuple[Condition, ...] = ("exact", "mismatch")
    cases = {
        f"{views}-views-{condition}-{method}": (StudioConfig(views=views, condition=condition), settings, 1)
        for views in (4, 2, 3, 8)
        for condition in conditions
        for method, settings in _METHODS.items()
    }
    slow = StudioConfig(views=4, condition="mismatch"), Settings(predictor="constant_velocity"), 2
    return {**cases, "4-views-mismatch-30fps": slow}


CASES = _cases()


def scores(case: str, seed: int) -> tuple[Float, tuple[str, ...]]:
    """Errors (N, 6 + J) of a track in standard deviations, and the names of the coordinates; the root about itself."""
    config, settings, every = CASES[case]
    scene = capture(replace(config, seed=seed))
    tracker, out = Tracker(build(scene.body, scene.rig, settings)), list[Float]()
    tracker.start(scene.first_pose)
    for k in range(0, config.frames, every):
        estimate = tracker.step(scene.frame(k))
        error = estimate.pose.minus(scene.true_poses[estimate.index])
        error[6:] = np.radians(angle_differences_deg(error[6:], np.zeros(len(error) - 6)))
        about = np.eye(len(error))  # from a step about the world's origin to one about the root
        about[3:6, :3] = -se3.hat(estimate.pose.root[:3, 3])
        sigma = np.sqrt(np.diagonal(about @ estimate.covariance @ about.T))
        out.append((about @ error) / sigma)
    return np.array(out), scene.body.coordinate_names


def shares(case: str, seeds: Sequence[int]) -> dict[str, float]:
    """Share of the errors of each kind within two standard deviations."""
    found = [scores(case, seed) for seed in seeds]
    inside, names = np.abs(np.concatenate([z for z, _ in found])) <= 2.0, found[0][1]
    columns = {kind: [6 + k for k, n in enumerate(names) if n.startswith(starts)] for kind, starts in KINDS.items()}
    columns |= {"root rotation": [0, 1, 2], "root position": [3, 4, 5]}
    return {kind: float(inside[:, which].mean()) for kind, which in columns.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; all by default")
    parser.add_argument("--seeds", default="0-7", help="first and last seed, as 0-7")
    parser.add_argument("--json", action="store_true", help="print JSON")
    given = parser.parse_args()
    if unknown := [case for case in given.cases if case not in CASES]:
        parser.error(f"there is no case {unknown[0]!r}; choose of {', '.join(CASES)}")
    first, _, last = given.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    found = {case: shares(case, seeds) for case in given.cases or CASES}
    if given.json:
        print(json.dumps(found))
        return
    for case, by_kind in found.items():
        print(f"{case}: " + ", ".join(f"{kind} {share:.2f}" for kind, share in by_kind.items()))


if __name__ == "__main__":
    main()
