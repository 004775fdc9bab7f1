"""The pose prior as a term of the least-squares system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Float, Int
from twistcap.body import Body, Posed
from twistcap.cues.observation import Alternation
from twistcap.errors import InputError
from twistcap.priors.parzen import ParzenPrior
from twistcap.ranges import Checked, PartOfOne, Share
from twistcap.terms import Quadratic


@dataclass(frozen=True)
class PriorRule(Checked):
    """How much a pose prior counts.

    Attributes:
        strength: weight of ``−log p`` per contour point while a part of the body is hidden from all views. These points
            are not independent, and honest data would carry a fraction of their weight; the prior is raised instead.
        in_sight: share of the strength that counts while every part is in sight: the images know better.
        unseen: how far the angle of a joint that no view shows counts when the samples are weighed, in [0, 1].
        step: share of the way to the weighted mean of the samples that the prior alone would go in one solver step.
            1 majorises and minimises; the paper's ``τ = 0.125 σ²`` is 0.125.
    """

    strength: float = 0.05
    in_sight: Share = 0.1
    unseen: Share = 0.02
    step: PartOfOne = 1.0


@dataclass(frozen=True)
class PriorTerm:
    """``weight · (−log p)`` of the coordinates that a prior knows; all others and the root stay free.

    Its quadratic lies on the weighted mean of the samples. With step 1 (see `PriorRule`) its Hessian, that of a single
    kernel, is the log-sum-exp's largest: the quadratic lies nowhere below the energy, so that a step never raises it.

    Attributes:
        columns: (K,) indices of the prior's coordinates among the body's.
        target: (K,) rad, the mean of the samples by the joints that are known, as the expectation of an EM step: the
            energy is then the quadratic about it. None for the mean by all joints, at every pose.
    """

    prior: ParzenPrior
    columns: Int
    weight: float
    step: float = 1.0
    target: Float | None = None
    name: str = "prior"

    def energy(self, posed: Posed) -> float:
        q = posed.pose.q[self.columns]
        if self.target is None:
            return self.weight * self.prior.energy(q)
        return 0.5 * self.weight * float(self.prior.information @ (q - self.target) ** 2)

    def linearize(self, posed: Posed) -> Quadratic:
        q = posed.pose.q[self.columns]
        mean = self.prior.mean(q) if self.target is None else self.target
        gradient = np.zeros(posed.body.dof)
        gradient[6 + self.columns] = self.weight * self.prior.information * (q - mean)
        hessian = np.zeros((posed.body.dof, posed.body.dof))  # the same at every pose
        hessian[6 + self.columns, 6 + self.columns] = self.weight / self.step * self.prior.information
        return Quadratic(self.energy(posed), gradient, hessian)

    def given_joints(self, known: Float, rule: PriorRule, posed: Posed) -> PriorTerm:
        """The term whose samples are weighed by the joints that are known: (J,) in [0, 1], of all the body's."""
        believed = np.maximum(known[self.columns], rule.unseen)
        if np.all(believed == believed[0]):
            return self
        return replace(self, target=self.prior.mean(posed.pose.q[self.columns], believed / believed.max()))


@dataclass(frozen=True)
class PosePrior:
    """A density of poses beside what the images show."""

    term: PriorTerm
    rule: PriorRule
    name: str = field(default="prior", init=False)
    news: bool = field(default=False, init=False)

    def terms(self, alternation: Alternation) -> Sequence[PriorTerm]:
        """The term beside so many contour points, weighed and chosen by what the images show of the joints."""
        rule = self.rule
        share = rule.in_sight + (1.0 - rule.in_sight) * alternation.concealed**2
        term = replace(self.term, weight=rule.strength * share * alternation.samples, step=rule.step)
        return (term.given_joints(alternation.known, self.rule, alternation.posed),)

    def claimed(self, posed: Posed) -> Float:
        """(6 + J, 6 + J) information of the density itself, without the weight that makes up for what contour points
        claim too much: of a Gaussian as wide as the kernels that count.
        """
        out, at = np.zeros((posed.body.dof, posed.body.dof)), 6 + self.term.columns
        out[np.ix_(at, at)] = np.linalg.inv(self.term.prior.spread(posed.pose.q[self.term.columns]))
        return out


def matched(prior: ParzenPrior, body: Body) -> PriorTerm:
    """The prior of those of its coordinates that a body has, matched by name; its weight is 1. Raises InputError where
    the body has none of them.
    """
    names = [name for name in prior.names if name in body.coordinate_names]
    if not names:
        raise InputError(
            f"prior: body {body.name!r} has none of its coordinates ({', '.join(prior.names[:3])} …);"
            " train it on a motion of such a body."
        )
    columns = np.array([body.coordinate(name) for name in names], dtype=np.int32)
    return PriorTerm(prior if len(names) == len(prior.names) else prior.restricted(names), columns, 1.0)
