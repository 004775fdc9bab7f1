"""One page with every step from key views to a body, so that a user sees which step failed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from twistcap.acquire.build import Acquired
from twistcap.acquire.measure import Measured
from twistcap.acquire.sections import closed_spline, fullness
from twistcap.acquire.silhouette import KeyView
from twistcap.arrays import Bool, Float
from twistcap.body import Posed
from twistcap.body.kinematics import Pose

_PARTS = {"trunk": "0.4", "arm_r": "tab:red", "arm_l": "tab:blue", "leg_r": "tab:orange", "leg_l": "tab:cyan"}


def draw_silhouettes(views: Mapping[str, KeyView], path: Path) -> Path:
    """The silhouettes alone: all there is to see when a later step fails."""
    figure = Figure(figsize=(4 * max(1, len(views)), 4.2), layout="constrained")
    for k, (role, view) in enumerate(views.items()):
        axes = figure.add_subplot(1, len(views), k + 1)
        axes.imshow(view.mask, cmap="gray_r", vmax=2)
        axes.set_title(f"silhouette: {role}")
    figure.savefig(path, dpi=80)
    return path


def draw_steps(views: Mapping[str, KeyView], acquired: Acquired, path: Path) -> Path:
    """Separation, skeleton corners, slices in both pairs of views, splines, surface and skeleton."""
    figure = Figure(figsize=(20, 10.5), layout="constrained")
    m = acquired.measured
    panels = [figure.add_subplot(2, 4, k + 1) for k in range(6)]
    _separation(panels[0], views["front"].mask, m)
    _corners(panels[1], views["elbows"].mask, m)
    for axes, role in zip(panels[2:5], ("front", "side", "above"), strict=True):
        _slices(axes, views[role], m, role)
    _rings(panels[5], m)
    for k, (azimuth, title) in enumerate(((-25, "body in the stance of the front view"), (20, "rest pose"))):
        axes = figure.add_subplot(2, 4, 7 + k, projection="3d")
        _surface(axes, acquired, k == 1, azimuth)
        axes.set_title(f"{7 + k} {title}")
    figure.savefig(path, dpi=80)
    return path


def _separation(axes: Any, mask: Bool, m: Measured) -> None:
    s = m.separation
    picture = np.ones((*mask.shape, 3))
    colours = ((0.75, 0.75, 0.75), (1, 0.6, 0.6), (0.6, 0.6, 1), (1, 0.8, 0.5), (0.5, 0.9, 0.9))
    for part, colour in zip((s.trunk, *s.arms, *s.legs), colours, strict=True):
        picture[part] = colour
    axes.imshow(picture)
    axes.axhline(s.body_line, color="k", lw=0.8, ls="--")
    axes.plot(*s.pits.T, "r^", *s.crotch, "mv", *s.neck, "bs", ms=7)
    axes.set_title("1 body line (dashed), arm pits ▲, crotch ▼, neck ■")


def _corners(axes: Any, mask: Bool, m: Measured) -> None:
    axes.imshow(mask, cmap="gray_r", vmax=3)
    for corner in m.corners.values():
        axes.plot(*corner.path.T, "k-", lw=0.8)
        axes.plot(*corner.path[corner.corner], "rx", *corner.elbow, "go", ms=7, mfc="none")
    axes.set_title("2 skeletons of the arms, corner ×, elbow ○")


def _slices(axes: Any, view: KeyView, m: Measured, role: str) -> None:
    """Splines and joints drawn into a view; the cameras of the views are in the world."""
    axes.imshow(view.mask, cmap="gray_r", vmax=4)

    def seen(points: Float) -> Float:
        return view.camera.project(points @ m.to_world[:3, :3].T + m.to_world[:3, 3])[0]

    for part, control in m.slices.items():
        if role != "above" or part.startswith("arm"):
            for ring in seen(closed_spline(control[::3], 24, fullness(part))):
                axes.plot(*np.vstack([ring, ring[:1]]).T, color=_PARTS[part], lw=0.6)
    joints = seen(np.array(list(m.joints.values())))
    axes.plot(*joints.T, "ko", ms=4, mfc="y")
    number = {"front": 3, "side": 4, "above": 5}[role]
    axes.set_title(f"{number} slices and joints, {role}")


def _rings(axes: Any, m: Measured) -> None:
    """Slices of the trunk seen along the vertical, with their control points."""
    trunk = m.slices["trunk"]
    for k in np.linspace(4, len(trunk) - 5, 6).astype(int):
        ring = closed_spline(trunk[k], 48, fullness("trunk"))
        ring = np.vstack([ring, ring[:1]])
        axes.plot(ring[:, 1], ring[:, 0], label=f"{trunk[k, :, 2].mean():.2f} m")
        axes.plot(trunk[k, :, 1], trunk[k, :, 0], "k.", ms=3)
    axes.set_aspect("equal")
    axes.invert_xaxis()
    axes.legend(fontsize=7)
    axes.set_title("6 control points and B-splines of the trunk, from above")


def _surface(axes: Any, acquired: Acquired, rest: bool, azimuth: float) -> None:
    body, points = acquired.body, acquired.surface
    joints = np.array(list(acquired.measured.joints.values()))
    if rest:
        posed = Posed(body, Pose.rest(body))
        points, joints = posed.vertices, posed.landmarks
    axes.plot_trisurf(*points.T, triangles=body.faces, color="0.8", alpha=0.6, lw=0)
    axes.scatter(*joints.T, c="r", s=8, depthshade=False)
    axes.set_box_aspect(np.ptp(points, axis=0))
    axes.view_init(elev=8, azim=azimuth)
