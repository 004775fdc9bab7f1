"""Lost spans tracked again with the body that the rest of the sequence has put right."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from twistcap._typing import Bool
from twistcap.body import Body
from twistcap.camera import Rig
from twistcap.estimate import Estimate, Frame
from twistcap.settings import TrackerConfig
from twistcap.track import Tracker


def tracked_again(
    frames: Iterable[Frame], body: Body, rig: Rig, estimates: Sequence[Estimate], config: TrackerConfig, lead: float
) -> tuple[Estimate, ...]:
    """The estimates, with those of lost spans anew where fewer of them are lost then.

    Args:
        frames: those of the estimates.
        body, rig: to track with.
        estimates: with the refined poses.
        config: of the tracker; training motion is left out.
        lead: s before a span from which it is tracked, as a limb goes astray some time before it counts as lost.
    """
    redo = _to_redo(estimates, lead)
    if not redo.any() or config.method == "differential":
        return tuple(estimates)
    plain = replace(config, predictor="constant_velocity") if config.predictor == "motion" else config
    tracker, out = Tracker(body, rig, plain), list(estimates)
    for t, frame in enumerate(frames):
        if redo[t] and (t == 0 or not redo[t - 1]):
            if t == 0:
                tracker.start(estimates[0].pose, frame.time)
            else:
                tracker.restore(estimates[max(0, t - 2) : t])
        if redo[t]:
            out[t] = tracker.step(frame)
    return _better(estimates, out, redo)


def _to_redo(estimates: Sequence[Estimate], lead: float) -> Bool:
    """(F,) which frames are lost, or come so many seconds before one that is."""
    out, next_lost = np.zeros(len(estimates), dtype=np.bool_), np.inf
    for t, e in reversed(list(enumerate(estimates))):
        next_lost = e.time if e.lost else next_lost
        out[t] = next_lost - e.time <= lead
    return out


def _better(before: Sequence[Estimate], after: Sequence[Estimate], redo: Bool) -> tuple[Estimate, ...]:
    """Of each span that was done again, the estimates of which fewer are lost."""
    out = list(before)
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], redo, [False]]).astype(int)))
    for first, end in bounds.reshape(-1, 2):
        if sum(e.lost for e in after[first:end]) < sum(e.lost for e in before[first:end]):
            out[first:end] = after[first:end]
    return tuple(out)
