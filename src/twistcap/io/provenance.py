"""What a track was made of, in few words that stay in its result file: a resumed track is made of the same."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import AnyArray
from twistcap.body import Body
from twistcap.camera import Camera
from twistcap.errors import InputError
from twistcap.io.recording import body_of
from twistcap.io.result import PLANNED
from twistcap.io.session import Session
from twistcap.io.sources import ImageSource
from twistcap.io.video import Source, Views

_SHOWN = 3  # differences that a message tells
_DIGEST_BYTES = 16


def made_of(session: Session, views: Views) -> dict[str, Any]:
    """What decides how the frames of a session are tracked, beside the first pose, as flat JSON data by name.

    Files are known by their digests. Raises InputError for one that cannot be read.
    """
    tables = {"prior": session.prior, "motions": session.motions}
    made: dict[str, Any] = {
        "first frame": views.indices[0],
        "step": session.step,
        "rate": views.fps,
        "time_offset": session.time_offset,
        **flat("clocks", {name: clock.model_dump() for name, clock in session.clocks.items()}),
        "scale": session.scale,
        "body": _body_digest(body_of(session)),
        **{f"calibration of {camera.name}": _camera_digest(camera) for camera in views.rig},
        **{key: found for s, c in zip(views.sources, views.rig, strict=True) for key, found in _video(c.name, s)},
        **{name: None if table is None else _file_digest(table.path) for name, table in tables.items()},
        **flat("tracker", asdict(session.tracker_settings)),
        **flat("prior", {} if session.prior is None else session.prior.model_dump(mode="json", exclude={"path"})),
    }
    return json.loads(json.dumps(made))  # as it will be read again


def check_same(path: Path, before: Mapping[str, Any], now: Mapping[str, Any], videos_changed: bool = False) -> None:
    """Raises InputError, with names, where a result file is not made of what is there now.

    Args:
        path: of the file.
        before, now: `made_of`.
        videos_changed: the files of the videos may differ.
    """
    if not before:
        raise InputError(
            f"{path} was not tracked from a session; track anew with --overwrite, or choose another --out."
        )
    keys = [key for key in {**before, **now} if key != PLANNED and before.get(key) != now.get(key)]
    differing = [key for key in keys if not (videos_changed and key.startswith("video of "))]
    if differing:
        changes = ", ".join(_difference(key, before.get(key), now.get(key)) for key in differing[:_SHOWN])
        more = f" and {len(differing) - _SHOWN} more" if len(differing) > _SHOWN else ""
        mend = "resume with what it was begun with, or track anew with --overwrite"
        if all(key.startswith("video of ") for key in differing):
            mend = "if the videos show the same, add --videos-changed, else track anew with --overwrite"
        raise InputError(f"{path} was tracked otherwise ({changes}{more}); {mend}.")


def _difference(key: str, before: Any, now: Any) -> str:
    if (isinstance(before, str) and len(before) == 2 * _DIGEST_BYTES) or key.endswith("time of change"):
        return f"{key} differs"
    return f"{key} was {before}, is {now}"


def _video(name: str, source: Source) -> Iterable[tuple[str, Any]]:
    """Size, time and first picture of a camera's recording."""
    files = source.files if isinstance(source, ImageSource) else [source.name]
    try:
        found = [os.stat(file) for file in files]
    except OSError as error:
        raise InputError(
            f"video {source.name} cannot be read ({error.strerror}); check its path in [videos]."
        ) from error
    first = next(image for image in source.read(range(len(source))) if image is not None)
    yield f"video of {name}, bytes", sum(one.st_size for one in found)
    changed = max(one.st_mtime_ns for one in found) // 1000  # µs: JSON holds them exactly
    yield f"video of {name}, time of change", changed
    yield f"video of {name}, first picture", _digest(first)


def _digest(*arrays: AnyArray) -> str:
    found = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for array in arrays:
        found.update(repr((array.shape, array.dtype.str)).encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def _camera_digest(camera: Camera) -> str:
    lens = (camera.dist, np.ones(1)) if camera.fisheye else (camera.dist,)
    return _digest(camera.K, camera.T_cam_world, np.array(camera.size), *lens)


def _body_digest(body: Body) -> str:
    values = [getattr(body, field.name) for field in fields(body) if field.name not in ("name", "landmarks")]
    return _digest(*(np.asarray(v) for v in values), np.array(body.landmarks.names), body.landmarks.points)


def _file_digest(path: str) -> str:
    try:
        return _digest(np.frombuffer(Path(path).read_bytes(), np.uint8))
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check its path.") from error


def flat(name: str, value: Any) -> dict[str, Any]:
    """Numbers and words by dotted key, as a command line names them, below a name."""
    if isinstance(value, Mapping):
        return {key: found for k, v in value.items() for key, found in flat(f"{name}.{k}".lstrip("."), v).items()}
    return {name: value}
