"""Whether the clocks of a finished track's cameras agree, told in sentences."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np

_FRAMES = 40  # consecutive ones by which clocks are judged: those in which the body moves most
_ROUNDS = 3
_DIFFERENT = 0.3  # frames by which a clock must differ to be named
_SIGMAS = 6.0  # standard deviations by which it must differ


def clocks_in_words(session: Any, views: Any, result: Any) -> list[str]:
    """A sentence for each camera whose images disagree with the others' in time, with the offset that mends it."""
    from twistcap.adjust.clocks import estimate_clocks

    chosen = _liveliest(result.estimates)
    steps = {b.index - a.index for a, b in itertools.pairwise(chosen)}
    if len(chosen) < _FRAMES // 2 or len(views.rig) < 3 or len(steps) != 1:
        return []
    span = range(chosen[0].index, chosen[-1].index + 1, steps.pop())
    shown = replace(views, indices=span, moved=False)
    timeline, settings = views.timeline, session.tracker_settings
    own = [replace(e, left_out=()) for e in chosen]
    found = estimate_clocks(
        shown, result.body, views.image_rig, own, shown.lags, timeline.reference, settings, _ROUNDS
    )  # fmt: skip
    middle = float(np.median(found.late))  # the camera that stands for the time may be the one that is wrong
    late, frame = found.late - middle, timeline.intervals[timeline.reference]
    sigma = np.maximum(found.sigma, np.median(found.sigma))
    out = list[str]()
    for name, off, uncertain in zip(views.rig.names, late, sigma, strict=True):
        if abs(off) > max(_DIFFERENT * frame, _SIGMAS * uncertain):
            has = session.clocks[name].offset if name in session.clocks else 0.0
            how = f"{abs(off) / frame:.1f} ± {uncertain / frame:.1f} frames {'late' if off > 0 else 'early'}"
            mend = f"offset = {has + off:.4f} in [clocks.{name}] would mend it; or run twistcap sync"
            out.append(f"The clock of camera {name} disagrees with the others': its images are {how}; {mend}.")
    return out


def _liveliest(estimates: Any) -> list[Any]:
    """The run of frames in which the root and the joints move most; none that is lost."""
    if len(estimates) <= _FRAMES:
        return list(estimates) if not any(e.lost for e in estimates) else []
    kept = np.array([not e.lost and e.seen for e in estimates])
    steps = [np.abs(b.pose.minus(a.pose)) for a, b in itertools.pairwise(estimates)]
    moved = np.array([0.0, *(min(1.0, float(step[6:].sum() + 5.0 * step[3:6].sum())) for step in steps)])
    whole = np.convolve(kept, np.ones(_FRAMES), "valid") == _FRAMES
    if not whole.any():
        return []
    total = np.where(whole, np.convolve(moved, np.ones(_FRAMES), "valid"), -1.0)
    start = int(np.argmax(total))
    return list(estimates[start : start + _FRAMES])
