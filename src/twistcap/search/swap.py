"""Cameras that give each other's pictures, as when two cables are swapped, are noticed by their backgrounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.estimate import Sources
from twistcap.ranges import Checked, Count, Share
from twistcap.search import Problem
from twistcap.search.backdrop import small_features
from twistcap.search.recollection import Judged, Recollection, fitted


@dataclass(frozen=True)
class SwapRule(Checked):
    """When pictures have been swapped.

    Attributes:
        misfit: fraction of the background that fits, over what is usual, below which pictures are compared.
        every: frames between that while a camera is left out.
        good: evidence of the body over what is usual, from which on the sorting is believed if cameras were left out.
        shown: fraction of a background's pixels that fit, from which on a picture shows it. Two cameras in one room
            may have a third of them in common.
        clear: by how much more of another background must fit than of its own.
    """

    misfit: Share = 0.75
    every: Count = 3
    good: float = 0.8
    shown: Share = 0.5
    clear: Share = 0.25

    def sorted_by(self, known: Recollection, now: Judged, frames: int) -> tuple[Sources, Judged]:
        """The frame with each camera's picture from where it is, if the body is clearer then; () and as it is if not.

        Exposures that waver may make the plain walls of two cameras alike. Where swapped cameras were left out, the
        others alone are no measure: fewer cameras are easier to please. `frames` are counted.
        """
        sources = self.sources(known, now.problem) if self._suspected(known, now, frames) else ()
        if not sources:
            return (), now
        again = fitted(known, now.problem.sorted_by(sources))
        before = self.good if again.problem.left_out != now.problem.left_out else known.ratio(now.check)
        clearer = np.nan_to_num(known.ratio(again.check)) >= np.nan_to_num(before)
        return (sources, again) if clearer else ((), now)

    def _suspected(self, known: Recollection, now: Judged, frames: int) -> bool:
        """Whether a background is no longer what it was; of a camera that is left out, nobody knows."""
        left_out = now.problem.left_out and frames % self.every == 0
        return bool(left_out or np.any(now.check.fitting < self.misfit * known.fitting))  # NaN is not

    def sources(self, known: Recollection, problem: Problem) -> Sources:
        """Where each camera's picture is, if some cameras show each other's backgrounds; () if not."""
        pictured = [c for c, image in enumerate(problem.frame.images) if image is not None]
        own = {c: self._shown(known, problem, c, c) for c in pictured}
        strange = [c for c in pictured if 0.0 <= own[c] < self.shown]
        shows = {c: self._most(known, problem, c, strange, own[c]) for c in (strange if len(strange) > 1 else ())}
        shows = {c: of for c, of in shows.items() if of is not None}
        if not shows or {*shows} != {*shows.values()}:
            return ()
        of = {camera: c for c, camera in shows.items()}
        return tuple(of.get(camera, camera) for camera in range(len(known.backdrops)))

    def _most(
        self, known: Recollection, problem: Problem, camera: int, others: Sequence[int], own: float
    ) -> int | None:
        """Which other camera's background a picture shows, of which it shows so much of its own."""
        each = {of: self._shown(known, problem, camera, of) for of in others if of != camera}
        best = max(each, key=lambda of: each[of])
        return best if each[best] >= max(self.shown, own + self.clear) else None

    @staticmethod
    def _shown(known: Recollection, problem: Problem, camera: int, of: int) -> float:
        """Fraction of one camera's background that a picture shows; -1 where they cannot be compared."""
        backdrop, image = known.backdrops[of], problem.frame.images[camera]
        if image is None or backdrop.size == (0, 0) or problem.rig[camera].size != problem.rig[of].size:
            return -1.0
        return backdrop.shown(small_features(image, backdrop.size, problem.channels))
