"""What the viewer's page shows: bodies by frame, cameras with their images, outlines, angles and a reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray, Float, Int
from twistcap.body import Body, Posed
from twistcap.body.kinematics import unit_vertex_normals
from twistcap.body.limbs import most_of_limbs, named_limbs
from twistcap.camera import Camera, Rig
from twistcap.camera.bump import bumped
from twistcap.errors import InputError
from twistcap.estimate import UNSEEN
from twistcap.evaluate.load import Reference
from twistcap.io.coordinates import coordinates_of, opensim_angles
from twistcap.io.result import Result
from twistcap.io.video import Source
from twistcap.pages.assemble import jpeg, packed, page
from twistcap.pages.outlines import body_outlines, flat
from twistcap.report.words import camera_in_words, frame_in_words, limb_in_words, result_in_words

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
    results: Mapping[str, Result], sources: Mapping[str, Source] | None = None, reference: Reference | None = None,
    title: str = "twistcap", options: Options | None = None,
) -> str:  # fmt: skip
    """The viewer as one HTML file.

    Of `results`, by the name they are shown under, the first one's cameras are drawn; those without a source of images
    are drawn without. The reference is shown at the results' times. Raises InputError for no result, results without
    frames, or an image that cannot be read.
    """
    if not results or not any(len(result) for result in results.values()):
        raise InputError("no result has a frame; there is nothing to view.")
    sources, options = sources or {}, options or Options()
    first = next(iter(results.values()))
    rig, width = first.rig, options.width
    indices, times = _time_line(list(results.values()))
    every = max(1, -(-len(indices) // max(1, options.images)))
    pictured = np.arange(0, len(indices) if sources else 0, every, dtype=np.int32)
    drawn, pictures = rig if sources else Rig(()), _pictures(first, sources, indices[pictured], width)
    document = {
        "indices": indices.tolist(),
        "times": np.round(times, 6).tolist(),
        "shown": pictured.tolist(),
        "cameras": [_camera(camera, pictures[camera.name], width) for camera in rig],
        "runs": [_run(name, result, indices, pictured, drawn, width) for name, result in results.items()],
        "reference": None if reference is None else _reference(reference, first.body, times, rig, pictured, width),
    }
    return page("view", title, document)


def _time_line(results: Sequence[Result]) -> tuple[Int, Float]:
    """All frame numbers of all results, rising, and their times, s."""
    indices, first = np.unique(np.concatenate([result.indices for result in results]), return_index=True)
    return indices.astype(np.int32), np.concatenate([result.times for result in results])[first]


def _factor(camera: Camera, width: int) -> float:
    return min(1.0, width / camera.size[0])


def _pictures(
    result: Result, sources: Mapping[str, Source], indices: Int, width: int
) -> Mapping[str, Sequence[str | None]]:
    """The images that each camera took, also where they came under another one's name; None for one that was dropped,
    or does not exist, and nothing of cameras without a source.
    """
    given, names = dict[str, list[str | None]](), result.rig.names
    for name, source in sources.items():
        wanted = [int(index) for index in indices if index < len(source)]
        read = [None if image is None else jpeg(image, width) for image in source.read(wanted)]
        given[name] = read + [None] * (len(indices) - len(read))
    out = {name: list(given.get(name, [])) for name in names}
    where = {int(index): row for row, index in enumerate(result.indices)}
    for k, row in enumerate(where.get(int(index), -1) for index in indices):
        for c in np.flatnonzero(result.swapped[row]) if row >= 0 else ():
            if names[c] in given:
                source = given.get(names[result.sources[row, c]])
                out[names[c]][k] = source[k] if source else None
    return out


def _camera(camera: Camera, images: Sequence[str | None], width: int) -> dict[str, Any]:
    """Pose, size and images of a camera; those that are not there are null."""
    small = camera.scaled(_factor(camera, width))
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (np.array(camera.size) - 1.0)
    rays = camera.pinhole().normalised(corners)
    R, t = camera.T_cam_world[:3, :3], camera.T_cam_world[:3, 3]
    ends = (np.column_stack([rays, np.ones(4)]) - t) @ R
    return {
        "name": camera.name,
        "size": list(small.size),
        "images": list(images),
        "centre": camera.centre.tolist(),
        "corners": ends.tolist(),  # of the image at 1 m depth, world
    }


def _run(name: str, result: Result, indices: Int, shown: Int, rig: Rig, width: int) -> dict[str, Any]:
    body, names = result.body, result.rig.names
    limbs, table = named_limbs(body), coordinates_of(body, result.poses, result.covariances, known=result.known)
    own = [table.names.index(coordinate) for coordinate in body.coordinate_names]
    angles, sigmas = (columns[:, own] for columns in table.in_degrees)
    where = {int(index): row for row, index in enumerate(result.indices)}
    rows = [where.get(int(index), -1) for index in indices]
    posed = [Posed(body, pose) for pose in result.poses]
    shape = (len(posed), len(body.segment_names), 12)
    transforms = np.array([p.segment_transforms[:, :3] for p in posed]).reshape(shape)
    outlines = [
        [
            flat(body_outlines(_as_it_stood(camera, result, rows[k]), posed[rows[k]]), _factor(camera, width))
            if rows[k] >= 0
            else []
            for k in shown
        ]
        for camera in rig
    ]
    return {
        "name": name, "rows": rows, "transforms": packed(transforms), "outlines": outlines,
        "body": {
            "vertices": packed(body.vertices), "normals": packed(unit_vertex_normals(body.vertices, body.faces)),
            "faces": packed(body.faces.astype(np.uint32)), "segments": packed(body.skin_segments.astype(np.uint16)),
            "weights": packed(body.skin_weights),
        },
        "lost": result.lost.astype(int).tolist(), "probability": np.round(result.probability, 3).tolist(),
        "dropped": [int(status in UNSEEN) for status in result.statuses],
        "limbs": [limb_in_words(limb) for limb in limbs],
        "limb_probability": packed(most_of_limbs(limbs, result.part_probability)),
        "notes": [frame_in_words(e, limbs, names) for e in result.estimates], "statements": result_in_words(result),
        "cameras": [[camera_in_words(e, c) for c in range(len(names))] for e in result.estimates],
        "coordinates": list(body.coordinate_names), "units": ["°" if table.turning[k] else " m" for k in own],
        "angles": packed(angles), "sigmas": packed(np.nan_to_num(sigmas)),
    }  # fmt: skip


def _as_it_stood(camera: Camera, result: Result, row: int) -> Camera:
    """A camera turned as it was in a row of a result; as it is where the result does not know it."""
    names = result.rig.names
    return bumped(camera, result.bumps[row, names.index(camera.name)]) if camera.name in names else camera


def _reference(reference: Reference, body: Body, times: Float, rig: Rig, shown: Int, width: int) -> dict[str, Any]:
    points, own = reference.at(times)
    names, angles = reference.names, opensim_angles(body, reference.coordinate_names, own)
    seen = rig if len(shown) and names else ()
    pixels: list[list[Any]] = [[] for _ in rig]
    for k, camera in enumerate(seen):
        places, depth = camera.scaled(_factor(camera, width)).project(points[shown])
        places[depth <= 0] = np.nan  # the camera does not see them
        pixels[k] = [_known(frame, 1) for frame in places]
    return {
        "points": [_known(frame, 4) for frame in points],
        "sticks": [[names.index(a), names.index(b)] for a, b in STICKS if a in names and b in names],
        "coordinates": list(reference.coordinate_names),
        "angles_deg": [[round(float(v), 3) if np.isfinite(v) else None for v in row] for row in np.rad2deg(angles)],
        "pixels": pixels,
    }


def _known(points: AnyArray, digits: int) -> list[list[float] | None]:
    """Rounded rows of (P, D), null where one is not finite."""
    return [np.round(p, digits).tolist() if np.isfinite(p).all() else None for p in points]
