"""A camera that shows another moment than the others: its picture fits the body better where that was, or will be.

The evidence of each picture is asked for where the body is, a little back and a little ahead on its way: three values
of a parabola, whose top says how early or late the picture is. What the looks say is added up by least squares. A
camera that is early draws the body ahead, so that the one that faces it seems late. So the frame is fitted without each
of the two that are most clearly apart. Odd is the one without which the cameras that are neither agree more; how much
better its own picture then fits elsewhere on the way counts too, for less. One that was early, and without which it is
late, was not odd: something else put the body beside where it is, as a person who hides a limb from another camera.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float, Int
from twistcap.body import Pose, Posed
from twistcap.ranges import Checked, Count, Positive, Share
from twistcap.search.recollection import Judged, Recollection, fitted

_QUIET = 0.75  # of the evidence for two cameras not being in step, below which every other frame is looked at


@dataclass(frozen=True)
class OutOfStep:
    """What is remembered of each camera.

    Attributes:
        sums: (2, C) normal equations of the s by which the moment of each picture is after the body's: information,
            right side.
        against: (C,) what has spoken for leaving each one out.
        sides: (C,) whether each one that is left out was early, 1, or late, −1; else 0.
        cameras: that are out of step.
        tries: lately made in vain to tell which camera is odd; waiting: frames until the next one.
        looked: whether the last frame was looked at. Where all is quiet, only every other one is.
    """

    sums: Float
    against: Float
    sides: Float
    cameras: tuple[int, ...] = ()
    tries: float = 0.0
    waiting: int = 0
    looked: bool = False

    @staticmethod
    def none(cameras: int) -> OutOfStep:
        """Nothing is known."""
        return OutOfStep(np.zeros((2, cameras)), np.zeros(cameras), np.zeros(cameras))

    def of(self, left_out: Set[int]) -> OutOfStep:
        """With nothing against cameras that are believed again, as all are when the body is lost."""
        again = [c for c in self.cameras if c not in left_out]
        kept = np.where(np.isin(np.arange(len(self.against)), again), 0.0, 1.0)
        out = tuple(c for c in self.cameras if c in left_out)
        sides = np.where(np.isin(np.arange(len(self.sides)), list(left_out)), self.sides, 0.0)
        if not again and np.array_equal(sides, self.sides):
            return self
        return replace(self, sums=kept * self.sums, against=kept * self.against, sides=sides, cameras=out)

    def leaving_out(self, camera: int, side: float) -> OutOfStep:
        """With one more camera out of step. What it said of a body that it had a say in says nothing now."""
        this = np.arange(len(self.against)) == camera
        sums, sides = np.where(this, 0.0, self.sums), np.where(this, side, self.sides)
        return replace(OutOfStep.none(len(self.against)), sums=sums, sides=sides, cameras=(*self.cameras, camera))

    def begun_anew(self) -> OutOfStep:
        """For another track through the same recording, maybe backward: the cameras that are out of step are known."""
        return replace(OutOfStep.none(len(self.against)), cameras=self.cameras)

    @property
    def ahead(self) -> Float:
        """(C,) s by which the moment of each picture is after the body's; 0 where nothing is known."""
        return self.sums[1] / np.maximum(self.sums[0], 1e-12)

    def apart(self, left_out: Set[int]) -> Float:
        """(C,) s by which each picture is ahead of most of those that are believed."""
        believed = [c for c in range(len(self.against)) if c not in left_out]
        return self.ahead - np.median(self.ahead[believed])

    def most_apart(self, cameras: Int, least: float) -> tuple[int, int, float]:
        """The two of some cameras of which it is clearest that one is ahead of the other, the early one first; and how
        clear that is: evidence, 0 where none is ahead by `least` s.
        """
        ahead, errors = self.ahead[cameras], 1.0 / np.maximum(self.sums[0, cameras], 1e-12)
        apart = ahead[:, None] - ahead
        clear = np.where(apart >= least, apart / np.sqrt(errors[:, None] + errors), 0.0)
        early, late = np.unravel_index(clear.argmax(), clear.shape)
        return int(cameras[early]), int(cameras[late]), float(clear[early, late])


@dataclass(frozen=True)
class OutOfStepRule(Checked):
    """When a camera is out of step. Evidence is a ratio to what is usual for this body in this camera.

    Attributes:
        shift: m on the body's way, back and ahead, at which the picture of a camera is compared.
        within: s in which the body must have moved by half of that.
        kept: of what earlier looks have said, from look to look.
        apart: s by which one of two cameras must be ahead of the other for one of them to be out of step.
        clear: evidence that speaks for two cameras not being in step.
        own: weight of a camera's own picture among what speaks for leaving it out.
        enough: by how much more must speak for leaving out the one than the other.
        faded: what is left, after a frame in which no camera is suspect, of what has spoken for it.
        prompt, longest: tries in vain after which each pause is a frame longer, and the longest pause, in frames.
    """

    shift: Positive = 0.04
    within: float = 0.1
    kept: Share = 0.8
    apart: float = 0.006
    clear: float = 0.12
    own: float = 0.25
    enough: float = 0.125
    faded: Share = 0.95
    prompt: Count = 16
    longest: Count = 16

    def judged(self, memory: OutOfStep, known: Recollection, now: Judged, least: float) -> tuple[Judged, OutOfStep]:
        """The frame without a camera that is out of step with at least two others, and what is remembered.

        Where the pictures do not agree with the body by `least`, nothing is known of its way, nor of any camera.
        """
        seen = np.flatnonzero(~np.isnan(known.ratios(now.check))).astype(np.int32)
        few = len(seen) < (2 if now.problem.left_out else 3)
        if few or not known.ratio(now.check) >= least:
            return now, replace(memory, cameras=())
        if (way := self._way(now)) is None:
            return now, memory
        quiet = not memory.cameras and memory.most_apart(seen, self.apart)[2] < _QUIET * self.clear
        if memory.looked and quiet:
            return now, replace(memory, looked=False)
        memory = self._looked(memory, known, now, way)
        left_out = now.problem.left_out - self._wronged(memory, now.problem.left_out)
        if left_out != now.problem.left_out:
            return fitted(known, now.problem.excluding(left_out)), replace(memory.of(left_out), waiting=self.longest)
        early, late, clear = memory.most_apart(seen, self.apart)
        if len(seen) < 3 or clear < self.clear:
            return now, replace(memory, against=self.faded * memory.against, tries=self.faded * memory.tries)
        if memory.waiting:
            return now, replace(memory, waiting=memory.waiting - 1)
        without = {c: fitted(known, now.problem.excluding(now.problem.left_out | {c})) for c in (late, early)}
        against = self._against(known, now, without, way[0])
        against[[early, late]] -= 0.5 * against[[late, early]].sum()  # what speaks for both says nothing
        memory = replace(memory, against=memory.against + against)
        more = memory.against[early] - memory.against[late]
        odd = early if more > 0.0 else late
        if abs(more) < self.enough or not known.ratio(without[odd].check) >= least:
            pause = min(int(memory.tries) // self.prompt, self.longest)
            return now, replace(memory, tries=memory.tries + 1.0, waiting=pause)
        return without[odd], memory.leaving_out(odd, 1.0 if odd == early else -1.0)

    def _looked(self, memory: OutOfStep, known: Recollection, now: Judged, way: tuple[Float, float]) -> OutOfStep:
        """After a look at each camera."""
        (step, speed), pose, sums = way, now.fit.pose, memory.sums.copy()
        for camera, here in enumerate(known.ratios(now.check)):
            if camera in now.problem.left_out:
                here = self._evidence(known, now, camera, pose)
            back, ahead = (self._evidence(known, now, camera, pose.retract(by)) for by in (-step, step))
            uphill = 0.5 * (ahead - back)
            if not np.isnan(uphill + here):
                bend = max(2.0 * here - back - ahead, abs(uphill))  # the top is a step off at most
                slope = bend * speed / self.shift
                sums[:, camera] = self.kept * sums[:, camera] + [slope * slope, slope * uphill]
        memory = replace(memory, sums=sums, looked=True)
        apart = np.abs(memory.apart(now.problem.left_out))
        clear = apart * np.sqrt(sums[0]) >= self.clear
        out = [c for c in now.problem.left_out if clear[c] and apart[c] >= 2.0 * self.apart]
        kept = [c for c in memory.cameras if apart[c] >= self.apart or not sums[0, c]]
        return replace(memory, cameras=tuple(sorted({*out, *kept})))

    def _wronged(self, memory: OutOfStep, left_out: Set[int]) -> frozenset[int]:
        """Cameras that were early when they were left out and are late without them, or the other way round."""
        apart = memory.apart(left_out)
        clear = np.abs(apart) * np.sqrt(memory.sums[0]) >= self.clear
        return frozenset(np.flatnonzero(clear & (memory.sides * apart <= -self.apart)).tolist())

    def _against(self, known: Recollection, now: Judged, without: dict[int, Judged], step: Float) -> Float:
        """(C,) what speaks for leaving out each of two cameras: how much more the cameras agree that are neither, and
        how much better its own picture fits elsewhere on the way than where the others see the body.
        """
        before, out = known.ratios(now.check), np.zeros(len(known.backdrops))
        for camera, others in without.items():
            gain = np.delete(known.ratios(others.check) - before, list(without))
            places = (others.fit.pose.retract(by) for by in (-step, 0.0 * step, step))
            back, here, ahead = (self._evidence(known, others, camera, place) for place in places)
            out[camera] = np.nansum(gain) + self.own * max(float(np.nan_to_num(max(back, ahead) - here)), 0.0)
        return out

    def _way(self, now: Judged) -> tuple[Float, float] | None:
        """A step of `shift` on the body's way, and its speed in m/s; None where it hardly moves."""
        here, time = now.fit.posed, now.problem.frame.time
        for moment in now.problem.past.moments[::-1]:
            if not (moment.seen and 0.0 < time - moment.time <= self.within):
                return None
            step = Posed(here.body, moment.pose).segment_middles - here.segment_middles
            moved = float(np.sqrt(np.mean(np.sum(step**2, axis=1))))
            if moved >= 0.5 * self.shift:
                return here.pose.minus(moment.pose) * (self.shift / moved), moved / (time - moment.time)
        return None

    @staticmethod
    def _evidence(known: Recollection, now: Judged, camera: int, pose: Pose) -> float:
        """Of the body in a pose, in the picture of one camera; NaN where it hardly shows it."""
        if now.problem.frame.images[camera] is None:
            return np.nan
        posed = Posed(now.fit.posed.body, pose)
        sight = now.problem.look(camera, posed)
        covered = known.check(posed, [] if sight is None else [sight], now.problem, beside=False)
        return float(known.ratios(covered)[camera])
