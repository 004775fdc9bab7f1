"""A camera that shows another moment than the others: its picture fits the body better where that was, or will be.

One picture is compared with the body a little back and a little ahead on its way; what a camera in step loses on both
sides, one that is late wins on one of them. A pose between those that the cameras show pleases each of them well
enough, so that no camera contradicts it: the differences are added up from frame to frame.
"""

from __future__ import annotations

from collections.abc import Collection, Set
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.ranges import Checked, Count
from twistcap.search.recollection import Judged, Recollection, fitted


@dataclass(frozen=True)
class OutOfStep:
    """What is remembered of each camera that has been looked at.

    Attributes:
        late, early: (C,) by how much its pictures have fitted the body better where it was, and where it would be.
        cameras: that are out of step.
        looked: the camera that was looked at last in its turn.
        against, tries: (C,) what has spoken for leaving each one out since one is suspect, and in how many frames.
    """

    late: Float
    early: Float
    against: Float
    cameras: tuple[int, ...] = ()
    looked: int = -1
    tries: int = 0

    @staticmethod
    def none(cameras: int) -> OutOfStep:
        """Nothing is known."""
        return OutOfStep(np.zeros(cameras), np.zeros(cameras), np.zeros(cameras))

    def of(self, left_out: Set[int]) -> OutOfStep:
        """With nothing against cameras that were out of step and are believed again."""
        again = [c for c in self.cameras if c not in left_out]
        return self.without(again) if again else self

    def without(self, cameras: Collection[int]) -> OutOfStep:
        """With nothing against some cameras."""
        kept = np.where(np.isin(np.arange(len(self.late)), list(cameras)), 0.0, 1.0)
        out = tuple(c for c in self.cameras if c not in cameras)
        return OutOfStep(kept * self.late, kept * self.early, 0.0 * self.against, out, self.looked)

    @property
    def most(self) -> Float:
        """(C,) how clearly each camera is out of step."""
        return np.maximum(self.late, self.early)


@dataclass(frozen=True)
class OutOfStepRule(Checked):
    """When a camera is out of step. Evidence is a ratio to what is usual for this body in this camera.

    Attributes:
        shift: m on the body's way, back and ahead, at which the picture of a camera is compared.
        frames: within which it must have moved by half of that.
        usual: difference between the two of a camera in step.
        clear: sum of what is more than usual, from which on a camera is suspect.
        most: that is remembered of it.
        each: by which another camera may agree more without one; that with which it disagrees most would say too much.
        enough: by how much more must speak for leaving one out than for any other one.
        tries: frames after which nothing is remembered if it is undecided which one it is.
    """

    shift: float = 0.04
    frames: Count = 6
    usual: float = 0.12
    clear: float = 0.4
    most: float = 0.8
    each: float = 0.1
    enough: float = 0.25
    tries: Count = 16

    def judged(self, memory: OutOfStep, known: Recollection, now: Judged, least: float) -> tuple[Judged, OutOfStep]:
        """The frame without a camera that is out of step with at least two others, whose evidence without it is at
        `least` that, and what is remembered.
        """
        seen = np.flatnonzero(~np.isnan(known.ratios(now.check)))
        if (len(seen) < 3 and not now.problem.left_out) or (ways := self._ways(now)) is None:
            return now, memory
        memory = self._looked(memory, known, now, ways)
        believed = sorted({*seen.tolist()} - now.problem.left_out)
        if len(believed) < 3 or memory.most[believed].max() < self.clear:
            return now, replace(memory, against=0.0 * memory.against, tries=0)
        if memory.tries == self.tries:
            return now, memory.without(believed)
        without = {c: fitted(known, now.problem.excluding(now.problem.left_out | {c})) for c in believed}
        against = memory.against.copy()
        for camera, others in without.items():
            against[camera] += self._against(known, now, camera, others)
        memory = replace(memory, against=against, tries=memory.tries + 1)
        second, first = np.sort(against)[-2:]
        if first < second + self.enough:
            return now, memory
        camera = int(against.argmax())
        others = without[camera]
        if not known.ratio(others.check) >= least:
            return now, memory
        memory = memory.without(memory.cameras)  # earlier ones may have been right
        return others, replace(memory, cameras=(camera,))

    def _looked(self, memory: OutOfStep, known: Recollection, now: Judged, ways: tuple[Pose, Pose]) -> OutOfStep:
        """After a look at the next camera in turn, and at those that have seemed out of step."""
        cameras = len(memory.late)
        turn = (memory.looked + 1) % cameras
        late, early, out = memory.late.copy(), memory.early.copy(), {*memory.cameras}
        for camera in sorted({turn, *np.flatnonzero(memory.most > 0.0).tolist()}):
            back, ahead = (self._evidence(known, now, camera, pose) for pose in ways)
            if not np.isnan(back - ahead):
                late[camera] = np.clip(late[camera] + back - ahead - self.usual, 0.0, self.most)
                early[camera] = np.clip(early[camera] + ahead - back - self.usual, 0.0, self.most)
        most = np.maximum(late, early)
        out = {c for c in out | set(now.problem.left_out) if most[c] > (0.0 if c in out else self.clear)}
        return replace(memory, late=late, early=early, cameras=tuple(sorted(out)), looked=turn)

    def _ways(self, now: Judged) -> tuple[Pose, Pose] | None:
        """Where the body was, `shift` back on its way, and where it will be; None where it hardly moves."""
        here, moments = now.fit.posed, now.problem.past.moments
        for moment in moments[: -self.frames - 1 : -1]:
            if not moment.seen:
                return None
            step = Posed(here.body, moment.pose).segment_middles - here.segment_middles
            moved = float(np.sqrt(np.mean(np.sum(step**2, axis=1))))
            if moved >= 0.5 * self.shift:
                way = here.pose.minus(moment.pose) * (self.shift / moved)
                return here.pose.retract(-way), here.pose.retract(way)
        return None

    @staticmethod
    def _evidence(known: Recollection, now: Judged, camera: int, pose: Pose) -> float:
        """Of the body in a pose, in the picture of one camera; NaN where it hardly shows it."""
        posed = Posed(now.fit.posed.body, pose)
        sight = None if now.problem.frame.images[camera] is None else now.problem.look(camera, posed)
        return float(known.ratios(known.check(posed, [] if sight is None else [sight], now.problem))[camera])

    def _against(self, known: Recollection, now: Judged, camera: int, others: Judged) -> float:
        """What speaks for leaving a camera out: by how much more the others agree without it, and by how much better
        its own picture fits back or ahead of where they see the body.
        """
        before, after = known.ratios(now.check), known.ratios(others.check)
        agree = float(np.nansum(np.minimum(np.delete(after - before, camera), self.each)))
        if (ways := self._ways(others)) is None:
            return agree
        back, here, ahead = (self._evidence(known, others, camera, p) for p in (ways[0], others.fit.pose, ways[1]))
        return agree + max(float(np.nan_to_num(max(back, ahead) - here)), 0.0)
