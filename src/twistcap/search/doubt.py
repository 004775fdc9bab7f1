"""A body that is in doubt is looked for again near where it is fitted.

Limbs that went astray together often look nearly right: nothing calls for a search, and no limb alone finds a better
place. The pictures still tell, if all limbs may move at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from twistcap.arrays import Float
from twistcap.ranges import Checked, Count, Range, Share
from twistcap.search.flag import FlagRule


@dataclass(frozen=True)
class Doubt:
    """When the body was looked for.

    Attributes:
        waiting: frames until it is looked for again, if it is in doubt then.
        pause: between the last two such searches.
    """

    waiting: int = 0
    pause: int = 0


@dataclass(frozen=True)
class DoubtRule(Checked):
    """When a body is in doubt, and what it must gain elsewhere.

    Attributes:
        doubtful: probability of being lost from which on it is looked for. Of the fault bench's lost frames 89 %
            have it, and of those that are right 9 %.
        newly_found: what is left of the doubt in a body that a search has found, from which on it is looked for again:
            the draws of one search may all have missed it.
        gain: evidence that it must gain, as a fraction of what is usual.
        near: m that the root may move. It is the limbs that are in doubt: where cameras contradict each other, one that
            is wrong would pull the whole body aside.
        moved: m, limbs that are moved farther have been found, and are doubted as such.
        again, longest: frames until it is looked for again. They double up to the longest where it was not found.
        flag: tells that probability.
    """

    doubtful: Share = 0.01
    newly_found: Share = 0.3
    gain: float = 0.04
    near: Annotated[float, Range(0.0, 10.0)] = 0.1
    moved: Annotated[float, Range(0.0, 1.0)] = 0.05
    again: Count = 3
    longest: Count = 32
    flag: FlagRule = field(default_factory=FlagRule)

    def due(self, doubt: Doubt, signs: Float | None, lately: Float | None, found: float = 0.0) -> tuple[bool, Doubt]:
        """Whether it is looked for now, by signs of loss (G, SIGNS) now and lately, or because it has been `found`; and
        the doubt after this frame.
        """
        waiting = max(doubt.waiting - 1, 0)
        calm = signs is None or lately is None or self.probability(signs, lately) < self.doubtful
        if calm and found < self.newly_found:
            return False, Doubt(waiting, max(doubt.pause - 1, 0))
        return doubt.waiting == 0, replace(doubt, waiting=waiting)

    def probability(self, signs: Float, lately: Float) -> float:
        """Of being lost, by the signs alone."""
        return self.flag.whole(self.flag.limbs(signs, lately, np.zeros(len(signs))))

    def in_vain(self, doubt: Doubt) -> Doubt:
        """After a search that has found nothing better."""
        pause = min(max(2 * doubt.pause, self.again), self.longest)
        return Doubt(pause, pause)

    @property
    def settled(self) -> Doubt:
        """After a search that has found the body elsewhere."""
        return Doubt(self.again)

    @property
    def begun(self) -> Doubt:
        """After a search that has found the body anywhere."""
        return Doubt(1)
