"""What bumped and swaying cameras do to a track: studio walks whose cameras are turned while they film.

    python -m benchmarks.turning_cameras --seeds 0-7

In each case one camera or all are turned for good after 20 frames, or all sway all the time: about each axis to and fro
at 0.2 to 0.8 Hz. It prints the mean joint error before and after the twentieth frame, the worst joint after it, frames
that are lost and that are flagged, and by how much the turns that the tracker found are off in the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reproduce.faults.kinds import kind_named, take_of
from reproduce.faults.runs import errors_mm
from reproduce.faults.take import Take
from twistcap.arrays import Float
from twistcap.build import build
from twistcap.camera.bump import after_both
from twistcap.evaluate.metrics import JOINT_CENTRES, LOST_FRAME_MM
from twistcap.hindsight import tracked

START = 20


@dataclass(frozen=True)
class Case:
    """How cameras turn: the `one` or `all` for good, or `sway`, by so many degrees."""

    how: str
    degrees: float

    def bumps(self, seed: int, count: int, cameras: int, fps: float) -> Float:
        """(N, C, 3) turns, rad."""
        rng, out = np.random.default_rng(seed), np.zeros((count, cameras, 3))
        if self.how == "sway":
            hertz, phase = rng.uniform(0.2, 0.8, (cameras, 3)), rng.uniform(0.0, 2.0 * np.pi, (cameras, 3))
            angle = 2.0 * np.pi * hertz * (np.arange(count) / fps)[:, None, None] + phase
            return np.deg2rad(self.degrees) * (np.sin(angle) - np.sin(phase))
        axes = rng.standard_normal((cameras, 3))
        turned = slice(0, 1 if self.how == "one" else cameras)
        out[START:, turned] = np.deg2rad(self.degrees) * (axes / np.linalg.norm(axes, axis=1)[:, None])[turned]
        return out


CASES = (
    Case("one", 0.0), Case("one", 0.3), Case("one", 1.0), Case("one", 3.0), Case("all", 1.0), Case("all", 3.0),
    Case("sway", 0.2), Case("sway", 0.5), Case("sway", 2.0),
)  # fmt: skip


def row(case: Case, seed: int) -> tuple[float, ...]:
    """Mean mm before and after, worst mm after, frames lost and flagged, and degrees of the last turns."""
    take: Take = take_of(seed, kind_named("clean"))
    bumps = case.bumps(seed, take.count, take.views, take.scene.config.fps)
    take = take.staged(bumps=bumps)
    estimates = list(tracked(take.frames(), build(take.scene.body, take.scene.rig), take.first_pose))
    errors = errors_mm(take, [e.pose for e in estimates], JOINT_CENTRES)
    mean, worst = errors.mean(axis=1), errors.max(axis=1)
    found = np.zeros_like(bumps[-1]) if estimates[-1].bumps is None else estimates[-1].bumps
    off = max(np.rad2deg(np.linalg.norm(after_both(f, -b))) for f, b in zip(found, bumps[-1], strict=True))
    lost, flagged = int((worst > LOST_FRAME_MM).sum()), sum(e.lost for e in estimates)
    return (
        float(mean[8:START].mean()),
        float(mean[START:].mean()),
        float(worst[START:].max()),
        lost,
        flagged,
        float(off),
    )


def table(seeds: Sequence[int]) -> None:
    """Print a row for each case: medians over the seeds, and sums of frames."""
    print("case        before  after  worst seed  worst joint   lost flagged  turn off (worst)")
    for case in CASES:
        rows = np.array([row(case, 22 * seed) for seed in seeds])  # every 22nd is without other faults
        before, after, off = np.median(rows[:, 0]), np.median(rows[:, 1]), rows[:, 5].max()
        worst, joint = rows[:, 1].max(), rows[:, 2].max()
        print(f"{case.how:>4} {case.degrees:3.1f} deg {before:6.1f} {after:6.1f} mm {worst:6.1f} mm {joint:8.0f} mm"
              f" {rows[:, 3].sum():6.0f} {rows[:, 4].sum():6.0f}  {off:6.3f} deg", flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--seeds", default="0-7")
    first, _, last = parser.parse_args().seeds.partition("-")
    table(range(int(first), int(last or first) + 1))


if __name__ == "__main__":
    main()
