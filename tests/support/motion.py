"""Predictions one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from twistcap.motion import Expected, MotionPredictor
from twistcap.predict.history import Moment


def ahead(predictor: MotionPredictor, history: Sequence[Moment], times: Iterable[float]) -> list[Expected]:
    """What is expected at rising times after one history; each goes on from the one before."""
    memory, out = None, list[Expected]()
    for time in times:
        expected, memory = predictor.predict(history, time, memory)
        out.append(expected)
    return out
