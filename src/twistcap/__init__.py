"""twistcap: markerless motion capture with a body model."""

__version__ = "0.1.0"
