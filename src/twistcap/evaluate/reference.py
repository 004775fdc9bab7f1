"""`evaluate`: a result against a reference, as table rows and as the arrays that plots need."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Bool, Float
from twistcap.body import Body, Posed
from twistcap.camera import Camera, Rectifier
from twistcap.doors.images import read_image
from twistcap.errors import InputError, check
from twistcap.evaluate import metrics
from twistcap.evaluate.agreement import Agreement, Distance, agreements, distances
from twistcap.evaluate.alignment import aligned, better_axes
from twistcap.evaluate.load import Reference, load_reference
from twistcap.evaluate.metrics import Row, row
from twistcap.evaluate.ours import Angles, shared_angles
from twistcap.io.angles import nearest, shoulders_of
from twistcap.io.coordinates import opensim_angles
from twistcap.io.isb import ISB
from twistcap.io.markers import WorldAxes
from twistcap.io.result import Result

_WITH_AXES = (".trc", ".c3d")  # files of points, which do not say how their world lies


@dataclass(frozen=True)
class Errors:
    """Differences to a reference, frame by frame."""

    names: tuple[str, ...]  # K joints or coordinates
    reference: Float  # (N, K, 3) m or (N, K) rad, the reference at the result's times
    raw: Float  # (N, K) mm (distances) or degrees (signed)
    offset_removed: Float  # (N, K) the same with the constant offset of each joint or coordinate removed

    def by_name(self) -> dict[str, dict[str, float | None]]:
        """Mean absolute error of each joint or coordinate, raw and with the offset removed."""
        means = [[metrics.mean_known(c) for c in np.abs(values).T] for values in (self.raw, self.offset_removed)]
        known = [[mean if np.isfinite(mean) else None for mean in values] for values in means]
        return {n: {"raw": raw, "offset_removed": rest} for n, raw, rest in zip(self.names, *known, strict=True)}


@dataclass(frozen=True)
class Overlap:
    """IoU of one rendered silhouette with a given mask."""

    camera: str
    frame: int
    iou: float


@dataclass(frozen=True)
class Evaluation:
    """A comparison with a reference."""

    case: str  # its name
    rows: list[Row]
    joints: Errors | None = None  # position errors, mm, where the reference has joints
    angles: Errors | None = None  # angle errors, degrees, where it has coordinates
    overlaps: list[Overlap] = field(default_factory=list[Overlap])  # IoU by mask, where it is a folder of masks
    lost_frames: list[int] = field(default_factory=list[int])  # by the reference (`metrics.lost_frames`)
    frames: int = 0  # that are compared
    unknown_frames: list[int] = field(default_factory=list[int])  # of these, lost or unseen as the tracker says
    notes: tuple[str, ...] = ()  # assumptions, and what counts
    agreements: list[Agreement] = field(default_factory=list[Agreement])  # degrees, as exports have them

    @property
    def distances(self) -> list[Distance]:
        """Of each joint, mm."""
        found = self.joints
        return distances(found.names, found.raw, found.offset_removed) if found else []

    def as_dict(self) -> dict[str, Any]:
        """The whole as JSON-ready values."""
        errors = {"joints_mm": self.joints, "angles_deg": self.angles}
        by_name = {key: found.by_name() if found else {} for key, found in errors.items()}
        masks = [vars(overlap) for overlap in self.overlaps]
        rest = {"masks": masks, "lost_frames": self.lost_frames, "notes": list(self.notes)}
        rest |= {"compared_frames": self.frames, "unknown_frames": self.unknown_frames}
        tables = {"agreements_deg": self.agreements, "distances_mm": self.distances}
        each = {key: [vars(entry) for entry in table] for key, table in tables.items()}
        return {"case": self.case, "rows": self.rows, **by_name, **each, **rest}


def evaluate(
    result: Result, reference: Path | str, time_offset: float = 0.0, *, exclude: Sequence[str] = (),
    case: str | None = None, axes: WorldAxes = "opensim", align: bool = False, register: bool = False,
) -> Evaluation:  # fmt: skip
    """Compare a result with a reference.

    Args:
        reference: studio truth (``truth.npz`` or its folder), ``.trc``, ``.c3d``, ``.mot``, ``.sto``, 3D keypoints
            (``.npz`` with ``X`` (N, 25, 3) m) or a folder of masks ``CAM/frame_XXXX.png``.
        time_offset: seconds to add to the reference's clock to get the recording's.
        exclude: flawed stretches of the reference, see `Reference.without`.
        case: name in the table; the reference's own name by default.
        axes: how the world of a TRC or C3D lies in ours, see `io.markers`.
        align: whether the reference's clock is moved to where the movements agree best, see `alignment`.
        register: whether its world is turned and moved to where the points agree best.

    Raises InputError for a reference that is missing, unreadable, or has nothing in common with the result.
    """
    check("evaluate", len(result.indices) > 0, "the result has no frame")
    path = Path(reference)
    path = path / "truth.npz" if (path / "truth.npz").is_file() else path
    case = case or (path.name if path.is_dir() else path.stem)
    check("evaluate", abs(time_offset) < 1e11, f"the time offset is {time_offset:g}; give seconds, such as 0.0217")
    if path.is_dir():
        given = {"time offset": time_offset, "exclude": exclude, "align": align, "register": register}
        if unused := [name for name, value in given.items() if value]:
            raise InputError(f"masks in {path} are matched by frame number; leave {unused[0]} out.")
        return _against_masks(result, path, case)
    truth = load_reference(path, result.body, lambda rows: frame_times(result, rows), axes)
    truth = replace(truth, times=truth.times + time_offset).without(exclude)
    truth = aligned(result, truth, align, register) if align or register else truth
    found = compare(result, truth, case, str(path))
    if found.joints is None or register or path.suffix.lower() not in _WITH_AXES:
        return found
    note = better_axes(_placed(result, found.joints.names), found.joints.reference, axes)
    return replace(found, notes=(*found.notes, note)) if note else found


def frame_times(result: Result, rows: int) -> Float:
    """Times (rows,) s of frames 0 … rows − 1 on the result's own clock."""
    indices, times = np.asarray(result.indices, float), np.asarray(result.times, float)
    if len(times) < 2:
        raise InputError("a reference without a clock (fps or times) needs a result of at least two frames.")
    step = (times[-1] - times[0]) / (indices[-1] - indices[0])
    return times[0] + (np.arange(rows) - indices[0]) * step


def compare(result: Result, truth: Reference, case: str, source: str = "the reference") -> Evaluation:
    """Compare a result with a reference already in memory (its clock the recording's); see `evaluate`."""
    times = np.asarray(result.times, float)
    points, angles = truth.at(times)
    own = shared_angles(result, truth.coordinate_names)
    _expect_common(result, truth, own, times, source)
    joints = _joint_errors(result, truth.names, points)
    coordinates = _angle_errors(result.body, own, truth.coordinate_names, angles)
    if not any(np.isfinite(found.raw).any() for found in (joints, coordinates) if found):
        raise InputError(f"{source} says nothing in the frames of the result: all its values there are missing.")
    rows, lost = list[Row](), list[int]()
    if coordinates:
        rows += _angle_rows(case, coordinates) + _honesty_rows(case, own, coordinates)
    if joints:
        lost = [int(i) for i in np.asarray(result.indices)[metrics.lost_frames(joints.raw)]]
        rows += _summary(case, "joints", joints.raw, "", "mm")
        rows += _summary(case, "joints", joints.offset_removed, ", offset removed", "mm")
        rows.append(row(case, "lost frames, by the reference", float(len(lost)), "frames", lost=len(lost)))
        rows.append(row(case, "lost sequence", float(metrics.lost_sequence(joints.raw)), "of 1"))
    rows.append(row(case, "lost frames, by the tracker itself", float(np.sum(result.lost)), "frames"))
    agreed = _agreements(result.body, coordinates) if coordinates else []
    known = [np.isfinite(found.raw).any(axis=1) for found in (joints, coordinates) if found]
    out = Evaluation(case, rows, joints, coordinates, lost_frames=lost, notes=truth.notes, agreements=agreed)
    return _counted(out, result, np.any(known, axis=0))


def _counted(found: Evaluation, result: Result, compared: Bool) -> Evaluation:
    """With the frames (N,) that were compared, and a note where the tracker itself does not believe all of them."""
    frames, unknown = int(compared.sum()), np.asarray(result.indices)[compared & ~result.known].tolist()
    found = replace(found, frames=frames, unknown_frames=unknown)
    if not unknown:
        return found
    fact = f"{len(unknown)} of {frames} compared frames are lost or unseen, as the tracker says"
    return replace(found, notes=(*found.notes, f"{fact}; they count like all others"))


def _expect_common(result: Result, truth: Reference, own: Angles, times: Float, source: str) -> None:
    first, last = truth.times[0], truth.times[-1]
    if not np.any((times >= first - 1e-6) & (times <= last + 1e-6)):
        both = f"covers {first:.3f} to {last:.3f} s, the result {times[0]:.3f} to {times[-1]:.3f} s"
        raise InputError(f"{source} {both}: they have no frame in common; check the time offset.")
    theirs = (*truth.names, *truth.coordinate_names)
    if not own.names and not set(result.body.landmarks.names) & set(theirs):
        ours = {*result.body.landmarks.names, *result.body.coordinate_names}
        had = f"{', '.join(theirs[:12])} …" if theirs else "none that can be read"
        names = f"it has {had}, the body {', '.join(sorted(ours)[:12])} …."
        raise InputError(f"{source} has no point or coordinate name in common with body {result.body.name!r}; {names}")


def compared_landmarks(ours: Sequence[str], theirs: Sequence[str]) -> tuple[str, ...]:
    """The joint centres that both have; all points that both have where the body is no human."""
    joints = tuple(name for name in metrics.JOINT_CENTRES if name in ours and name in theirs)
    return joints or tuple(name for name in ours if name in theirs)


def _joint_errors(result: Result, names: Sequence[str], points: Float) -> Errors | None:
    shared = compared_landmarks(result.body.landmarks.names, names)
    if not shared:
        return None
    theirs = points[:, [names.index(name) for name in shared]]
    difference = metrics.differences(_placed(result, shared), theirs)
    raw, rest = metrics.distances_mm(difference), metrics.distances_mm(metrics.without_offset(difference))
    return Errors(shared, theirs, raw, rest)


def _placed(result: Result, names: Sequence[str]) -> Float:
    """(N, K, 3) m, landmarks of the tracked body."""
    return result.landmarks[:, [result.body.landmarks.index(name) for name in names]]


def _angle_errors(body: Body, own: Angles, names: Sequence[str], angles: Float) -> Errors | None:
    turning = np.any(body.twists[:, :3], axis=1)  # a sliding coordinate is no angle
    kept = [k for k, name in enumerate(own.names) if own.isb or turning[body.coordinate(name)]]
    if not kept:
        return None
    shared = tuple(own.names[k] for k in kept)
    theirs = angles[:, [names.index(name) for name in shared]]
    difference = metrics.angle_differences_deg(own.values[:, kept], theirs)
    return Errors(shared, theirs, difference, metrics.without_offset(difference))


def _agreements(body: Body, errors: Errors) -> list[Agreement]:
    """Of the coordinates as exports have them, so that other programs find the same numbers in the files."""
    names, theirs = errors.names, errors.reference
    ours = theirs + np.radians(errors.raw)
    if not names[0].startswith(ISB):
        ours, theirs = (opensim_angles(body, names, angles) for angles in (ours, theirs))
        for _, trio in shoulders_of(body):  # either may have taken the other way past its gimbal lock
            own = [body.coordinate_names[k] for k in trio]
            if set(own) <= set(names):
                columns = [names.index(name) for name in own]
                ours[:, columns] = nearest(ours[:, columns], theirs[:, columns])
    return agreements(names, metrics.angle_differences_deg(ours, theirs), np.degrees(theirs))


def _angle_rows(case: str, errors: Errors) -> list[Row]:
    rows = list[Row]()
    for what, values in (("", errors.raw), (", offset removed", errors.offset_removed)):
        if any(name in metrics.KHE_COORDINATES for name in errors.names):
            rows.append(row(case, f"KHE{what}", metrics.khe_deg(values, errors.names), "deg"))
        rows += _summary(case, "angles", np.abs(values), what, "deg")
    return rows


def _summary(case: str, noun: str, values: Float, what: str, unit: str) -> list[Row]:
    median, p95 = (metrics.percentile_known(values, percent) for percent in (50, 95))
    measures = (("mean", metrics.mean_known(values)), ("median", median), ("p95", p95))
    return [row(case, f"{noun}, {name}{what}", value, unit) for name, value in measures]


def _honesty_rows(case: str, own: Angles, errors: Errors) -> list[Row]:
    """How the angle errors compare with the standard deviations that the tracker claims."""
    columns = [own.names.index(name) for name in errors.names]
    z = metrics.z_scores(np.radians(errors.raw), own.covariances[:, columns][:, :, columns])
    z = z[np.isfinite(z)]
    if not z.size:
        return []
    return [
        row(case, "angle errors over claimed σ, rms (1 is honest)", float(np.sqrt(np.mean(z**2))), "σ"),
        row(case, "angle errors within 2σ (95 % is honest)", 100 * metrics.within_sigmas(z, 2.0), "%"),
    ]


def _against_masks(result: Result, folder: Path, case: str) -> Evaluation:
    overlaps = list(_overlaps(result, folder))
    if not overlaps:
        raise InputError(f"no mask in {folder} belongs to a frame of the result; name them CAM/frame_XXXX.png.")
    measures = dict[str, Any]()
    for camera in dict.fromkeys(overlap.camera for overlap in overlaps):
        measures[camera] = np.mean([overlap.iou for overlap in overlaps if overlap.camera == camera])
    values = [overlap.iou for overlap in overlaps]
    measures |= {"mean": np.mean(values), "least": np.min(values)}
    rows = [row(case, f"IoU, {name}", float(value), "") for name, value in measures.items()]
    compared = np.isin(result.indices, [overlap.frame for overlap in overlaps])
    return _counted(Evaluation(case, rows, overlaps=overlaps), result, compared)


def _overlaps(result: Result, folder: Path) -> Iterator[Overlap]:
    """IoU of every mask of the folder that belongs to a frame of the result."""
    frames = {int(index): k for k, index in enumerate(result.indices)}
    cameras = {camera.name: camera for camera in result.rig}
    subfolders = sorted(path for path in folder.iterdir() if path.is_dir())
    unknown = [path.name for path in subfolders if path.name not in cameras]
    if unknown or not subfolders:
        what = f"a folder {unknown[0]!r}" if unknown else "no folders"
        raise InputError(f"the masks in {folder} have {what}; name one folder per camera: {', '.join(cameras)}.")
    rectifiers = [Rectifier(camera) for camera in result.rig]
    for path in subfolders:
        camera, number = cameras[path.name], result.rig.names.index(path.name)
        for file in sorted(path.glob("*.png")):
            k = frames.get(_frame_number(file))
            if k is not None:
                rectify = rectifiers[int(np.argmax(result.sources[k] == number))]  # of the camera that took it
                mask = rectify(_read_mask(file, camera), nearest=True) > 127
                seen_by, vertices = rectify.camera, Posed(result.body, result.poses[k]).vertices
                seen = metrics.silhouette(seen_by.P, vertices, result.body.faces, seen_by.size)
                yield Overlap(camera.name, int(result.indices[k]), metrics.iou(seen, mask))


def _frame_number(file: Path) -> int:
    digits = re.findall(r"\d+", file.stem)
    if not digits:
        raise InputError(f"the mask {file} has no frame number in its name; name it frame_XXXX.png.")
    return int(digits[-1])


def _read_mask(file: Path, camera: Camera) -> AnyArray:
    """(H, W) uint8 mask of a camera's full size; a mask of the same shape in another size is scaled to it."""
    mask = read_image(file, "the mask", grey=True)
    height, width = mask.shape
    if (width, height) == camera.size:
        return mask
    if abs(width / height - camera.size[0] / camera.size[1]) > 0.01:
        sizes = f"{width}×{height} pixels, camera {camera.name!r} {camera.size[0]}×{camera.size[1]}"
        raise InputError(f"the mask {file} is {sizes}: masks must have the shape of the video.")
    return cv2.resize(mask, camera.size, interpolation=cv2.INTER_NEAREST)
