"""What the search for a lost body costs where nothing is lost: `python benchmarks/search_cost.py [--seeds 0-3]`.

Two trackers, one with and one without `LostBody`, take every frame, each the first in every other frame. Printed
is the ratio of their processor time (all threads) over the settled frames, and of the median frames. A machine that is
busy with other things hardly changes it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import process_time

import numpy as np

from twistcap.build import build
from twistcap.search.lost import LostBody
from twistcap.studio import StudioConfig, capture
from twistcap.track import Tracker

SETTLED, FRAMES = 15, 90  # the first frames compile, and are lessons more often


def milliseconds(seed: int, views: int, fps: float) -> np.ndarray:
    """(N, 2) of each settled frame with and without the search."""
    scene = capture(StudioConfig(seed=seed, views=views, frames=FRAMES, fps=fps))
    model = build(scene.body, scene.rig)
    plain = replace(model, searches=tuple(s for s in model.searches if not isinstance(s, LostBody)))
    trackers, out = (Tracker(model), Tracker(plain)), np.zeros((FRAMES, 2))
    for tracker in trackers:
        tracker.start(scene.first_pose)
    for n, frame in enumerate(scene.frames()):
        for k in (n % 2, 1 - n % 2):
            begun = process_time()
            trackers[k].step(frame)
            out[n, k] = 1e3 * (process_time() - begun)
    return out[SETTLED:]


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0-3")
    first, _, last = parser.parse_args().seeds.partition("-")
    for views, fps in ((2, 60.0), (4, 60.0), (4, 30.0)):
        each = [milliseconds(seed, views, fps) for seed in range(int(first), int(last or first) + 1)]
        ratios = ", ".join(f"{a[:, 0].sum() / a[:, 1].sum():.3f}" for a in each)
        together = np.concatenate(each)
        whole, middle = together.sum(axis=0), np.median(together, axis=0)
        print(f"{views} views, {fps:.0f} per second: {whole[0] / whole[1]:.3f} (medians {middle[0]:.2f} against "
              f"{middle[1]:.2f} ms: {middle[0] / middle[1]:.3f}; by seed {ratios})")  # fmt: skip


if __name__ == "__main__":
    main()
