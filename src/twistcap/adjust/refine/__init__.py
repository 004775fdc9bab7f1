"""A whole track refined: all poses, lengths and joint centres in one sparse least squares (docs/refine.md)."""

from twistcap.adjust.refine.refine import Refined, refine
from twistcap.adjust.refine.settings import RefineConfig

__all__ = ["RefineConfig", "Refined", "refine"]
