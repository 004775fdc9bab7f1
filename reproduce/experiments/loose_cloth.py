"""T-cloth: what the support maps of the main tracker's brightness cue are worth where clothes are loose.

The counterpart of T-EM (Bregler and Malik, CVPR 1998, section 2.4) for contours and brightness together: two views,
body and cameras exact, and a picture that slides over the body by up to 3 cm while things pass behind it.

    python -m reproduce T-cloth --seeds 0-7 --out out/T-cloth
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from reproduce.arms import Arm, Comparison, Trace, by_arm
from reproduce.sequence import joint_errors_mm
from twistcap.cues.brightness import LOOSE_CLOTHES, Brightness
from twistcap.estimate import Estimate
from twistcap.evaluate.metrics import Row, row
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, Settings

ON, OFF = "support maps", "the default"


def _of(brightness: Brightness) -> Callable[[Model], Model]:
    return partial(Model.with_cue, cue=brightness)


ARMS = (
    Arm(ON, Settings(), changed=_of(LOOSE_CLOTHES)),
    Arm("robust scales", Settings(), changed=_of(replace(LOOSE_CLOTHES, support="robust"))),
    Arm("the same noise without maps", Settings(), changed=_of(replace(LOOSE_CLOTHES, support="none"))),
    Arm(OFF, Settings()),
    Arm("no brightness", Settings(brightness=False)),
)


def _scene(seed: int) -> Capture:
    return capture(StudioConfig(seed=seed, views=2, cloth=0.03, passers=4))


def _joints_mm(scene: Capture, estimate: Estimate) -> float:
    return float(joint_errors_mm(scene, scene.body, [estimate.pose], [estimate.index]).mean())


def _rows(traces: Sequence[Trace]) -> list[Row]:
    out, errors = list[Row](), dict[str, list[float]]()
    for arm in (a.name for a in ARMS):
        found = by_arm(traces, arm)
        errors[arm] = [float(t.joints_mm.mean()) for t in found]
        lost = sum(t.lost for t in found)
        out.append(row(f"T-cloth {arm}", "joints", float(np.mean(errors[arm])), "mm", seeds=errors[arm], lost=lost))
    ratio = float(np.mean(errors[ON]) / np.mean(errors[OFF]))
    each = [a / b for a, b in zip(errors[ON], errors[OFF], strict=True)]
    out.append(row("T-cloth", "with maps to without", ratio, "ratio", at_most=2 / 3, seeds=each))
    return out


T_CLOTH = Comparison(
    "T-cloth",
    "two views, the clothes loose and clutter moving behind: support maps of the brightness cue on, against off",
    "mean error of the joints, mm",
    _scene,
    ARMS,
    _joints_mm,
    _rows,
    shown=(40, 0),
)
