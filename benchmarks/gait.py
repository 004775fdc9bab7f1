"""`twistcap gait` on studio walks: python benchmarks/gait.py [FIRST LAST] [--tracked] [--width PX].

For each seed a walk of 5 s at 60 frames per second, of a random speed, heading and phase, with white noise of a known
covariance in all joints; with `--tracked` 4 s rendered in four views and tracked. Per filter: the worst angle of the
mean cycle against the true walk (the same strides, unfiltered), and the root mean square of all frames; the worst event
(heel strike, toe-off, knee most bent) in frames. Tracking: add the studio's condition with `--condition mismatch`.
At the end a row for each angle, over all seeds and both sides: how far its mean cycle is off at the worst per cent
(median and worst walk), root mean squares of error and of claimed σ, and the share of errors within 2σ.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.body import Body, Pose
from twistcap.body.humanoid import humanoid
from twistcap.body.model import split_side
from twistcap.build import build
from twistcap.camera import Rig
from twistcap.estimate import Estimate
from twistcap.evaluate.cycles import cycles_of, walking_angles
from twistcap.evaluate.events import event_times, parsed_event
from twistcap.evaluate.filters import Filter
from twistcap.evaluate.gait import SIDES, cycles, facing, gait_of
from twistcap.hindsight import tracked
from twistcap.io.coordinates import coordinates_of
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.studio import StudioConfig, capture
from twistcap.studio.config import stream
from twistcap.studio.motion import gait as walk
from twistcap.studio.scene import default_body, default_poses, ring

FPS, FRAMES, TRACKED, FINE = 60.0, 300, 240, 20
RIG = ring(2, 4.0, 1.2, (0.0, 0.0, 0.9), (384, 280))  # a result file has cameras; nothing is seen by these
FILTERS = (Filter(), Filter(cutoff=6.0), Filter("smoother"))


@dataclass(frozen=True)
class Truth:
    """A walk: its body, poses at FPS and at FINE times that, speed (m/s), and the phase of the first frame."""

    body: Body
    poses: list[Pose]
    fine: list[Pose]
    speed: float
    phase: float

    @property
    def period(self) -> float:
        """s, of a stride."""
        return 120.0 / float(np.sqrt(self.speed * 60.0 / 0.0064))

    def times(self, phase: float) -> np.ndarray:
        """s, at which this phase comes."""
        return (np.arange(-10, 30) + phase - self.phase) * self.period


def written(body: Body, rig: Rig, estimates: Iterable[Estimate], folder: Path) -> Result:
    with ResultWriter(folder / "r.h5", body, rig, {}) as writer:
        for estimate in estimates:
            writer.append(estimate)
    return read_result(folder / "r.h5")


def noisy(seed: int, folder: Path) -> tuple[str, Truth, Result]:
    rng, body = np.random.default_rng(seed), humanoid()
    speed, phase, sigma = rng.uniform(0.8, 1.6), rng.uniform(), np.deg2rad(rng.choice([0.3, 1.0, 2.0]))
    how: dict[str, Any] = {"speed": speed, "heading": rng.uniform(-3, 3), "phase": phase}
    poses = walk(body, fps=FPS, frames=FRAMES, **how)
    truth = Truth(body, poses, walk(body, fps=FPS * FINE, frames=FRAMES * FINE, **how), speed, phase)
    claimed = np.diag(np.repeat([1e-8, 1e-8, sigma**2], (3, 3, body.dof - 6)))
    disturbed = (Pose(p.root, p.q + rng.normal(0, sigma, len(p.q))) for p in poses)
    result = written(body, RIG, (Estimate(n, n / FPS, p, claimed) for n, p in enumerate(disturbed)), folder)
    return f"sigma {np.degrees(sigma):.1f} deg", truth, result


def filmed(seed: int, condition: Any, width: int, folder: Path) -> tuple[str, Truth, Result]:
    size = (width, round(width * 280 / 384))
    config = StudioConfig(seed=seed, size=size, frames=TRACKED, fps=FPS, condition=condition)
    scene, body = capture(config), default_body(config)
    heading = float(stream(seed, "heading").uniform(0, 2 * np.pi))
    fine = default_poses(replace(config, fps=FPS * FINE, frames=TRACKED * FINE), body, heading)
    rng = stream(seed, "gait")
    truth = Truth(body, list(scene.true_poses), fine, float(rng.uniform(1.15, 1.45)), float(rng.uniform(0, 1)))
    model = build(scene.body, scene.rig)
    result = written(scene.body, scene.rig, tracked(scene.frames(), model, scene.first_pose), folder)
    return f"tracked, {condition}, {np.sum(result.lost)} frames lost", truth, result


def peaks(values: np.ndarray) -> np.ndarray:
    inner = values[1:-1]
    high = inner > values.min() + 0.7 * np.ptp(values)
    return np.flatnonzero((inner > values[:-2]) & (inner >= values[2:]) & high) + 1


def off(found: np.ndarray, truth: np.ndarray) -> float:
    """Frames from each event to the nearest true one, the worst."""
    return float(max(np.abs(truth - time).min() for time in found)) * FPS


def measured(truth: Truth, result: Result) -> list[str]:
    found = gait_of(result.body, result.times, result.poses, known=result.known)
    wanted = coordinates_of(truth.body, facing(found, truth.poses)).in_degrees[0]
    bent = peaks(np.array([p.q[truth.body.coordinate("knee_angle_r")] for p in truth.fine])) / (FPS * FINE)
    events, words = list[float](), [f"{truth.speed:.2f} m/s"]
    for side, half in (("r", 0.0), ("l", 0.5)):
        events += [off(found.strikes[side], truth.times(half)), off(found.toe_offs[side], truth.times(half + 0.6))]
    for one in FILTERS:
        angles = walking_angles(found, result, one)
        turning = angles.table.turning
        means = [
            [cycles(found, result.times, v[:, turning], s).mean(0) for v in (angles.values, wanted)] for s in SIDES
        ]
        gaps = np.abs(np.array([a - b for a, b in means])).max(axis=(0, 1))
        worst = int(np.argmax(gaps))
        name = [name for name, turns in zip(angles.table.names, turning, strict=True) if turns][worst]
        rms = float(np.sqrt(np.nanmean((angles.values - wanted)[:, turning] ** 2)))
        events.append(off(event_times(parsed_event("bent = knee_angle_r maximum"), result, angles), bent))
        words.append(
            f"{one.kind} {one.cutoff or ''}: cycle {gaps[worst]:.2f} ({name}), rms {rms:.2f}".replace(" :", ":")
        )
        if one == FILTERS[0]:
            legs = [g for g, n in zip(gaps, np.array(angles.table.names)[turning], strict=True)
                    if n.startswith(("hip", "knee", "ankle"))]  # fmt: skip
            words[-1] += f", hips knees ankles {max(legs):.2f}"
    return [*words, f"events {max(events):.2f} frames"]


def of_angles(truth: Truth, result: Result) -> dict[str, list[tuple[float, float, float, float]]]:
    """By angle, of each side: worst error of the mean cycle (deg), mean squares of error and σ, share within 2σ."""
    found = gait_of(result.body, result.times, result.poses, known=result.known)
    walk, out = walking_angles(found, result), dict[str, list[tuple[float, float, float, float]]]()
    wanted = replace(walk, values=coordinates_of(truth.body, facing(found, truth.poses)).in_degrees[0])
    ours, true = (cycles_of(found, result.times, one) for one in (walk, wanted))
    for name, cycle in ours.items():
        error = np.abs(cycle.mean - true[name].mean)
        within = float(np.mean(error < 2 * cycle.sigma))
        row = float(error.max()), float(np.mean(error**2)), float(np.mean(cycle.sigma**2)), within
        out.setdefault(split_side(name)[0], []).append(row)
    return out


def show(rows: dict[str, list[tuple[float, float, float, float]]]) -> None:
    print("angle: worst point of the cycle, deg (median, worst) | rms | rms of σ | within 2σ")
    for name, each in sorted(rows.items(), key=lambda item: float(np.median([row[0] for row in item[1]]))):
        worst, squares, claimed, within = np.array(each).T
        print(
            f"{name:17} {np.median(worst):5.2f} {worst.max():5.2f} | {np.sqrt(squares.mean()):5.2f} | "
            f"{np.sqrt(claimed.mean()):5.2f} | {within.mean():.2f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=[100, 107], help="first and last")
    parser.add_argument("--tracked", action="store_true")
    parser.add_argument("--condition", default="exact")
    parser.add_argument("--width", type=int, default=384, help="of the images, px")
    arguments = parser.parse_args()
    first, last = arguments.seeds
    rows = dict[str, list[tuple[float, float, float, float]]]()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, last + 1):
            place = Path(folder)
            how = arguments.condition, arguments.width
            made = filmed(seed, *how, place) if arguments.tracked else noisy(seed, place)
            words = measured(*made[1:])
            print(" | ".join([f"seed {seed}", made[0], *words]), flush=True)
            for name, row in of_angles(*made[1:]).items():
                rows.setdefault(name, []).extend(row)
    show(rows)


if __name__ == "__main__":
    main()
