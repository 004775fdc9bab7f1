"""A camera that has been bumped is noticed by its background, and its turn is found by that.

A camera that is knocked turns by far more than it moves, as the room sees it. So what it shows beside the body is the
background that has been learnt, turned about the camera's centre. A turn is believed where the background fits after it
and did not before. A camera that was bumped may sway for a while: it is looked at in every frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.camera.bump import after_both
from twistcap.ranges import Checked, Positive, Share
from twistcap.search import Problem
from twistcap.search.recollection import Judged, Recollection
from twistcap.search.surroundings import Surroundings


@dataclass(frozen=True)
class BumpRule(Checked):
    """When a camera has been bumped. What fits of the background is a fraction of what is usual.

    Attributes:
        misfit: fraction that does not fit, from which on its background is looked at.
        more: by how much that must exceed what was looked at in vain, as a factor.
        fades: fraction that the memory of that keeps from frame to frame.
        far: fraction that does not fit after a small turn, from which on a larger one is looked for.
        unknown: fraction that is taken not to fit in a camera that is left out.
        left: most of the misfit that may be left after the turn, as a fraction.
        fitting: fraction of all pixels beside the body that must fit then.
        seen: fraction of the picture that must be comparable.
        least, farthest: rad; a smaller turn is none, a larger one is not looked for.
        stands: rad by which a camera may stand turned and is still thought to stand as it was calibrated.
        rough: rad, by which a camera must seem to have turned, roughly, for a closer look before it teaches anything.
        restless: fraction that a camera's unrest keeps from frame to frame after it was bumped; as long as there is
            `some`, the camera is looked at in every frame, and turns from `slight` rad on count.
        paying: most that may be left then of how badly the backgrounds agree, as a fraction; other people who move look
            like slight turns that leave nearly all of it.
    """

    misfit: Share = 0.015
    more: Positive = 1.5
    fades: Share = 0.98
    far: Share = 0.05
    unknown: Share = 0.5
    left: Share = 0.5
    fitting: Share = 0.8
    seen: Share = 0.3
    least: Positive = 0.001
    farthest: Positive = 0.1
    stands: Positive = 0.001
    rough: Positive = 0.0012
    restless: Share = 0.95
    some: Share = 0.2
    slight: Positive = 0.0003
    paying: Share = 0.9

    def bumps(self, unrest: Unrest, known: Recollection, now: Judged) -> tuple[Mapping[int, Float], Unrest]:
        """Turns (3,) of cameras that have been bumped just now, in their own frames as they were; and what is
        remembered.
        """
        misfit = np.nan_to_num(1.0 - now.check.fitting / known.fitting)
        misfit[list(now.problem.left_out)] = self.unknown
        in_vain, restless, found = self.fades * unrest.in_vain, self.restless * unrest.restless, dict[int, Float]()
        doubtful = (misfit > self.more * in_vain + self.misfit) | (restless > self.some)
        for camera in np.flatnonzero(doubtful).tolist():
            view = Surroundings.of(camera, known.backdrops[camera], now.fit.posed, now.problem)
            bump = self._bump(view, now.problem.bumps[camera], bool(restless[camera] > self.some))
            if bump is None:
                in_vain[camera] = max(misfit[camera], in_vain[camera])
            else:
                found[camera], restless[camera] = bump, 1.0
        return found, Unrest(in_vain, restless)

    def unseen(self, known: Recollection, problem: Problem) -> Mapping[int, Float]:
        """The same in a frame in which nobody knows where the body is."""
        found = dict[int, Float]()
        for camera, backdrop in enumerate(known.backdrops):
            view = Surroundings.of(camera, backdrop, None, problem)
            bump = self._bump(view, problem.bumps[camera], restless=False)
            if bump is not None:
                found[camera] = bump
        return found

    def _bump(self, view: Surroundings | None, before_that: Float, restless: bool) -> Float | None:
        """The turn of a camera after another one; that back to where it was calibrated, if it all but stands there."""
        if view is None or view.backdrop.size == (0, 0) or (turn := self._turn(view, restless)) is None:
            return None
        if np.linalg.norm(after_both(before_that, turn)) >= self.stands:
            return turn
        return -before_that if np.any(before_that) else None

    def _turn(self, view: Surroundings, restless: bool) -> Float | None:
        """The turn that a view tells clearly."""
        before, _ = view.fitting(np.zeros(3))
        turn = view.small_turn()
        after, share = view.fitting(turn)
        if 1.0 - after > self.far:
            turn = view.turn(self.farthest)
            after, share = view.fitting(turn)
        if after < self.fitting or share < self.seen:
            return None
        size = np.linalg.norm(turn)
        clear = size >= self.least and 1.0 - after <= self.left * (1.0 - before)
        return turn if clear or (restless and size >= self.slight and view.remaining(turn) <= self.paying) else None

    def moved(self, view: Surroundings) -> bool:
        """Whether a camera seems to have turned a little: no lesson is taken from what it shows then."""
        if not view.backdrop.lessons:
            return False
        turn, remaining = view.rough_turn()
        return float(np.linalg.norm(turn)) >= self.rough and remaining <= self.paying


@dataclass(frozen=True)
class Unrest:
    """What is remembered of each camera (C,).

    Attributes:
        in_vain: fraction of the background that did not fit when a bump was looked for in vain; less in each frame.
        restless: 1 where it has just been bumped; less in each frame.
    """

    in_vain: Float
    restless: Float

    @staticmethod
    def none(cameras: int) -> Unrest:
        """All stand still."""
        return Unrest(np.zeros(cameras), np.zeros(cameras))

    def of(self, moved: Sequence[int]) -> Unrest:
        """With cameras that have just moved."""
        restless = self.restless.copy()
        restless[list(moved)] = 1.0
        return replace(self, restless=restless)
