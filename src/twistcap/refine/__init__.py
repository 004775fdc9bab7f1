"""Refining a whole track: poses of all frames, lengths and joint centres in one sparse least squares (docs/refine.md)."""

from twistcap.refine.refine import Refined, refine
from twistcap.refine.settings import RefineConfig

__all__ = ["RefineConfig", "Refined", "refine"]
