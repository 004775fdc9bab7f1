"""A whole track refined: poses, lengths and joint centres in one sparse least squares (docs/concepts/refinement.md)."""

from twistcap.adjust.refine.refine import Refined, refine
from twistcap.adjust.refine.settings import RefineConfig

__all__ = ["RefineConfig", "Refined", "refine"]
