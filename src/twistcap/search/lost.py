"""The body is looked for in the whole pictures where it was lost or has not been seen for a while.

What the recording has taught tells it from everything else: its parts' colours in each camera, the background of each
camera, and the stances that it has shown, whose mirror images it may show as well. It is found where the evidence is
as strong as it usually is; else it is nowhere, and its pose is held.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose
from twistcap.body.limbs import limbs
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.predict.history import Moment, Past, jumped, rested
from twistcap.ranges import Checked, Count, Share
from twistcap.search import Beginning, Problem, Proposals, Revision
from twistcap.search.beside import BesideRule, agreement, beside, limbs_beside
from twistcap.search.body import BodyRule, BodySearch, last_seen
from twistcap.search.bump import BumpRule, Unrest
from twistcap.search.contradiction import ContradictionRule, judged
from twistcap.search.doubt import Doubt, DoubtRule
from twistcap.search.flag import MOST_USUAL, USUAL, at_limits, contour_signs, displaced, flag_groups, image_signs
from twistcap.search.limb import LimbRule, regained, taught
from twistcap.search.memory import LostMemory
from twistcap.search.recollection import Judged, Recollection, fitted, fitted_at
from twistcap.search.surroundings import Surroundings
from twistcap.search.swap import SwapRule
from twistcap.stages import stage


@dataclass(frozen=True)
class LostBody(Checked):
    """When and how the whole body is looked for. Evidence is a ratio to what is usual for this body.

    Attributes:
        after: s without images from which on it is.
        least: evidence below which a fit is lost.
        lessons: frames that must have taught what is usual, before a body can be lost or a camera left out by that.
        none: evidence below which it is not the body at all.
        learned: evidence from which on a fit is learned from.
        every, first: frames between lessons, and between the first ten.
        again: frames between searches.
        relit: fraction of the background that fits, over what is usual, below which it is another one.
        agreeing: fraction of contour points that agree, from which on the body is where it is though all pictures have
            changed.
        lately: fraction that the mean of the signs of loss keeps from frame to frame.
        doubted, wary: fractions that the doubt in what was found, and in what jumped, keeps from frame to frame.
        in_sight: fraction of the pixels that the body usually covers, below which it is hardly in sight. Then it is not
            without doubt where it is, not looked for again, and tells nothing of a switched light.
        whole, limb: how the whole body is looked for, and a single limb.
        proposals: more poses to judge, as those of keypoints.
    """

    after: float = 0.1
    least: float = 0.6
    lessons: Count = 10
    none: float = 0.3
    learned: float = 0.8
    every: Count = 10
    first: Count = 3
    again: Count = 3
    relit: float = 0.75
    agreeing: Share = 0.6
    lately: Share = 0.7
    doubted: Share = 0.85
    wary: Share = 0.95
    in_sight: Share = 0.4
    whole: BodyRule = field(default_factory=BodyRule)
    contradiction: ContradictionRule = field(default_factory=ContradictionRule)
    beside: BesideRule = field(default_factory=BesideRule)
    limb: LimbRule = field(default_factory=LimbRule)
    bump: BumpRule = field(default_factory=BumpRule)
    swap: SwapRule = field(default_factory=SwapRule)
    doubt: DoubtRule = field(default_factory=DoubtRule)
    proposals: Proposals | None = None
    name: str = field(default="lost body", init=False)

    def start(self, body: Body, rig: Rig) -> LostMemory:
        """Nothing is known."""
        groups = flag_groups(body)
        none, still = np.zeros(len(groups)), Unrest.none(len(rig))
        return LostMemory(Recollection.blank(body, rig), groups, none, none, still)

    def put_elsewhere(self, before: LostMemory, after: LostMemory) -> Bool:
        """(G,) which limbs, and whether the rest of the body, a search has found elsewhere between two memories."""
        return np.asarray((after.frames > before.frames) & (after.found > self.doubted * before.found), np.bool_)

    def begin(self, memory: LostMemory, problem: Problem) -> tuple[Beginning | None, LostMemory]:
        """Where the images show the body, after a gap, or while it is nowhere."""
        if not memory.known.lessons or not (memory.nowhere or self._gap(problem.past, problem.frame.time)):
            return None, memory
        if memory.waiting:
            return Beginning(None) if memory.nowhere else None, replace(memory, waiting=memory.waiting - 1)
        sources = self.swap.sources(memory.known, problem)
        problem = problem.sorted_by(sources) if sources else problem
        bumps = self.bump.unseen(memory.known, problem)  # a camera may have been knocked on the way out
        problem = problem.turned_back(bumps) if bumps else problem
        pose = self._searched(memory, problem)
        if pose is not None:
            return Beginning(pose, bumps, sources), self._found(memory)
        if not memory.known.sure:
            return Beginning(problem.start, bumps, sources) if bumps or sources else None, memory
        return Beginning(None, bumps, sources), replace(memory, waiting=self.again - 1, nowhere=True)

    def revise(self, memory: LostMemory, problem: Problem, fit: Fit) -> tuple[Revision | None, LostMemory]:
        """The body elsewhere, where the fit is lost; else the fit is learned from."""
        found, jumped = self.doubted * memory.found, self.wary * memory.jumped
        memory = replace(memory.remembered, frames=memory.frames + 1, found=found, jumped=jumped)
        known = memory.known
        if not problem.past.started and problem.views:  # contours may agree better beside the first pose
            other = limbs_beside(self.beside, problem, beside(self.beside, problem, fit), memory.groups)
            if other is not fit:
                now = fitted_at(known, problem, other)
                return self._at(problem, other, problem.start), self._learned(self._signed(memory, now), now, 1.0)
        now = fitted_at(known, problem, fit)
        sources, now = self.swap.sorted_by(known, now, memory.frames)
        bumps, unrest = self.bump.bumps(memory.unrest, known, now)
        now = fitted(known, now.problem.turned_back(bumps)) if bumps else now
        revision, memory = self._revised(replace(memory, unrest=unrest), now)
        if not bumps and not sources:
            return revision, memory
        revision = revision or Revision(now.fit, problem.past.moments[-1])
        left_out = now.problem.left_out if revision.left_out is None else revision.left_out
        return replace(revision, bumps=bumps, sources=sources, left_out=left_out), memory

    def _revised(self, memory: LostMemory, now: Judged) -> tuple[Revision | None, LostMemory]:
        """`revise` with cameras that stand where they are believed to."""
        problem, known = now.problem, memory.known
        if not problem.trusted:  # in noise a body may seem to be anywhere, and noise is no lesson
            return None, self._signed(memory, now)
        if not known.sure:
            return None, self._learned(self._signed(memory, now), now, 1.0)
        if (again := self._fitted_without_look(known, now)) is not None:
            still = Unrest.none(len(problem.rig))
            memory = replace(memory, known=known.forgotten(), frames=1, unrest=still, lately=None, lacked=None)
            memory = self._learned(self._signed(memory, again), again, 1.0)
            return Revision(again.fit, problem.past.moments[-1], left_out=frozenset(), relit=True), memory
        usual_known = memory.frames > self.lessons
        if usual_known:
            now, suspicion = judged(self.contradiction, memory.suspicion, known, now)
            memory = replace(memory, suspicion=suspicion)
        memory = self._signed(memory, now)
        ratio, last, revision = known.ratio(now.check), problem.past.moments[-1], None
        if np.isnan(ratio) and known.pixels[list(now.problem.views)].any():  # hardly any of the body is in sight
            ratio = 0.0
        if ratio < self.least and usual_known:
            revision, memory = self._elsewhere(memory, now, ratio)
        else:  # or nothing can be said
            now, last, memory = self._with_limbs(memory, now, last)
            if usual_known:
                revision, memory = self._reconsidered(memory, now)
            if revision is None:
                memory = self._learned(replace(memory, waiting=0), now, float(np.nan_to_num(ratio, nan=1.0)))
                if ratio >= self.learned and memory.found.max() < 0.5 and known.in_sight(now.check) >= self.in_sight:
                    memory = replace(memory, surely=Moment(problem.frame.time, now.fit.pose))
        return replace(revision or Revision(now.fit, last), left_out=now.problem.left_out), memory

    def _fitted_without_look(self, known: Recollection, now: Judged) -> Judged | None:
        """The frame fitted without the body's look, where a light has been switched: no camera's background is what it
        was, and the contour agrees all the same. The colours of the old light would mislead the fit.
        """
        fitting = now.check.fitting / known.fitting
        seen = ~np.isnan(fitting)
        if known.in_sight(now.check) < self.in_sight or not seen.any() or np.any(fitting[seen] >= self.relit):
            return None
        again = fitted(known.forgotten(), now.problem.without_look())
        return again if agreement(again.fit) >= self.agreeing else None

    def _usual(self, memory: LostMemory) -> Float:
        """(G, 3) what the contour says against each limb and the rest, as of a body that is not exact."""
        usual = np.tile(USUAL, (len(memory.groups), 1)) if memory.usual is None else memory.usual
        return np.minimum(usual, MOST_USUAL)

    def _signed(self, memory: LostMemory, now: Judged) -> LostMemory:
        """With the signs of loss in a frame."""
        fit, support = now.fit, now.problem.support(now.fit)
        groups, body = memory.groups, now.problem.body
        seen = image_signs(groups, memory.known, now.check, fit.agreement, support, self._usual(memory))
        jumped = np.maximum(memory.jumped, displaced(groups, fit.posed, now.problem.start))
        signs = np.column_stack([seen, memory.found, jumped, at_limits(groups, body, fit.pose.q)])
        lately = (1.0 - self.lately) * signs + self.lately * (0.0 if memory.lately is None else memory.lately)
        return replace(memory, jumped=jumped, signs=signs, lately=lately)

    def _with_limbs(self, memory: LostMemory, now: Judged, last: Moment) -> tuple[Judged, Moment, LostMemory]:
        """The frame with its lost limbs where they are found, and the moment before it, in which they rest."""
        out_of_sight = now.problem.in_sight(now.fit) < 0.5
        lost = [limb for limb in self._lost_limbs(memory) if not out_of_sight[memory.groups[limb]].any()]
        shown, usually = ((of.pixels > 0.0).any(axis=1) for of in (now.check, memory.known))
        if not (usually & ~shown).any():  # else it is the cameras' doing
            lost = sorted({*lost, *self._hidden_limbs(memory)})
        if memory.limb_waiting:
            lost, memory = [], replace(memory, limb_waiting=memory.limb_waiting - 1)
        elif not lost:
            memory = replace(memory, limb_pause=0)
        asked = lost or [limb for limb in self._due_limbs(memory, now) if not out_of_sight[memory.groups[limb]].any()]
        if memory.frames <= self.lessons:  # what is not known yet may be mended by the next fit
            known = taught(memory.known, now.problem.body, memory.groups)
            asked = [limb for limb in asked if known[limb]]
        if not asked:
            return now, last, memory
        with stage("search"):
            found = regained(self.limb, memory.known, now, memory.groups, asked, memory.frames, sure=bool(lost))
        if found is None and lost:
            pause = min(max(2 * memory.limb_pause, self.limb.again), self.limb.longest)
            memory = replace(memory, limb_pause=pause, limb_waiting=pause)
        if found is None:
            return now, last, memory
        now, moved = found
        masks = limbs(now.problem.body)
        coordinates = np.asarray(np.any([masks[i][6:] for i in moved], axis=0), np.bool_)
        doubt = np.where(np.isin(np.arange(len(memory.groups)), moved), 1.0, memory.found)
        memory = replace(self._signed(replace(memory, found=doubt), now), limb_pause=0)
        return now, rested(last, now.fit.pose, coordinates), memory

    def _due_limbs(self, memory: LostMemory, now: Judged) -> list[int]:
        """Limbs that are looked at unasked: all where the body's colours lie bare, else those that slip."""
        slipping = [] if memory.signs is None else self.limb.slipping(memory.signs)
        return self.limb.due(memory.known, now.check, memory.groups, memory.frames) or slipping

    def _lost_limbs(self, memory: LostMemory) -> list[int]:
        return [] if memory.signs is None or memory.lately is None else self.limb.lost(memory.signs, memory.lately)

    def _hidden_limbs(self, memory: LostMemory) -> list[int]:
        return [] if memory.lately is None else self.limb.hidden(memory.lately)

    def _learned(self, memory: LostMemory, now: Judged, ratio: float) -> LostMemory:
        """With what a fit that is not lost teaches; limbs that are lost or hidden teach nothing."""
        lost = [*self._lost_limbs(memory), *self._hidden_limbs(memory)]
        known = memory.known.accustomed(
            now.check, np.asarray(~memory.groups[lost].any(axis=0), np.bool_), memory.frames
        )
        usual = self._usual(memory)
        contour = contour_signs(memory.groups, now.fit.agreement, now.problem.support(now.fit))
        contour[lost] = usual[lost]
        contour[:, 1:] = np.median(contour[:, 1:], axis=0)  # what goes wrong slowly must not teach its own usual
        memory = replace(memory, usual=usual + max(0.05, 1.0 / (memory.frames + 1)) * (contour - usual))
        due = (memory.frames - 1) % (self.every if known.lessons >= 10 else self.first) == 0
        if due and ratio >= self.learned:
            each = np.nan_to_num(memory.known.ratios(now.check), nan=1.0)
            seen = [s.camera_index for s in now.fit.sights if each[s.camera_index] >= self.learned]
            looks = ((i, Surroundings.of(i, known.backdrops[i], now.fit.posed, now.problem)) for i in seen)
            views = {i: view for i, view in looks if view is not None}
            moved = [i for i, view in views.items() if self.bump.moved(view)]
            known = known.taught(now.fit.pose, {i: view for i, view in views.items() if i not in moved})
            memory = replace(memory, unrest=memory.unrest.of(moved))
        return replace(memory, known=known)

    def _elsewhere(self, memory: LostMemory, now: Judged, ratio: float) -> tuple[Revision | None, LostMemory]:
        """The body found elsewhere; nowhere, if the fit is not on it either. The signs stay those of the fit that was
        lost: who comes back is often found in a wrong place first.
        """
        problem = now.problem
        pose = None if memory.waiting else self._searched(memory, problem, now.fit.pose)
        if pose is not None:
            memory = replace(self._found(memory), waiting=0, doubt=Doubt())  # `due` is first asked in the next frame
            return self._at(problem, problem.afresh(pose, self.whole.margin), problem.start), memory
        nowhere = ratio < self.none
        memory = replace(memory, waiting=(memory.waiting or self.again) - 1, nowhere=nowhere)
        return (Revision(None, problem.past.moments[-1]) if nowhere else None), memory

    def _found(self, memory: LostMemory) -> LostMemory:
        """After a search that has found the whole body."""
        return replace(memory, nowhere=False, found=np.ones(len(memory.groups)), doubt=self.doubt.begun)

    def _reconsidered(self, memory: LostMemory, now: Judged) -> tuple[Revision | None, LostMemory]:
        """The body near where it is fitted, where that is in doubt and the pictures show it better."""
        due, doubt = self.doubt.due(memory.doubt, memory.signs, memory.lately, float(memory.found[-1]))
        memory, problem, here = replace(memory, doubt=doubt), now.problem, now.fit.pose
        if not due or memory.known.in_sight(now.check) < self.in_sight:  # what little is seen may look better anywhere
            return None, memory
        pose = self._searched(memory, problem, here, self.doubt.gain)
        if pose is not None and np.linalg.norm(pose.root[:3, 3] - here.root[:3, 3]) < self.doubt.near:
            fit, evidence = problem.align(pose), memory.known.evidence(problem)
            usual = float(memory.known.nats_in(evidence).sum())
            if evidence.of(fit.pose) > evidence.of(here) + self.doubt.gain * usual:
                found = np.where(displaced(memory.groups, fit.posed, here) > self.doubt.moved, 1.0, memory.found)
                memory = replace(memory, doubt=self.doubt.settled, found=found)
                return self._at(problem, fit, here), self._signed(memory, fitted_at(memory.known, problem, fit))
        return None, replace(memory, doubt=self.doubt.in_vain(doubt))

    def _at(self, problem: Problem, fit: Fit, instead: Pose) -> Revision:
        """The body elsewhere, instead of at a pose: the way there was no motion, nor was what no body does."""
        before = problem.past.moments[-1]
        last = jumped(before, fit.pose.minus(instead), fit.pose)
        moved = np.linalg.norm((fit.pose.root - last.pose.root)[:3, 3])
        if moved > self.whole.speed * (problem.frame.time - before.time):
            last = replace(last, pose=fit.pose)
        return Revision(fit, last, jumped=True)

    def _gap(self, past: Past, time: float) -> bool:
        """Whether images have been missing for longer than they do at the recording's own rate."""
        usual = past.moments[-1].time - past.moments[-2].time if past.moving else 0.0
        return past.started and time - past.seen_time > max(self.after, 1.5 * usual)

    def _searched(
        self, memory: LostMemory, problem: Problem, here: Pose | None = None, better: float | None = None
    ) -> Pose | None:
        """Where the pictures show the body, clearly better than where it is fitted, if it is."""
        with stage("search"):
            evidence = memory.known.evidence(problem)
            if not evidence.views:
                return None
            evidence = evidence.no_nearer((memory.surely or last_seen(problem.past)).pose)
            more = self.whole.better if better is None else better
            least = None if here is None else evidence.of(here) + more * float(memory.known.nats_in(evidence).sum())
            proposed = () if self.proposals is None else self.proposals(problem)
            search = BodySearch(self.whole, self.limb, memory.known, problem, evidence, memory.surely, proposed)
            return search.found(least)
