"""Points and segments of a C3D as plain arrays. Run as a script, it is the child process in which strangers' files are
read, as `_hdf5_dump` is for HDF5: ezc3d is C++.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from twistcap.doors._hdf5_dump import main

_MOST = 1 << 26  # numbers in all


def dumped(path: str) -> dict[str, Any]:
    """`points` (N, P, 3) in the file's unit, NaN in gaps, their `labels` (P), `rate`, `first`, `unit`; `start` (s) of a
    file of ours; and `matrices` (N, R, 4, 4) with `segments` (R), where the file has as many of them as frames. Raises
    ValueError, in words for the user, where ezc3d is not installed or the file holds too much; and whatever ezc3d
    raises for damage.
    """
    try:
        import ezc3d
    except ImportError as error:
        raise ValueError("C3D needs ezc3d; install it with: pip install 'twistcap[c3d]'") from error
    file: Any = ezc3d.c3d(path)
    head, about, data = file["header"]["points"], file["parameters"], file["data"]
    points, matrices = np.asarray(data["points"]), np.asarray(data["rotations"])
    if points.size + matrices.size > _MOST:
        raise ValueError("it holds more numbers than a recording")
    out = {
        "points": points[:3].transpose(2, 1, 0), "labels": _words(about["POINT"], "LABELS", points.shape[1]),
        "rate": np.float64(head["frame_rate"]), "first": np.int64(head["first_frame"]),
        "unit": np.array("".join(about["POINT"]["UNITS"]["value"][:1]) or "mm"),
    }  # fmt: skip
    if "START" in about.get("TWISTCAP", {}):
        out["start"] = np.float64(about["TWISTCAP"]["START"]["value"][0])
    if matrices.ndim == 4 and matrices.shape[3] == points.shape[2] and matrices.shape[2]:
        names = _words(about["ROTATION"], "LABELS", matrices.shape[2])
        out |= {"matrices": matrices.transpose(3, 2, 0, 1), "segments": names}
    return out


def _words(group: Any, name: str, count: int) -> Any:
    """Labels of all, which the format has in lists of 255 at most: LABELS, LABELS2, …"""
    lists = [group[key]["value"] for key in (name, *(f"{name}{n}" for n in range(2, 20))) if key in group]
    words = [str(word).strip() for part in lists for word in part]
    if len(words) < count:
        raise ValueError(f"it has {count} signals, but {len(words)} labels")
    return np.array(words[:count], dtype=np.str_).reshape(count)


if __name__ == "__main__":
    sys.exit(main(dumped))
