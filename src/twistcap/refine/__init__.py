"""A whole track refined: poses, lengths and joint centres in one sparse least squares (docs/concepts/refinement.md)."""

from twistcap.refine.refine import Refined, refine
from twistcap.refine.settings import RefineConfig

__all__ = ["RefineConfig", "Refined", "refine"]
