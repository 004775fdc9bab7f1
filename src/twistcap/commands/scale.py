"""``twistcap refine --stature``: a calibration scaled so that the tracked person is as tall as measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twistcap.commands import terminal
from twistcap.errors import InputError

_FITTED = 1e-4  # share by which a stature differs that was fitted
_SAME = 1e-4  # share by which distances of cameras may differ in one calibration


def scaled_cameras(path: Path, out: Path, session: Any, stature: float) -> dict[str, Any]:
    """Write the session's calibration into a folder, scaled so that the body of a result is `stature` m tall; what
    ``--json`` prints.

    Raises InputError where the result's body was not fitted to images, or it was tracked with another calibration.
    """
    from twistcap.io.calibration import knows_floor, read_rig, write_rig
    from twistcap.io.cameras.units import scaled
    from twistcap.io.recording import body_of
    from twistcap.io.result import read_result
    from twistcap.io.start_report import rest_height

    result, source = read_result(path), Path(session.cameras.calibration)
    fitted, own = rest_height(result.body), rest_height(body_of(session))
    if abs(fitted / own - 1.0) < _FITTED:
        mend = "twistcap refine it without --stature, and give refined.h5"
        raise InputError(f"{path}: its body has the height of [body], {own:.2f} m, as images did not fit it; {mend}.")
    rig = read_rig(source, session.cameras.unit, floor=None)
    _check_same(rig, result.rig, source, path)
    goal = terminal.new_calibration(out, source)
    factor = stature / fitted
    write_rig(scaled(rig, factor), goal, session.cameras.unit or "m", knows_floor(source))
    return {
        "id": "refine-stature", "result": path, "fitted_m": fitted, "stature_m": stature, "factor": factor,
        "calibration": goal, "to_set": _to_set(session, factor, stature),
    }  # fmt: skip


def _check_same(given: Any, tracked: Any, source: Path, path: Path) -> None:
    """See that a calibration has the cameras of a result, as far apart."""
    import numpy as np

    from twistcap.camera import Rig
    from twistcap.io.plausible import camera_distances

    held = {camera.name: camera for camera in given}
    here = Rig(tuple(held[name] for name in tracked.names if name in held))
    mine, theirs = camera_distances(here), camera_distances(tracked)
    if len(mine) != len(theirs) or not np.allclose(mine, theirs, rtol=_SAME):
        raise InputError(f"{path} was not tracked with calibration {source} as it is now; track again, then scale.")


def _to_set(session: Any, factor: float, stature: float) -> list[str]:
    """What else of the session no longer holds."""
    floor = session.cameras.floor
    out = [f"[cameras] floor = {factor * floor:.4g}"] if floor else []
    other = session.body.kind == "humanoid" and session.body.stature != stature
    return [*out, f"[body] stature = {stature:g}"] if other else out


def show(document: dict[str, Any]) -> None:
    """Print the end of a run for a person."""
    fitted, stature, factor = (document[key] for key in ("fitted_m", "stature_m", "factor"))
    fact = f"By the images the person is {fitted:.3f} m tall, as measured {stature:.3f} m"
    terminal.say(f"{fact}: the new calibration has all lengths times {factor:.4f}. Its origin stays.")
    if document["to_set"]:
        terminal.say(f"Set {' and '.join(document['to_set'])} in the session.")
    terminal.say(f"Track again with [cameras] calibration = {str(document['calibration'])!r}.")
