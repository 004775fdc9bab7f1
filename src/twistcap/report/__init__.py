"""Pictures for people: overlays on the video, plots of angles and errors, and the one-page report."""

from twistcap.report.overlay import draw_overlay, overlay_video
from twistcap.report.page import Figure, Headline, Statement, write_report
from twistcap.report.plots import angle_plot, joint_error_plot

__all__ = [
    "Figure", "Headline", "Statement", "angle_plot", "draw_overlay", "joint_error_plot", "overlay_video",
    "write_report",
]  # fmt: skip
