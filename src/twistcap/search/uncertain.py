"""A limb of which the images leave open where it is: hypotheses along the direction that the covariance leaves open.

A limb that one camera sees moves freely along that camera's rays, and once it has gone astray its contour is no longer
where the image could pull it back. The covariance knows the direction in which it strays, and how far.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import same_limb
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.predict.history import Past, jumped
from twistcap.ranges import Checked, Count, Positive, Share, Signed
from twistcap.search import Problem, Revision


@dataclass(frozen=True)
class Uncertainty:
    """What is remembered.

    Attributes:
        deviation: (S,) m, how uncertain the middle of each segment is; it fades slowly.
        frame: frames counted.
        preferred: (6 + J,) step to the hypothesis that the last frame preferred; None where it preferred none.
    """

    deviation: Float
    frame: int = 0
    preferred: Float | None = None


@dataclass(frozen=True)
class UncertainLimbs(Checked):
    """When and how hypotheses are tried.

    A jump must be worth its risk. Neighbouring pixels err together, by texture, by shading and where the body is not
    quite the person's: between poses that both cover a limb the evidence wavers by some 13 nats, and dozens of
    hypotheses are tried in a second. A clear preference is three of those deviations, and the next frame must share it:
    where clutter looks like a limb it seldom does so from two poses. Hypotheses reach far in return: a limb goes
    farther astray than its covariance says.

    Attributes:
        least_sd: m of uncertainty of a segment's middle from which on it is in doubt.
        memory: fraction of its uncertainty that a segment keeps from frame to frame when it suddenly seems certain.
        steps: how far hypotheses lie off, in standard deviations along the least certain direction.
        every: they are tried in every so many frames, of one limb after the other.
        promising: nats from which on one is fitted to the images, which it may miss by little yet.
        margin: nats by which one, fitted or not, must explain the images better, in this frame and in the next.
    """

    least_sd: Positive = 0.015
    memory: Share = 0.9
    steps: tuple[Signed, ...] = (-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0)
    every: Count = 3
    promising: Signed = 0.0
    margin: float = 40.0
    name: str = field(default="uncertain limbs", init=False)

    def start(self, body: Body, rig: Rig) -> Uncertainty:
        """Nothing is uncertain."""
        return Uncertainty(np.zeros(len(body.segment_names)))

    def wanted_margin(self, past: Past, time: float) -> float | None:
        """It looks for nothing before the fit."""

    def begin(self, memory: Uncertainty, problem: Problem) -> tuple[None, Uncertainty]:
        """The fit starts where it is expected."""
        return None, memory

    def revise(self, memory: Uncertainty, problem: Problem, fit: Fit) -> tuple[Revision | None, Uncertainty]:
        """A fit that two frames in turn clearly prefer."""
        if not problem.past.started or not problem.views:
            return None, memory
        again = memory.preferred is not None
        poses, memory = self.hypotheses(memory, problem, fit)
        if not poses:
            return None, memory
        judge = problem.judge(fit.posed)
        evidence = [judge.evidence(pose) for pose in poses]
        most = max(evidence)
        if most < self.promising:
            return None, memory
        best = poses[int(np.argmax(evidence))]
        other = problem.align(best)
        fitted = judge.evidence(other.pose)
        if fitted < most:  # the fit has lost it again: the images' judgement stands
            other = problem.measured(best)
        if max(fitted, most) <= self.margin:
            return None, memory
        jump = other.pose.minus(fit.pose)
        if not again:
            return None, replace(memory, preferred=jump)
        return Revision(other, jumped(problem.past.moments[-1], jump, other.pose), jumped=True), memory

    def hypotheses(self, memory: Uncertainty, problem: Problem, fit: Fit) -> tuple[list[Pose], Uncertainty]:
        """Other places of one limb, most often none; to be asked in every frame."""
        memory, preferred = replace(memory, frame=memory.frame + 1, preferred=None), memory.preferred
        if preferred is not None:
            return [fit.pose.retract(preferred)], memory
        if memory.frame % self.every:
            return [], memory
        sd, directions = segment_deviations(fit.posed, problem.covariance(fit))
        deviation = problem.in_sight(fit) * np.maximum(sd, self.memory**self.every * memory.deviation)
        memory = replace(memory, deviation=deviation)
        limbs = uncertain_limbs(fit.posed.body, deviation, self.least_sd)
        if not limbs:
            return [], memory
        s = limbs[memory.frame // self.every % len(limbs)]
        direction = directions[s] * deviation[s] / sd[s]
        return [fit.pose.retract(step * direction) for step in self.steps], memory


def segment_deviations(posed: Posed, covariance: Float) -> tuple[Float, Float]:
    """How uncertain the middle of each segment is: standard deviation (S,) m along its least certain direction, and
    the pose step (S, 6 + J) that is most likely to have moved it so far.
    """
    body = posed.body
    middles = posed.segment_middles
    by_twist = np.concatenate([-se3.hat(middles), np.broadcast_to(np.eye(3), (len(middles), 3, 3))], axis=-1)
    J = by_twist @ posed.projector.reshape(-1, 6, body.dof)
    cross = J @ covariance
    values, vectors = np.linalg.eigh(cross @ J.transpose(0, 2, 1))
    sd = np.sqrt(np.maximum(values[:, -1], 1e-12))
    return sd, np.einsum("sid,si->sd", cross, vectors[:, :, -1]) / sd[:, None]


def uncertain_limbs(body: Body, deviation: Float, least: float) -> list[int]:
    """Uncertain segments, the most uncertain of each limb: none stands above or below another one of the list."""
    chosen: list[int] = []
    for s in map(int, np.argsort(-deviation)):
        if deviation[s] < least:
            break
        if not any(same_limb(body, s, t) for t in chosen):
            chosen.append(s)
    return chosen
