"""Render a synthetic walk, track it, and compare with the truth.

python examples/01_studio_walk.py
"""

import numpy as np

from twistcap.body import Posed
from twistcap.build import build
from twistcap.hindsight import tracked
from twistcap.studio import StudioConfig, capture


def main(frames: int = 30, views: int = 4) -> float:
    """Track and print; returns the mean joint error, mm."""
    walk = capture(StudioConfig(seed=0, views=views, frames=frames, condition="mismatch"))
    errors: list[float] = []
    for estimate in tracked(walk.frames(), build(walk.body, walk.rig), walk.first_pose):
        ours = Posed(walk.body, estimate.pose).landmarks
        off = 1000 * np.linalg.norm(ours - walk.landmarks[estimate.index], axis=1)
        errors.append(float(off.mean()))
        print(f"frame {estimate.index:3d}  {errors[-1]:5.1f} mm  support {estimate.support:.2f}  {estimate.status}")
    return float(np.mean(errors))


if __name__ == "__main__":
    print(f"mean {main():.1f} mm")
