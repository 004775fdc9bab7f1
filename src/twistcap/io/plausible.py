"""Whether the places of cameras and person are possible, which a small reprojection error does not show.

A mirrored board pose can have an error of 0.3 px while the heels are half a metre underground.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body.rig import TALLER
from twistcap.camera import Camera, Rig
from twistcap.errors import InputError, check

_NEAREST, _FARTHEST = 0.05, 100.0  # plausible distances between two cameras, m
_UNDERGROUND = 0.3  # m below the floor that no joint of a person and not every camera can be


def check_plausible(
    rig: Rig, points: ArrayLike | None = None, floor: float | None = 0.0, source: str = "the calibration"
) -> None:
    """Check that the places of the cameras are possible and that a person at `points` is above ground and seen.

    `points` (N, 3) are of the person in the first frame, world, m; None checks the cameras alone. `floor` is its
    height, m; None where the world's z is not upward. Messages name the source. Raises InputError: cameras inside each
    other, implausibly far apart, without a common view or all underground; a person underground or outside every view.
    """
    distances = camera_distances(rig)
    for (a, b), distance in zip(combinations(rig, 2), distances, strict=True):
        _check_distance(f"{source}: cameras {a.name!r} and {b.name!r}", distance)
    if len(rig) > 1:
        _check_common_view(rig, float(distances.max()), source)
    heights = np.array([camera.centre[2] for camera in rig])
    if floor is not None and heights.max() - floor < -_UNDERGROUND:
        raise InputError(
            f"{source}: every camera stands underground (the highest at z = {heights.max() - floor:.2f} m); the"
            " calibration is mirrored or its z axis points down; the world must be z up with the floor at [cameras]"
            " floor."
        )
    if points is not None:
        _check_person(rig, np.asarray(points, float).reshape(-1, 3), floor, source)


def camera_distances(rig: Rig) -> Float:
    """(P,) m between the cameras of each pair."""
    return np.array([np.linalg.norm(a.centre - b.centre) for a, b in combinations(rig, 2)], dtype=float)


def span_in_words(lengths: ArrayLike, unit: str = " m") -> str:
    """The least and the greatest of some lengths, such as ``2.1 to 6.4 m``."""
    least, most = (f"{float(length):.3g}" for length in (np.min(lengths), np.max(lengths)))
    return f"{least}{unit}" if least == most else f"{least} to {most}{unit}"


def _check_distance(cameras: str, distance: float) -> None:
    """Two cameras do not stand inside each other or implausibly far apart."""
    if distance < _NEAREST:
        raise InputError(
            f"{cameras} stand inside each other ({1000 * distance:.0f} mm apart);"
            " one was calibrated with the other's pictures, or the unit is 'm' and not 'mm'."
        )
    if distance > _FARTHEST:
        mend = 'the file is probably in millimetres: set [cameras] unit = "mm", or say --unit mm'
        raise InputError(f"{cameras} are {distance:.0f} m apart; {mend}.")


def _check_common_view(rig: Rig, reach: float, source: str) -> None:
    """Every camera sees some place that another one sees too."""
    for camera in rig:
        places = _frustum_points(camera, reach)
        if not any(np.any(_sees(other, places)) for other in rig if other is not camera):
            raise InputError(
                f"{source}: camera {camera.name!r} sees nothing that another camera sees (they look away from each"
                " other); rotation and translation must lead from world to camera: invert them if they do not."
            )


def _check_person(rig: Rig, points: Float, floor: float | None, source: str) -> None:
    """A person's points are finite, above ground and in view."""
    check(source, np.all(np.isfinite(points)), "the first pose holds NaN; check the keypoints of the first frame")
    if floor is not None and points[:, 2].min() < floor - _UNDERGROUND:
        raise InputError(
            f"{source}: the person of the first pose is underground (lowest point {points[:, 2].min() - floor:.2f} m"
            " from the floor); the calibration is mirrored or its z axis points down; set [cameras] floor if the floor"
            " is elsewhere."
        )
    if not any(np.any(_sees(camera, points)) for camera in rig):
        raise InputError(
            f"{source}: no camera sees the person of the first pose; check the pose's unit and that it"
            " belongs to these cameras."
        )


def check_upright(landmarks: Mapping[str, ArrayLike]) -> None:
    """Head above feet; not for a first pose that is truly upside down ([first_pose] upright = false).

    `landmarks` are world points (3,) m by name, e.g. ``nose`` and ``ankle_r``; those that are absent do not count.
    Raises InputError for a person upside down.
    """
    high, low = ([np.asarray(landmarks[name], float)[2] for name in names if name in landmarks] for names in TALLER)
    if high and low and max(high) < min(low):
        raise InputError(
            "the first pose: the person stands on the head; the calibration is mirrored or its z axis points down"
            " (set [first_pose] upright = false if it is true)."
        )


def _frustum_points(camera: Camera, reach: float) -> Float:
    """(N, 3) world points over the view of the camera, between 1/10 of and 3 × `reach` m away."""
    width, height = camera.size
    x, y = np.meshgrid(np.linspace(0, width - 1, 13), np.linspace(0, height - 1, 13))
    xy = camera.normalised(np.stack([x.ravel(), y.ravel()], axis=-1))
    xy = xy[np.all(np.isfinite(xy), axis=-1)]
    rays = np.concatenate([xy, np.ones_like(xy[:, :1])], axis=-1)
    depths = np.geomspace(0.1, 3.0, 16) * max(reach, _NEAREST)
    return se3.apply(se3.inverse(camera.T_cam_world), (rays[None] * depths[:, None, None]).reshape(-1, 3))


def _sees(camera: Camera, points: Float) -> Bool:
    """(N,) whether points (N, 3) fall inside the image, without distortion, whose polynomial folds back far outside."""
    pixels, depth = camera.pinhole().project(points)
    with np.errstate(invalid="ignore"):
        return (depth > 0) & np.all((pixels > -0.5) & (pixels < np.array(camera.size) - 0.5), axis=-1)
