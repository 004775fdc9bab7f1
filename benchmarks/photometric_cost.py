"""What brightness costs: `python benchmarks/photometric_cost.py`.

Milliseconds per frame of the default tracker with and without its photometric term, one after the other on the same
frames, the median frame of five runs; and the term's share. Run it on a quiet machine, with one thread.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from twistcap.build import build
from twistcap.estimate import Frame
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Settings, Tracker

RUNS, SETTLED = 5, 5  # a first run compiles; frames at the start take coarse alternations


def median_ms(scene: Capture, frames: Sequence[Frame], photometric: bool) -> float:
    """Of the frames of one run."""
    tracker, times = Tracker(build(scene.body, scene.rig, Settings(brightness=photometric))), list[float]()
    tracker.start(scene.first_pose, frames[0].time)
    for frame in frames:
        begun = perf_counter()
        tracker.step(frame)
        times.append(1e3 * (perf_counter() - begun))
    return float(np.median(times[SETTLED:]))


def main() -> None:
    for views in (4, 2):
        scene = capture(StudioConfig(seed=0, views=views, frames=60))
        frames = list(scene.frames())
        runs = np.array([[median_ms(scene, frames, on) for on in (True, False)] for _ in range(1 + RUNS)])[1:]
        on, off = np.median(runs, axis=0)
        shares = ", ".join(f"{100 * share:.0f}" for share in 1.0 - runs[:, 1] / runs[:, 0])
        print(f"{views} views: {on:.2f} ms, without {off:.2f} ms: {100 * (1 - off / on):.0f} % (each run: {shares})")


if __name__ == "__main__":
    main()
