"""Accuracy and time of the optic flow, beside OpenCV's DIS (medium) in the same run.

    python benchmarks/flow.py [--json] [--studio-only] [--picture flow.png]

Middlebury: grey, average endpoint error over all known pixels. Studio: crops of 150 by 250 px of 8 people, error
within the body's mask, of all its pixels and of those that move by more than 10 px. One thread; times there are the
best of five, ours and DIS in turns.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from flow_scenes import FlowPair, flow_pair

from reproduce.arrays import Bool, Float32, UInt8
from twistcap.flow import BROX_2004, optical_flow

DATA = Path(os.environ.get("TWISTCAP_DATA", Path(__file__).parents[1] / ".." / "shared" / "data")) / "flow_middlebury"
BARS = {"Dimetrodon": 0.14, "Grove2": 0.17, "RubberWhale": 0.11, "Venus": 0.29}
LIMB = 10.0  # px per frame
Flow = Callable[[UInt8, UInt8, Bool | None], Float32]
Row = dict[str, str | float]


def dis(first: UInt8, second: UInt8, mask: Bool | None) -> Float32:
    """OpenCV's dense inverse search; it knows no mask."""
    return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(first, second, None)


def ours(first: UInt8, second: UInt8, mask: Bool | None, **kwargs: object) -> Float32:
    """`optical_flow`, its mask by position."""
    return optical_flow(first, second, mask=mask, **kwargs)  # pyright: ignore[reportArgumentType]


METHODS: dict[str, Flow] = {
    "accurate": partial(ours, preset="accurate"), "fast": partial(ours, preset="fast"),
    "2004": partial(ours, settings=BROX_2004), "DIS": dis,
}  # fmt: skip


def middlebury() -> list[Row]:
    """Endpoint error and seconds on each pair."""
    rows: list[Row] = []
    for name, bar in BARS.items():
        first, second = (cv2.imread(str(DATA / name / f"frame1{k}.png"), cv2.IMREAD_GRAYSCALE) for k in (0, 1))
        width, height = np.fromfile(DATA / name / "flow10.flo", np.int32, 3)[1:]
        truth = np.fromfile(DATA / name / "flow10.flo", np.float32, offset=12).reshape(height, width, 2)
        known = np.abs(truth).max(axis=-1) < 1e9
        for method in METHODS:
            start = time.perf_counter()
            flow = METHODS[method](first, second, None)
            seconds = time.perf_counter() - start
            error = float(np.linalg.norm(flow - truth, axis=-1)[known].mean())
            rows.append({"scene": name, "method": method, "error_px": error, "ms": 1e3 * seconds, "bar_px": bar})
    return rows


def studio(pairs: dict[str, list[FlowPair]]) -> list[Row]:
    """Endpoint errors and milliseconds, the mean over the seeds."""
    rows: list[Row] = []
    for scene, of_seed in pairs.items():
        for method in ("accurate", "fast", "DIS"):
            errors = [errors_of(METHODS[method](p.first, p.second, p.mask), p) for p in of_seed]
            whole, limbs = np.nanmean(errors, axis=0)
            rows.append({"scene": scene, "method": method, "error_px": float(whole), "limbs_px": float(limbs)})
        for method, ms in zip(("fast", "DIS"), np.mean([times_of(p) for p in of_seed], axis=0), strict=True):
            next(r for r in rows if (r["scene"], r["method"]) == (scene, method))["ms"] = float(ms)
    return rows


def errors_of(flow: Float32, pair: FlowPair) -> tuple[float, float]:
    """Mean endpoint error within the mask, and where the truth is longer than `LIMB`; NaN where nothing is."""
    error, length = np.linalg.norm(flow - pair.flow, axis=-1), np.linalg.norm(pair.flow, axis=-1)
    limbs = pair.mask & (length > LIMB)
    return float(error[pair.mask].mean()), float(error[limbs].mean()) if limbs.any() else float("nan")


def times_of(pair: FlowPair, repeats: int = 5) -> tuple[float, float]:
    """Milliseconds of `fast` and of DIS, in turns."""
    best = [np.inf, np.inf]
    for _ in range(repeats):
        for k, method in enumerate(("fast", "DIS")):
            start = time.perf_counter()
            METHODS[method](pair.first, pair.second, pair.mask)
            best[k] = min(best[k], 1e3 * (time.perf_counter() - start))
    return best[0], best[1]


def wheel(flow: Float32, largest: float) -> UInt8:
    """(H, W, 3) RGB: direction as hue, length as saturation, white where nothing is known."""
    angle = np.rad2deg(np.arctan2(flow[..., 1], flow[..., 0])) % 360
    length = np.minimum(np.linalg.norm(flow, axis=-1) / largest, 1.0)
    hsv = np.stack([np.nan_to_num(angle), np.nan_to_num(length), np.ones_like(length)], axis=-1).astype(np.float32)
    return np.rint(255 * cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)).astype(np.uint8)


def picture(pairs: list[FlowPair], path: Path) -> None:
    """Both images, the truth, and three flows of each pair side by side."""
    rows: list[UInt8] = []
    for p in pairs:
        flows = [p.flow, *(METHODS[m](p.first, p.second, p.mask) for m in ("accurate", "fast", "DIS"))]
        shown = [wheel(np.where(p.mask[..., None], f, np.nan), 25.0) for f in flows]
        rows.append(np.hstack([*(np.repeat(i[..., None], 3, axis=2) for i in (p.first, p.second)), *shown]))
    size, top = 25, 24
    y, x = np.mgrid[-size : size + 1, -size : size + 1] / size
    disc = np.where((np.hypot(x, y) <= 1)[..., None], np.stack([x, y], axis=-1), np.nan).astype(np.float32)
    rows[1][: 2 * size + 1, -2 * size - 1 :] = wheel(disc, 1.0)  # a corner without a body
    strip = np.full((top, rows[0].shape[1], 3), 255, np.uint8)
    for k, word in enumerate(("first", "second", "truth", "accurate", "fast", "OpenCV DIS")):
        cv2.putText(strip, word, (150 * k + 8, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1)
    cv2.imwrite(str(path), np.vstack([strip, *rows])[..., ::-1])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--studio-only", action="store_true", help="without Middlebury")
    parser.add_argument("--picture", type=Path, help="write flows of two pairs as a colour wheel")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    pairs = {"walk": [flow_pair(s, False) for s in range(8)], "thrown limbs": [flow_pair(s, True) for s in range(8)]}
    for method in METHODS.values():  # compiled before any clock runs
        method(pairs["walk"][0].first, pairs["walk"][0].second, pairs["walk"][0].mask)
        method(pairs["walk"][0].first, pairs["walk"][0].second, None)
    rows = studio(pairs)
    if not chosen.studio_only and DATA.is_dir():
        rows += middlebury()
    elif not chosen.studio_only:
        print(f"no Middlebury pairs at {DATA}; set TWISTCAP_DATA to the folder that holds flow_middlebury")
    if chosen.picture:
        picture([pairs["walk"][4], pairs["thrown limbs"][0], pairs["thrown limbs"][4]], chosen.picture)
    print(json.dumps(rows, indent=1) if chosen.json else table(rows))


def table(rows: list[Row]) -> str:
    """One line per row; a dash where a number is not measured."""
    columns = ("scene", "method", "error_px", "limbs_px", "ms", "bar_px")
    lines = ["".join(c.ljust(14) for c in columns)]
    for row in rows:
        cells = [row.get(c, "-") for c in columns]
        lines.append("".join((f"{c:.3f}" if isinstance(c, float) else c).ljust(14) for c in cells))
    return "\n".join(lines)


if __name__ == "__main__":
    main()
