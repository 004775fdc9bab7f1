"""What the viewer's page shows: bodies by frame, cameras with their images, outlines, angles and a reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray, Float, Int
from twistcap.body import Body, Posed
from twistcap.body.kinematics import unit_vertex_normals
from twistcap.camera import Camera, Rig
from twistcap.errors import InputError
from twistcap.evaluate.load import Reference
from twistcap.io.result import Result
from twistcap.io.video import Source
from twistcap.pages.assemble import jpeg, packed, page
from twistcap.pages.outlines import body_outlines, flat

STICKS = (
    ("head_top", "neck"), ("neck", "shoulder_r"), ("neck", "shoulder_l"), ("neck", "mid_hip"), ("hip_r", "hip_l"),
    *((f"{a}_{side}", f"{b}_{side}") for side in "rl" for a, b in (
        ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("ankle", "toe"),
    )),
)  # fmt: skip
"""Landmarks that the reference's lines join."""


@dataclass(frozen=True)
class Options:
    """How much goes into a page."""

    width: int = 360  # of the images at most, px
    images: int = 120  # frames that get images and outlines at most, spread evenly


def view_page(
    results: Mapping[str, Result],
    sources: Mapping[str, Source] | None = None,
    reference: Reference | None = None,
    title: str = "twistcap",
    options: Options | None = None,
) -> str:
    """The viewer as one HTML file.

    Of `results`, by the name they are shown under, the first one's cameras are drawn; those without a source of images
    are drawn without. The reference is shown at the results' times. Raises InputError for no result, results without
    frames, or an image that cannot be read.
    """
    if not results or not any(len(result) for result in results.values()):
        raise InputError("no result has a frame; there is nothing to view.")
    return page("view", title, view_document(results, sources or {}, reference, options or Options()))


def view_document(
    results: Mapping[str, Result], sources: Mapping[str, Source], reference: Reference | None, options: Options
) -> dict[str, Any]:
    """What `view_page` gives its script, as JSON data."""
    first = next(iter(results.values()))
    indices, times = _time_line(list(results.values()))
    shown = _spread(len(indices), options.images)
    pictured = shown if sources else np.zeros(0, np.int32)
    return {
        "indices": indices.tolist(),
        "times": np.round(times, 6).tolist(),
        "shown": pictured.tolist(),
        "cameras": [
            _camera(camera, sources.get(camera.name), indices[pictured], options.width) for camera in first.rig
        ],
        "runs": [
            _run(name, result, indices, pictured, first.rig if sources else Rig(()), options.width)
            for name, result in results.items()
        ],
        "reference": None if reference is None else _reference(reference, times, first.rig, pictured, options.width),
    }


def _time_line(results: Sequence[Result]) -> tuple[Int, Float]:
    """All frame numbers of all results, rising, and their times, s."""
    at: dict[int, float] = {}
    for result in results:
        for index, time in zip(result.indices.tolist(), result.times.tolist(), strict=True):
            at.setdefault(index, time)
    indices = sorted(at)
    return np.array(indices, np.int32), np.array([at[index] for index in indices])


def _spread(count: int, most: int) -> Int:
    """Positions 0 … count − 1, every k-th so that at most `most` remain."""
    return np.arange(0, count, max(1, -(-count // max(1, most))), dtype=np.int32)


def _factor(camera: Camera, width: int) -> float:
    return min(1.0, width / camera.size[0])


def _camera(camera: Camera, source: Source | None, indices: Int, width: int) -> dict[str, Any]:
    """Pose, size and images of a camera; an image that was dropped, or does not exist, is null."""
    images: list[str | None] = []
    if source is not None:
        wanted = [int(index) for index in indices if index < len(source)]
        images = [None if image is None else jpeg(image, width) for image in source.read(wanted)]
        images += [None] * (len(indices) - len(images))
    small = camera.scaled(_factor(camera, width))
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (np.array(camera.size) - 1.0)
    rays = camera.pinhole().normalised(corners)
    R, t = camera.T_cam_world[:3, :3], camera.T_cam_world[:3, 3]
    ends = (np.column_stack([rays, np.ones(4)]) - t) @ R
    return {
        "name": camera.name,
        "size": list(small.size),
        "images": images,
        "centre": camera.centre.tolist(),
        "corners": ends.tolist(),  # of the image at 1 m depth, world
    }


def _run(name: str, result: Result, indices: Int, shown: Int, rig: Rig, width: int) -> dict[str, Any]:
    where = {int(index): row for row, index in enumerate(result.indices)}
    rows = [where.get(int(index), -1) for index in indices]
    posed = [Posed(result.body, pose) for pose in result.poses]
    transforms = np.array([p.segment_transforms[:, :3] for p in posed]).reshape(
        len(posed), len(result.body.segment_names), 12
    )
    sigma = np.sqrt(np.maximum(np.diagonal(result.covariances, axis1=1, axis2=2)[:, 6:], 0.0))
    outlines = [
        [flat(body_outlines(camera, posed[rows[k]]), _factor(camera, width)) if rows[k] >= 0 else [] for k in shown]
        for camera in rig
    ]
    return {
        "name": name,
        "rows": rows,
        "body": _body(result.body),
        "transforms": packed(transforms),
        "lost": result.lost.astype(int).tolist(),
        "dropped": [int(status == "no_images") for status in result.statuses],
        "coordinates": list(result.body.coordinate_names),
        "angles_deg": packed(np.rad2deg(result.q)),
        "sigma_deg": packed(np.rad2deg(np.nan_to_num(sigma))),
        "outlines": outlines,
    }


def _body(body: Body) -> dict[str, Any]:
    return {
        "vertices": packed(body.vertices),
        "normals": packed(unit_vertex_normals(body.vertices, body.faces)),
        "faces": packed(body.faces.astype(np.uint32)),
        "segments": packed(body.skin_segments.astype(np.uint16)),
        "weights": packed(body.skin_weights),
    }


def _reference(reference: Reference, times: Float, rig: Rig, shown: Int, width: int) -> dict[str, Any]:
    points, angles = reference.at(times)
    names = reference.names
    pixels = [
        _pixels(camera.scaled(_factor(camera, width)), points[shown]) if len(shown) and names else [] for camera in rig
    ]
    return {
        "points": [_triples(frame) for frame in points],
        "sticks": [[names.index(a), names.index(b)] for a, b in STICKS if a in names and b in names],
        "coordinates": list(reference.coordinate_names),
        "angles_deg": [[_finite(v) for v in row] for row in np.rad2deg(angles)],
        "pixels": pixels,
    }


def _pixels(camera: Camera, points: Float) -> list[Any]:
    """(F, P) lists of x, y; null where the camera does not see the point."""
    pixels, depth = camera.project(points)
    pixels[depth <= 0] = np.nan
    return [[None if np.isnan(p).any() else np.round(p, 1).tolist() for p in frame] for frame in pixels]


def _triples(points: AnyArray) -> list[list[float] | None]:
    return [np.round(p, 4).tolist() if np.isfinite(p).all() else None for p in points]


def _finite(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
