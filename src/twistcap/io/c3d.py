"""C3D files, written by ezc3d: points with residuals, and segments as the ROTATION group of Visual3D and Theia3D.

Points are the body's landmarks and surface markers. The residual of a point is the standard deviation of its place (the
root of the trace of its covariance), in mm; it is −1 where the point is not there. ezc3d 1.7 swaps the bytes of
residual and cameras (its issue 386), so that we write that word ourselves, as c3d.org says.

A segment's 4×4 matrix leads from its axes to the laboratory: x right, y forward, z along the bone towards the trunk, as
Visual3D has them, with the origin in the upper joint. It is NaN where the segment is not there. Labels are Theia3D's.
There are no analog data.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import UNEVEN, Float, Int, even_clock, runs
from twistcap.body import Landmarks, Posed
from twistcap.body.anatomy import bones_of
from twistcap.body.surface_markers import surface_markers
from twistcap.errors import InputError
from twistcap.io.files import replacing
from twistcap.io.markers import TO_FILE, WorldAxes
from twistcap.io.result import Result

_MOST_FRAMES, _MOST_BLOCKS = 65_535, 32_767
_BLOCK, _HEAD_BLOCKS = 512, 32  # bytes; blocks before the points, at most
_MM = 1000.0
_TO_VISUAL3D = [2, 0, 1]  # of the columns x forward, y up, z right
_LABELS = {"pelvis": "pelvis", "thorax": "torso", "head": "head", "humerus": "uarm", "forearm": "larm", "hand": "hand",
           "femur": "thigh", "tibia": "shank", "foot": "foot"}  # fmt: skip
_MOST_ENTRIES = 254  # of a parameter
_SPAN_BYTES = 9  # of a span without the body: two numbers, and its part of the parameter's name
_WORST = 25.0  # mm; residuals above it all count alike


def write_c3d(path: Path | str, result: Result, axes: WorldAxes = "opensim", fill: bool = False) -> None:
    """Writes a result, in mm; frames that the recording dropped, and without `fill` those lost or unseen, are gaps.

    TWISTCAP:LOST holds first and last frame of each span that is lost, unseen or dropped, counted as in the file,
    from 1 for the recording's frame 0. It goes on in LOST2, LOST3 …, since a parameter has room for 127 spans.
    TWISTCAP:START is the time of the first frame, s. Raises InputError where ezc3d is not installed, for frames that
    are not evenly spaced or too many, or if the file cannot be written.
    """
    try:
        import ezc3d
    except ImportError as error:
        raise InputError("C3D needs ezc3d; install it with: pip install 'twistcap[c3d]'.") from error
    path, body = Path(path), result.body
    rate, slots = _clock(path, result.times)
    marks = body.landmarks.and_those(surface_markers(body))
    first, frames = int(slots[0]), int(slots[-1] - slots[0]) + 1
    gaps = runs(~np.isin(np.arange(frames), slots[result.known] - first))
    _expect_room(path, frames, len(marks.names), len(gaps))
    held = np.flatnonzero(fill | result.known).astype(np.int32)
    places, deviations = _placed(result, marks, held, TO_FILE[axes])
    labels, matrices = _segments(result, held, TO_FILE[axes])
    words, scale = _residual_words(places, deviations)
    file: Any = ezc3d.c3d()
    numbered = first if 0 <= first <= _MOST_FRAMES - frames else 0
    file.header["points"]["first_frame"] = numbered
    shown = slots[held] - first
    file["data"]["points"] = _spread(places, shown, frames, np.nan)
    file["data"]["rotations"] = _spread(matrices, shown, frames, np.nan)
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"], point["SCALE"]["value"] = [rate], ["mm"], [-scale]
    point["LABELS"]["value"] = list(marks.names)
    rotation = {"LABELS": labels, "RATE": [rate]}
    ours = {"START": [float(result.times[0])], "AXES": [axes], **_spans(gaps, numbered + 1)}
    for group, parameters in {"ROTATION": rotation, "TWISTCAP": ours}.items():
        for name, value in parameters.items():
            file.add_parameter(group, name, value)
    with replacing(path) as part:
        file.write(str(part))
        _put_residuals(part, _spread(words, shown, frames, -1.0), scale)


def _clock(path: Path, times: Float) -> tuple[float, Int]:
    """Frames per second, and the number of each frame (N,) on an even clock that starts with the recording."""
    rate, slots, off = even_clock(times) if len(times) > 1 else (60.0, np.zeros(1, np.int32), 0.0)
    rate = round(rate, 3)  # 59.94 and 60 stay apart; what a clock of microseconds adds does not
    first = round(float(times[0]) * rate)
    if off > UNEVEN or np.any(np.diff(slots) < 1):
        raise InputError(f"{path}: the frames are not evenly spaced in time, as C3D wants them; export csv, or trc.")
    return rate, slots + first


def room(points: int, spans: int = 0) -> int:
    """Frames that a C3D of so many points, of segments and of spans without the body holds. The format counts frames in
    16 bits, and so the blocks before the matrices, which ezc3d reads with a sign; what is beyond would be lost without
    a word."""
    head = _HEAD_BLOCKS + -(-_SPAN_BYTES * spans // _BLOCK)
    return min(_MOST_FRAMES, (_MOST_BLOCKS - head) * _BLOCK // (16 * points))


def _expect_room(path: Path, frames: int, points: int, spans: int) -> None:
    if frames > (most := room(points, spans)):
        held = f"a C3D of {points} points has room for {most} frames, the result has {frames}"
        raise InputError(f"{path}: {held}; export it in parts, each with --frames FIRST:LAST and --out.")


def _placed(result: Result, marks: Landmarks, held: Int, to_file: Float) -> tuple[Float, Float]:
    """Places (4, P, T; the last is 1) and standard deviations (P, T) of the points in the frames `held` (T,), mm."""
    places, deviations = np.zeros((len(held), len(marks.names), 3)), np.zeros((len(held), len(marks.names)))
    segments, whole = marks.segments[:, None], np.ones((len(marks.names), 1))
    for t, n in enumerate(held):
        posed = Posed(result.body, result.poses[n])
        J = posed.point_jacobian(segments, whole, marks.points)
        places[t] = posed.points(segments, whole, marks.points) @ to_file.T
        deviations[t] = np.sqrt(np.maximum(np.einsum("pij,jk,pik->p", J, result.covariances[n], J, optimize=True), 0.0))
    return np.concatenate([_MM * places.transpose(2, 1, 0), np.ones((1, *deviations.T.shape))]), _MM * deviations.T


def _segments(result: Result, held: Int, to_file: Float) -> tuple[list[str], Float]:
    """Labels of R segments, and their matrices (4, 4, R, T) in the frames `held` (T,), mm."""
    bones = bones_of(result.body)
    labels = ["worldbody_4X4", *map(_label, bones)]
    out = np.tile(np.eye(4)[:, :, None, None], (1, 1, len(labels), len(held)))
    for t, n in enumerate(held):
        motions = Posed(result.body, result.poses[n]).segment_transforms
        for r, bone in enumerate(bones.values(), start=1):
            frame = motions[bone.segment] @ bone.frame
            out[:3, :3, r, t] = (to_file @ frame[:3, :3])[:, _TO_VISUAL3D]
            out[:3, 3, r, t] = _MM * to_file @ frame[:3, 3]
    return labels, out


def _label(bone: str) -> str:
    name, _, side = bone.partition("_")
    return f"{side}_{_LABELS[name]}_4X4" if side else f"{_LABELS[name]}_4X4"


def _spread(values: Float, shown: Int, frames: int, empty: float) -> Float:
    """Values (..., T) in the frames `shown` (T,) of (..., frames); all others are `empty`."""
    out = np.full((*values.shape[:-1], frames), empty)
    out[..., shown] = values
    return out


def _residual_words(places: Float, deviations: Float) -> tuple[Float, float]:
    """Residuals (P, T) in steps of POINT:SCALE, 1 to 255, and that scale, mm: also that of whole-number coordinates."""
    widest = float(np.abs(places).max(initial=1.0))
    scale = max(widest / 32000, min(float(deviations.max(initial=0.0)), _WORST) / 255)
    return np.clip(np.ceil(deviations / scale), 1, 255), scale


def _put_residuals(path: Path, words: Float, scale: float) -> None:
    """The fourth word of every point (P, frames), and the scale in the header, of a file of float32."""
    with path.open("r+b") as file:
        header = np.frombuffer(file.read(_BLOCK), "<u2")
        start = (int(header[8]) - 1) * _BLOCK
        file.seek(12)
        file.write(np.array([-scale], "<f4").tobytes())
    points = np.memmap(path, "<f4", "r+", offset=start, shape=(words.shape[1], len(words), 4))
    points[..., 3] = words.T
    points.flush()


def _spans(gaps: Sequence[tuple[int, int]], first: int) -> dict[str, list[float]]:
    """First and last of each gap, numbered from `first` on, one after the other, by parameter: LOST, LOST2 …"""
    ends = [float(first + end) for start, stop in gaps for end in (start, stop - 1)]
    parts = [ends[k : k + _MOST_ENTRIES] for k in range(0, len(ends), _MOST_ENTRIES)] or [[]]
    return {f"LOST{k}" if k > 1 else "LOST": part for k, part in enumerate(parts, start=1)}
