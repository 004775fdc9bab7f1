"""Refining a whole track: poses of all frames, lengths and joint centres in one sparse least squares."""
