"""A judge that knows the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.body import Pose, Posed
from twistcap.search.judge import Judge
from twistcap.studio import StudioConfig
from twistcap.studio.scene import default_body

BODY = default_body(StudioConfig(seed=0))


@dataclass(frozen=True)
class Oracle(Judge):
    """A judge that knows the truth, and holds a pose against the start: nats by the square centimetre."""

    start: Pose
    truth: Pose

    def evidence(self, pose: Pose) -> float:
        return self._off(self.start) - self._off(pose)

    def _off(self, pose: Pose) -> float:
        there = Posed(self.body, self.truth).segment_middles
        return 1e4 * float(np.sum((Posed(self.body, pose).segment_middles - there) ** 2))
