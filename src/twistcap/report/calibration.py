"""The page of a calibration: how well each camera fits, where, what was covered, where the cameras are, what to do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Ellipse

from twistcap import se3
from twistcap.calibrate.advice import camera_rows, distances, sentences
from twistcap.calibrate.calibrate import Calibration
from twistcap.calibrate.sightings import SCENE
from twistcap.calibrate.world import centre_covariance
from twistcap.evaluate.metrics import Row, row
from twistcap.report.page import Figure, Headline, write_report
from twistcap.report.plots import literal

_GOOD, _WRONG, _BOARD = "#1780d6", "#e5484d", "#3d8f6d"
_COLOURS = ("#e8790c", "#1780d6", "#3d8f6d", "#a24bd6", "#c62f35", "#7a6a00", "#0d8f95", "#5d6875")
_PX, _MM, _DEG, _PERCENT = (0.5, 2.0), (5.0, 20.0), (0.3, 1.0), (0.3, 1.0)  # good below, bad above


@literal
def write_calibration_page(found: Calibration, folder: Path, title: str = "Calibration") -> Path:
    """Write ``calibration.html`` into a folder. Raises InputError where it cannot be written."""
    rows = camera_rows(found)
    drawn = ((_places(found), _places_caption(found)), (_images(found), _IMAGES), (_histogram(found), _HISTOGRAM))
    said = sentences(found)
    remarks, todo = said[: len(rows)], said[len(rows) :]  # a line for each camera comes first
    return write_report(
        folder, title, _table(rows, found.timing.alike), lead=_lead(found), headlines=_headlines(rows),
        figures=[Figure(*each) for each in drawn], notes=remarks, name="calibration.html",
        files={folder / "Calib.toml": "the calibration; read by twistcap, Pose2Sim and aniposelib"},
        advice=todo or ["Nothing: every camera saw enough. Do not move the cameras any more."],
    )  # fmt: skip


def _lead(found: Calibration) -> str:
    moments = len({s.moment for s in found.adjustment.sightings})
    start = f"{len(found.rig)} cameras by"
    if "scene" in found.adjustment.solids:
        lenses = f"lenses by {moments - 1} pictures of a {found.board.words}"
        return f"{start} {len(found.points)} measured points of the scene, {lenses}. The world is that of the points."
    floor = "z = 0 is the floor" if found.floor_known else "the floor is not known, and up is a guess by the images"
    return f"{start} {moments} moments of a {found.board.words}. In this world {floor}."


def _headlines(rows: Sequence[dict[str, Any]]) -> list[Headline]:
    rms = float(np.sqrt(np.average([r["rms_px"] ** 2 for r in rows], weights=[r["points"] for r in rows])))
    place = 1e3 * max(float(np.max(r["centre_sigma_m"])) for r in rows)
    turn = max(r["turn_sigma_deg"] for r in rows)
    focal = 100 * max(r["focal_sigma"] for r in rows)
    return [
        Headline("reprojection, rms", f"{rms:.2f}", "px", _verdict(rms, *_PX)),
        Headline("least certain place, ±1σ", f"{place:.1f}", "mm", _verdict(place, *_MM)),
        Headline("least certain direction, ±1σ", f"{turn:.2f}", "deg", _verdict(turn, *_DEG)),
        Headline("least certain focal length, ±1σ", f"{focal:.2f}", "%", _verdict(focal, *_PERCENT)),
    ]


def _verdict(value: float, good: float, bad: float) -> bool | None:
    return True if value < good else False if value > bad else None


def _table(rows: Sequence[dict[str, Any]], alike: bool) -> list[Row]:
    """`alike`: whether all cameras are equally fast; else clocks are in seconds."""
    out = list[Row]()
    for r in rows:
        name = r["camera"]
        out += [
            row(name, "reprojection, rms", r["rms_px"], "px"),
            row(name, "reprojection, median", r["median_px"], "px"),
            row(name, "wrong points, left out", 100 * r["wrong"], "%"),
            row(name, "part of the image with points", 100 * r["covered"], "%"),
            row(name, "sightings", r["sightings"], ""),
            row(name, "focal length", r["focal_px"], "px"),
            row(name, "place, ±1σ, worst axis", 1e3 * float(np.max(r["centre_sigma_m"])), "mm"),
            row(name, "direction, ±1σ", r["turn_sigma_deg"], "deg"),
            row(name, "shows later moments by", r["late_frames"] if alike else r["late_s"], "frames" if alike else "s"),
        ]
    return out


_IMAGES = (
    "Every point of the board in each image: where it was (dots), and twenty times how far the calibration misses it"
    " (lines). Red points were taken for wrong. Lines that turn together are a lens that was not learned there; empty"
    " parts of an image were never seen."
)
_HISTOGRAM = (
    "How many points of each camera are how far off; the last column has all that are farther. A second hump is a"
    " clock, or a camera that was moved."
)


def _places_caption(found: Calibration) -> str:
    up = "The floor is the line at 0." if found.floor_known else "The height is from amid the board, not the floor."
    return f"The cameras from above and from the side, ellipses of ±2σ drawn ten times as large, and the boards. {up}"


def _images(found: Calibration) -> bytes:
    count = len(found.rig)
    columns = min(math.ceil(math.sqrt(count)), 3)
    lines = -(-count // columns)
    width, height = found.rig[0].size
    drawing = Drawing(figsize=(12, lines * (12 / columns * height / width + 0.35)), layout="constrained")
    for c, camera in enumerate(found.rig):
        axes = drawing.add_subplot(lines, columns, c + 1)
        axes.set(xlim=(-0.5, camera.size[0] - 0.5), ylim=(camera.size[1] - 0.5, -0.5), aspect="equal")
        axes.set_title(camera.name, fontsize=10)
        axes.tick_params(labelsize=7)
        _draw_residuals(axes, found, c)
    return _png(drawing)


def _draw_residuals(axes: Axes, found: Calibration, camera: int) -> None:
    a = found.adjustment
    for s, kept, off in zip(a.sightings, a.kept, a.residuals, strict=True):
        if s.camera != camera:
            continue
        right, wrong = s.pixels[kept], s.pixels[~kept]
        tips = right + 20.0 * off[kept]
        axes.plot(*np.stack([right, tips], axis=1).transpose(2, 1, 0), color=_GOOD, lw=0.6, alpha=0.8)
        axes.plot(*right.T, ".", color=_GOOD, ms=1.5)
        axes.plot(*wrong.T, ".", color=_WRONG, ms=4)


def _places(found: Calibration) -> bytes:
    drawing = Drawing(figsize=(12, 5.2), layout="constrained")
    for k, (axis, name) in enumerate(((1, "from above: x and y, m"), (2, "from the side: x and z, m"))):
        axes = drawing.add_subplot(1, 2, k + 1)
        axes.set_title(name, fontsize=10)
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.3)
        axes.margins(0.12)  # room for the names
        for c in range(len(found.rig)):
            _draw_camera(axes, found, c, axis)
        _draw_boards(axes, found, axis)
        if axis == 2 and found.floor_known:
            axes.axhline(0.0, color="black", lw=1)
    return _png(drawing)


def _draw_camera(axes: Axes, found: Calibration, c: int, axis: int) -> None:
    camera, colour = found.rig[c], _COLOURS[c % len(_COLOURS)]
    pair = [0, axis]
    centre, view = camera.centre[pair], camera.T_cam_world[2, :3][pair]
    covariance = centre_covariance(camera.T_cam_world, found.adjustment.places[c])[np.ix_(pair, pair)]
    reach = 0.25 * max(float(np.ptp([camera.centre for camera in found.rig], axis=0).max()), 0.5)
    axes.plot(*np.stack([centre, centre + reach * view]).T, color=colour, lw=1.5)
    axes.plot(*centre, "o", color=colour, ms=6)
    values, vectors = np.linalg.eigh(covariance)
    wide, high = 2 * 10 * 2 * np.sqrt(np.maximum(values, 0.0))
    angle = np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0]))
    axes.add_patch(Ellipse((float(centre[0]), float(centre[1])), wide, high, angle=angle, color=colour, alpha=0.25))
    axes.annotate(camera.name, tuple(centre), fontsize=9, xytext=(6, 6), textcoords="offset points", color=colour)


def _draw_boards(axes: Axes, found: Calibration, axis: int) -> None:
    a = found.adjustment
    used = {s.moment for s in a.sightings} - {SCENE}
    if "board" in a.solids:
        width, height = found.board.size
        outline = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0], [0, 0, 0]])
        for m in sorted(used & set(a.guess.boards)):
            axes.plot(*se3.apply(a.guess.boards[m], outline)[:, [0, axis]].T, color=_BOARD, lw=0.5, alpha=0.5)
    if "scene" in a.solids:
        axes.plot(*a.solids["scene"].points[:, [0, axis]].T, "x", color=_BOARD, ms=4)


def _histogram(found: Calibration) -> bytes:
    drawing = Drawing(figsize=(12, 3), layout="constrained")
    axes, a = drawing.add_subplot(), found.adjustment
    sizes = [
        np.concatenate(
            [np.linalg.norm(r, axis=1) for s, r in zip(a.sightings, a.residuals, strict=True) if s.camera == c]
        )
        for c in range(len(found.rig))
    ]
    right = np.concatenate([distances(found, c) for c in range(len(found.rig))])
    top = max(2.0 * float(np.percentile(right, 98)), 0.1)
    for c, (camera, own) in enumerate(zip(found.rig, sizes, strict=True)):
        colour = _COLOURS[c % len(_COLOURS)]
        bins = np.linspace(0, top, 60).tolist()
        axes.hist(np.minimum(own, top), bins=bins, histtype="step", color=colour, label=camera.name, lw=1.4)
    axes.set(xlabel="px off", ylabel="points", xlim=(0, top))
    axes.legend(fontsize=8, loc="upper center")
    return _png(drawing)


def _png(drawing: Drawing) -> bytes:
    out = BytesIO()
    FigureCanvasAgg(drawing).print_png(out)
    return out.getvalue()
