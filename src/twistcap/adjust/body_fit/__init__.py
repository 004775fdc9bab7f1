"""A body fitted to recordings, poses and shape in one solve (docs/concepts/body-fit.md)."""

from twistcap.adjust.body_fit.fit import FitRule, Fitted, Take, fit_body

__all__ = ["FitRule", "Fitted", "Take", "fit_body"]
