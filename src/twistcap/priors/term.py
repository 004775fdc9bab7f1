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
        strength: weight of ``−log p`` per contour point, so that image and prior weigh alike however many there are.
            Contour points are not independent, so that honest data would carry a fraction of their weight; the prior
            is raised by as much instead. It counts in full while a part of the body is hidden from all views.
        in_sight: share of the strength that counts while every part is in sight: the images know better than other
            people's motion, and a prior that does not fit must do no harm.
        unseen: how far the angle of a joint that no view shows counts when the samples are weighed, in [0, 1]: what is
            seen chooses among them, and the past of what is not seen only where that leaves it open.
        step: share of the way to the weighted mean of the samples that the prior alone would go in one solver step.
            1 majorises and minimises; the paper's ``τ = 0.125 σ²`` is 0.125, which also holds against the images.
    """

    strength: float = 0.05
    in_sight: Share = 0.1
    unseen: Share = 0.02
    step: PartOfOne = 1.0


@dataclass(frozen=True)
class PriorTerm:
    """``weight · (−log p)`` of the coordinates that a prior knows; all others and the root stay free.

    Its quadratic lies on the weighted mean of the samples. With step 1 its Hessian, that of a single kernel, is the
    log-sum-exp's largest: the quadratic lies nowhere below the energy, so that a step never raises it.

    Attributes:
        prior: the density, of K coordinates.
        columns: (K,) their indices among the body's.
        weight: factor on ``−log p``.
        step: see `PriorRule`.
        target: (K,) rad, a mean of the samples in which joints that are not known had no say; None for that of all
            joints, at every pose. It is the expectation of an EM step: the energy is then the quadratic about it.
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
        return Quadratic(self.energy(posed), gradient, self.hessian(posed.body.dof))

    def hessian(self, dof: int) -> Float:
        """(dof, dof) of the quadratic, the same at every pose."""
        out, at = np.zeros((dof, dof)), 6 + self.columns
        out[at, at] = self.weight / self.step * self.prior.information
        return out

    def weighted(self, rule: PriorRule, points: int, hidden: float) -> PriorTerm:
        """The term beside so many contour points, where the part that is hidden most is so by a share in [0, 1]."""
        share = rule.in_sight + (1.0 - rule.in_sight) * hidden**2
        return replace(self, weight=rule.strength * share * points, step=rule.step)

    def given_joints(self, known: Float, rule: PriorRule, posed: Posed) -> PriorTerm:
        """The term whose samples are weighed by the joints that are known: (J,) in [0, 1], of all the body's."""
        believed = np.maximum(known[self.columns], rule.unseen)
        if np.all(believed == believed[0]):
            return self
        return replace(self, target=self.prior.mean(posed.pose.q[self.columns], believed / believed.max()))

    def claimed(self, posed: Posed) -> Float:
        """(6 + J, 6 + J) information of the density itself at a pose: of a Gaussian as wide as the kernels that count.

        The weight is not in it: that makes up for what contour points claim too much.
        """
        out, at = np.zeros((posed.body.dof, posed.body.dof)), 6 + self.columns
        out[np.ix_(at, at)] = np.linalg.inv(self.prior.spread(posed.pose.q[self.columns]))
        return out


@dataclass(frozen=True)
class PosePrior:
    """A density of poses beside what the images show.

    Attributes:
        term: of the body's coordinates.
        rule: how much it counts.
    """

    term: PriorTerm
    rule: PriorRule
    name: str = field(default="prior", init=False)
    news: bool = field(default=False, init=False)

    def terms(self, alternation: Alternation) -> Sequence[PriorTerm]:
        """The term, weighed by what the images show and chosen by the joints that they show."""
        term = self.term.weighted(self.rule, alternation.samples, alternation.concealed)
        return (term.given_joints(alternation.known, self.rule, alternation.posed),)

    def claimed(self, posed: Posed) -> Float:
        """What the density itself knows of a pose."""
        return self.term.claimed(posed)


def matched(prior: ParzenPrior, body: Body) -> PriorTerm:
    """The prior of those of its coordinates that a body has, matched by name; its weight is 1.

    Raises:
        InputError: where the body has none of them.
    """
    names = [name for name in prior.names if name in body.coordinate_names]
    if not names:
        raise InputError(
            f"prior: body {body.name!r} has none of its coordinates ({', '.join(prior.names[:3])} …);"
            " train it on a motion of such a body."
        )
    columns = np.array([body.coordinate(name) for name in names], dtype=np.int32)
    return PriorTerm(prior if len(names) == len(prior.names) else prior.restricted(names), columns, 1.0)
