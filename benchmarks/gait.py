"""`twistcap gait` on studio walks with noise of a known covariance: python benchmarks/gait.py [FIRST LAST].

For each seed a walk of 5 s at 60 frames per second, of a random speed, heading and phase, with white noise in all
joints. Per filter: the worst angle of the mean cycle against the noiseless walk (the same strides, unfiltered), and the
root mean square of all frames; the worst event (heel strike, toe-off, knee most bent) in frames.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from twistcap.body import Pose
from twistcap.body.humanoid import humanoid
from twistcap.camera import Rig
from twistcap.estimate import Estimate
from twistcap.evaluate.cycles import walking_angles
from twistcap.evaluate.events import event_times, parsed_event
from twistcap.evaluate.filters import Filter
from twistcap.evaluate.gait import SIDES, cycles, facing, gait_of
from twistcap.io.coordinates import coordinates_of
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.studio.motion import gait as walk

FPS, FRAMES, FINE = 60.0, 300, 20
FILTERS = (Filter(), Filter(cutoff=6.0), Filter("smoother"))


def made(poses: list[Pose], sigma: float, folder: Path) -> Result:
    body = humanoid()
    claimed = np.diag(np.repeat([1e-8, 1e-8, sigma**2], (3, 3, body.dof - 6)))
    with ResultWriter(folder / "r.h5", body, Rig(()), {}) as writer:
        for n, pose in enumerate(poses):
            writer.append(Estimate(n, n / FPS, pose, claimed))
    return read_result(folder / "r.h5")


def peaks(values: np.ndarray) -> np.ndarray:
    inner = values[1:-1]
    high = inner > values.min() + 0.7 * np.ptp(values)
    return np.flatnonzero((inner > values[:-2]) & (inner >= values[2:]) & high) + 1


def off(found: np.ndarray, truth: np.ndarray) -> float:
    """Frames from each event to the nearest true one, the worst."""
    return float(max(np.abs(truth - time).min() for time in found)) * FPS


def measured(seed: int, folder: Path) -> list[str]:
    rng, body = np.random.default_rng(seed), humanoid()
    speed, phase, sigma = rng.uniform(0.8, 1.6), rng.uniform(), np.deg2rad(rng.choice([0.3, 1.0, 2.0]))
    how = {"speed": speed, "heading": rng.uniform(-3, 3), "phase": phase}
    poses = walk(body, fps=FPS, frames=FRAMES, **how)
    fine = walk(body, fps=FPS * FINE, frames=FRAMES * FINE, **how)
    result = made([Pose(p.root, p.q + rng.normal(0, sigma, len(p.q))) for p in poses], sigma, folder)
    found = gait_of(result.body, result.times, result.poses, known=result.known)
    truth = coordinates_of(body, facing(found, poses)).in_degrees[0]
    knee = np.array([p.q[body.coordinate("knee_angle_r")] for p in fine])
    period = 120.0 / np.sqrt(speed * 60.0 / 0.0064)
    grid, events = np.arange(-10, 30), list[float]()
    for side, half in (("r", 0.0), ("l", 0.5)):
        events.append(off(found.strikes[side], (grid + half - phase) * period))
        events.append(off(found.toe_offs[side], (grid + half + 0.6 - phase) * period))
    words = [f"seed {seed}, {speed:.2f} m/s, sigma {np.degrees(sigma):.1f} deg"]
    for one in FILTERS:
        angles = walking_angles(found, result, one)
        turning = angles.table.turning
        means = [[cycles(found, result.times, v[:, turning], s).mean(0) for v in (angles.values, truth)] for s in SIDES]
        worst = max(float(np.abs(a - b).max()) for a, b in means)
        rms = float(np.sqrt(np.mean((angles.values - truth)[:, turning] ** 2)))
        bent = event_times(parsed_event("bent = knee_angle_r maximum"), result, angles)
        events.append(off(bent, peaks(knee) / (FPS * FINE)))
        words.append(f"{one.kind} {one.cutoff or ''}: cycle {worst:.2f}, rms {rms:.2f}".replace(" :", ":"))
    return [*words, f"events {max(events):.2f} frames"]


def main() -> None:
    first, last = map(int, sys.argv[1:3] or ("100", "107"))
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, last + 1):
            print(" | ".join(measured(seed, Path(folder))), flush=True)


if __name__ == "__main__":
    main()
