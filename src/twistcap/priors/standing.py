"""What holds in every frame: joint limits, the rest pose, and the prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twistcap.body import Posed
from twistcap.cues.observation import Alternation
from twistcap.ranges import Checked, Positive
from twistcap.terms import GaussianTerm, LimitTerm, RestTerm, Term


@dataclass(frozen=True)
class _Standing:
    news: bool = field(default=False, init=False)

    def claimed(self, posed: Posed) -> None:
        """Nothing: a joint's limits and rest pose are no measurement."""


@dataclass(frozen=True)
class JointLimits(_Standing):
    """Joints do not go beyond their limits."""

    name: str = field(default="limits", init=False)

    def terms(self, alternation: Alternation) -> Sequence[Term]:
        return (LimitTerm(),)


@dataclass(frozen=True)
class RestPose(Checked, _Standing):
    """A limb that nothing shows hangs as in the rest pose; `sigma_deg` is the joints' standard deviation about it."""

    sigma_deg: Positive = 30.0
    name: str = field(default="rest", init=False)

    def terms(self, alternation: Alternation) -> Sequence[Term]:
        return (RestTerm(float(np.deg2rad(self.sigma_deg))),)


@dataclass(frozen=True)
class Expectation(_Standing):
    """The pose is about where it is predicted."""

    name: str = field(default="temporal", init=False)

    def terms(self, alternation: Alternation) -> Sequence[Term]:
        return (GaussianTerm(alternation.expected, alternation.information),)
