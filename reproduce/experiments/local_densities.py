"""C-2: local Gaussians against one Parzen density of the body and one of the background.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", Fig. 11.4.

    python -m reproduce C-2 --seeds 0-7 --out out/C-2
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from reproduce.contour_runs import Claim, arm_rows, both
from reproduce.running import Tell
from reproduce.scenes.elsewhere import elsewhere
from twistcap.build import build
from twistcap.evaluate import Row, row
from twistcap.studio import Capture, StudioConfig
from twistcap.track import Model, Settings

SCENE = StudioConfig(views=4, frames=30)
LOCAL = Settings(channels="grey", statistics="whole", brightness=False, density="local")
GLOBAL = Settings(channels="grey", statistics="whole", brightness=False, density="parzen")


def local_against_global(seeds: Sequence[int], progress: Tell, out: Path | None = None) -> list[Row]:
    """C-2: local Gaussians against one Parzen density of the body and one of the background, of the whole body in both.

    The contours of the direct method alone, before a room whose floor has the colour of the bare arms (`elsewhere`).

    Args:
        seeds: of the studio.
        progress: is called each time a seed is done.
        out: folder for a picture per seed: the last frame, local above, global below.
    """

    def arms(scene: Capture) -> Sequence[Model]:
        local, whole = (build(scene.body, scene.rig, settings) for settings in (LOCAL, GLOBAL))
        return local, whole

    local, whole = both("C-2", seeds, lambda seed: elsewhere(replace(SCENE, seed=seed)), arms, progress, out)
    ratios = [a.arms_mm / b.arms_mm for a, b in zip(local, whole, strict=True)]
    ratio = float(np.mean([a.arms_mm for a in local]) / np.mean([b.arms_mm for b in whole]))
    return [
        *arm_rows("C-2 local", local),
        *arm_rows("C-2 global Parzen", whole),
        row("C-2", "arm error, local to global", ratio, "ratio", at_most=0.5, seeds=ratios),
    ]


C2 = Claim(
    "C-2",
    "local Gaussians against one Parzen density of the body and one of the background: arms with the floor's colour",
    local_against_global,
)
