"""What is known of a pose without looking at its pixels. This is what a prior is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from twistcap.arrays import Float
from twistcap.body import Posed
from twistcap.cues.observation import Alternation
from twistcap.priors.parzen import ParzenPrior, kernel_width
from twistcap.priors.term import PosePrior, PriorRule, PriorTerm, matched
from twistcap.terms import Term

__all__ = ["ParzenPrior", "PosePrior", "Prior", "PriorRule", "PriorTerm", "kernel_width", "matched"]


class Prior(Protocol):
    """Terms that stand beside the cues'."""

    @property
    def name(self) -> str:
        """Its name in reports."""
        ...

    @property
    def news(self) -> bool:
        """Whether it says something new in every frame; what is known all along must not add up in the covariance."""
        ...

    def terms(self, alternation: Alternation) -> Sequence[Term]:
        """Its terms for the next solver step."""
        ...

    def claimed(self, posed: Posed) -> Float | None:
        """(6 + J, 6 + J) information that is added to what is reported, and to nothing else; None for none."""
