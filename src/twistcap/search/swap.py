"""Cameras that give each other's pictures, as when two cables are swapped, are noticed by their backgrounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.estimate import Sources
from twistcap.ranges import Checked, Count, Share
from twistcap.search import Problem
from twistcap.search.backdrop import small_features
from twistcap.search.contradiction import Judged
from twistcap.search.recollection import Recollection


@dataclass(frozen=True)
class SwapRule(Checked):
    """When pictures have been swapped.

    Attributes:
        misfit: fraction of the background that fits, over what is usual, below which pictures are compared.
        every: frames between that while a camera is left out.
        shown: fraction of a background's pixels that fit, from which on a picture shows it.
        own: the same, below which a picture does not show its own camera's.
    """

    misfit: Share = 0.75
    every: Count = 3
    shown: Share = 0.5
    own: Share = 0.25

    def suspected(self, known: Recollection, now: Judged) -> bool:
        """Whether a background is no longer what it was; of a camera that is left out, nobody knows."""
        left_out = now.problem.left_out and now.problem.frame.index % self.every == 0
        return bool(left_out or np.any(now.check.fitting < self.misfit * known.fitting))  # NaN is not

    def sources(self, known: Recollection, problem: Problem) -> Sources:
        """Where each camera's picture is, if some cameras show each other's backgrounds; () if not."""
        pictured = [c for c, image in enumerate(problem.frame.images) if image is not None]
        strange = [c for c in pictured if 0.0 <= self._shown(known, problem, c, c) < self.own]
        shows = {c: self._most(known, problem, c, strange) for c in (strange if len(strange) > 1 else ())}
        shows = {c: of for c, of in shows.items() if of is not None}
        if not shows or {*shows} != {*shows.values()}:
            return ()
        of = {camera: c for c, camera in shows.items()}
        return tuple(of.get(camera, camera) for camera in range(len(known.backdrops)))

    def _most(self, known: Recollection, problem: Problem, camera: int, others: Sequence[int]) -> int | None:
        """Which other camera's background a picture shows."""
        each = {of: self._shown(known, problem, camera, of) for of in others if of != camera}
        best = max(each, key=lambda of: each[of])
        return best if each[best] >= self.shown else None

    @staticmethod
    def _shown(known: Recollection, problem: Problem, camera: int, of: int) -> float:
        """Fraction of one camera's background that a picture shows; -1 where they cannot be compared."""
        backdrop, image = known.backdrops[of], problem.frame.images[camera]
        if image is None or backdrop.size == (0, 0) or problem.rig[camera].size != problem.rig[of].size:
            return -1.0
        return backdrop.shown(small_features(image, backdrop.size, problem.channels))
