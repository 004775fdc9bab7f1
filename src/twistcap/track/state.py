"""Everything that the next frame depends on, as one frozen value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from twistcap.arrays import Bool, Float
from twistcap.estimate import Sources
from twistcap.predict.history import Past


@dataclass(frozen=True)
class State:
    """A track between two frames. It is written to the result file; `step` makes the next one and changes nothing.

    Attributes:
        past: poses, and how far the body is from where it is predicted.
        covariance: (6 + J, 6 + J) of the last pose's step, of what images and motion say; no pose prior is in it.
        claimed: (6 + J, 6 + J) the same as it is claimed, of samples that err together; no next frame depends on it.
        support: (S,) running fraction of each part's contour points that agree with the images.
        occluded: (S,) parts that no view shows.
        left_out: cameras that are not believed.
        bumps: (C, 3) turn of each camera from where it is calibrated, in its own frame, rad; 0 for none.
        sources: under which names the cameras' pictures come, if they are swapped.
        prints: fingerprints of the last frame's pictures, as `cues.view.with_news` makes them.
        learned: frames that have been learned from.
        cues, predictors, searches: their memories, by name.
    """

    past: Past
    covariance: Float
    claimed: Float
    support: Float
    occluded: Bool
    left_out: tuple[int, ...]
    bumps: Float
    sources: Sources
    prints: tuple[int, ...]
    learned: int
    cues: Mapping[str, Any]
    predictors: Mapping[str, Any]
    searches: Mapping[str, Any]

    def with_past(self, past: Past) -> State:
        """With other poses."""
        return replace(self, past=past)
