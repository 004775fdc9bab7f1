"""What is known of poses without looking: densities learnt from motion."""

from twistcap.priors.parzen import ParzenPrior, kernel_width
from twistcap.priors.term import PriorRule, PriorTerm, matched

__all__ = ["ParzenPrior", "PriorRule", "PriorTerm", "kernel_width", "matched"]
