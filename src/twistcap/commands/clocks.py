"""Whether the clocks of a finished track's cameras agree, in sentences."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from twistcap.adjust.clocks import Clocks
    from twistcap.adjust.watch import Watched
    from twistcap.estimate import Estimate

_FEWEST, _MOST = 12, 40  # consecutive frames by which clocks are judged: those in which the body moves most
_DIFFERENT = 0.3  # frames by which a clock must differ to be named
_SIGMAS = 6.0  # standard deviations by which it must differ


def watching(model: Any) -> Any:
    """The model, with a watch on three or more cameras. It has no say in the poses."""
    from twistcap.adjust.watch import CameraWatch
    from twistcap.track.model import Model

    if not isinstance(model, Model) or len(model.rig) < 3:
        return model
    return replace(model, cues=(*model.cues, CameraWatch()))


def watched_by(tracker: Any) -> Watched | None:
    """What a tracker's watch has seen; None without one."""
    from twistcap.adjust.watch import Watched

    memories = getattr(tracker.state, "cues", {}).values()
    return next((memory for memory in memories if isinstance(memory, Watched)), None)


def suspects(watched: Watched | None) -> tuple[int, ...]:
    """Numbers of the cameras that seem to stand elsewhere than they were calibrated."""
    return () if watched is None else tuple(np.flatnonzero(watched.since >= 0).tolist())


def clocks_in_words(session: Any, views: Any, result: Any, watched: Watched | None) -> list[str]:
    """A sentence for each camera whose images disagree with the others' in time, with the offset that mends it.

    Images are looked at again only where a clock was conspicuous in tracking: that costs some seconds.
    """
    from twistcap.adjust.clocks import estimate_clocks

    if watched is None or not watched.out_of_step().any() or len(result) < _FEWEST:
        return []
    chosen = liveliest(result.estimates, min(_MOST, len(result)))
    steps = {b.index - a.index for a, b in itertools.pairwise(chosen)}
    if len(steps) != 1:
        return []
    span = range(chosen[0].index, chosen[-1].index + 1, steps.pop())
    shown = replace(views, indices=span, moved=False)
    timeline, settings = views.timeline, session.tracker_settings
    own = [replace(e, left_out=e.swapped) for e in chosen]
    found = estimate_clocks(shown, result.body, views.image_rig, own, shown.lags, timeline.reference, settings)
    offsets = [session.clocks[name].offset if name in session.clocks else 0.0 for name in views.rig.names]
    return disagreements(found, views.rig.names, offsets, timeline.intervals[timeline.reference])


def disagreements(found: Clocks, names: Sequence[str], offsets: Sequence[float], frame: float) -> list[str]:
    """Sentences about clocks that differ from most; `offsets` are those of the session, `frame` the interval, s."""
    middle = float(np.median(found.late))  # the camera that stands for the time may be the one that is wrong
    late, sigma = found.late - middle, np.maximum(found.sigma, np.median(found.sigma))
    out = list[str]()
    for name, has, off, uncertain in zip(names, offsets, late, sigma, strict=True):
        if abs(off) > max(_DIFFERENT * frame, _SIGMAS * uncertain):
            how = f"{abs(off) / frame:.1f} ± {uncertain / frame:.1f} frames {'late' if off > 0 else 'early'}"
            mend = f"offset = {has + off:.4f} in [clocks.{name}] would mend it; or run twistcap sync"
            out.append(f"The clock of camera {name} disagrees with the others': its images are {how}; {mend}.")
    return out


def liveliest(estimates: Sequence[Estimate], count: int) -> list[Estimate]:
    """The run of so many frames in which the root and the joints move most; none that is lost. Empty without one."""
    if len(estimates) < count:
        return []
    kept = np.array([not e.lost and e.seen for e in estimates])
    steps = [np.abs(b.pose.minus(a.pose)) for a, b in itertools.pairwise(estimates)]
    moved = np.array([0.0, *(min(1.0, float(step[6:].sum() + 5.0 * step[3:6].sum())) for step in steps)])
    whole = np.convolve(kept, np.ones(count), "valid") == count
    if not whole.any():
        return []
    total = np.where(whole, np.convolve(moved, np.ones(count), "valid"), -1.0)
    start = int(np.argmax(total))
    return list(estimates[start : start + count])
