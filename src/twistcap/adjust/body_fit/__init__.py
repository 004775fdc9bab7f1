"""A body fitted to recordings, poses and shape in one solve (docs/concepts/body-fit.md)."""

from twistcap.adjust.body_fit.fit import Fitted, Take, fit_body
from twistcap.adjust.body_fit.settings import FitRule

__all__ = ["FitRule", "Fitted", "Take", "fit_body"]
