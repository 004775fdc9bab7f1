"""What a camera sees of a posed body: visible triangles, depths and the points of its contours."""

from twistcap.render.contour import ContourPoints, contour_on_edges, reprojected, visible_contour
from twistcap.render.view import RenderedView, SurfaceArrays, SurfacePoints, body_window, render

__all__ = [
    "ContourPoints", "RenderedView", "SurfaceArrays", "SurfacePoints", "body_window", "contour_on_edges", "render",
    "reprojected", "visible_contour",
]  # fmt: skip
