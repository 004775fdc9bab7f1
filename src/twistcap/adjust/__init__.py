"""Adjustment: blocks and terms over many frames, solved by the one minimiser."""
