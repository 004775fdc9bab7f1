"""Optic flow: variational, from coarse to fine, with a search for large displacements within a mask."""

from twistcap.flow.between import image_between
from twistcap.flow.optical import flow_confidence, moved_mask, optical_flow
from twistcap.flow.settings import BROX_2004, PRESETS, FlowSettings, Preset

__all__ = [
    "BROX_2004", "PRESETS", "FlowSettings", "Preset", "flow_confidence", "image_between", "moved_mask", "optical_flow",
]  # fmt: skip
