"""flow: accuracy and time of the optic flow, beside OpenCV's DIS (medium) in the same run.

Middlebury: grey, average endpoint error over all known pixels, where TWISTCAP_DATA has the pairs. Studio: crops of 150
by 250 px, error within the body's mask, of all its pixels and of those that move by more than 10 px. In "walk" people
walk at three times real speed; in "thrown limbs" an arm and a leg swing so that their fastest point moves 30 px. Points
that the second image hides count too. One thread; times there are the best of five, ours and DIS in turns.

    python -m reproduce flow --out out/flow
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from reproduce.arms import Findings
from reproduce.running import Tell
from reproduce.scenes.flow_pairs import FlowPair, flow_pair
from twistcap.arrays import Bool, Float32, UInt8
from twistcap.errors import InputError
from twistcap.evaluate import Row, row
from twistcap.flow import BROX_2004, optical_flow

MIDDLEBURY = {"Dimetrodon": 0.14, "Grove2": 0.17, "RubberWhale": 0.11, "Venus": 0.29}  # px that are allowed
LIMB = 10.0  # px per frame
Flow = Callable[[UInt8, UInt8, Bool | None], Float32]
Pairs = Mapping[str, Sequence[FlowPair]]
"""One pair of images for each seed, by scene."""


@dataclass(frozen=True)
class OpticFlow:
    """The experiment; see `Experiment`."""

    id: str = "flow"
    says: str = "endpoint error and time of the optic flow beside OpenCV's DIS: people of the studio, and Middlebury"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Rows; the picture shows the flows of the first and last seed as a colour wheel."""
        cv2.setNumThreads(1)
        pairs = {name: [flow_pair(s, fast) for s in seeds] for name, fast in (("walk", False), ("thrown limbs", True))}
        progress("pairs", 1, 3)
        first = pairs["walk"][0]
        for method in METHODS.values():  # compiled before any clock runs
            method(first.first, first.second, first.mask)
            method(first.first, first.second, None)
        rows = studio_rows(pairs)
        progress("studio", 2, 3)
        folder = os.environ.get("TWISTCAP_DATA")
        if folder is not None and (Path(folder) / "flow_middlebury").is_dir():
            rows += middlebury_rows(Path(folder) / "flow_middlebury")
        if out is not None:
            picture([pairs["walk"][-1], pairs["thrown limbs"][0], pairs["thrown limbs"][-1]], out / "flow.png")
        return Findings(rows, "", ())


def dis(first: UInt8, second: UInt8, mask: Bool | None) -> Float32:
    """OpenCV's dense inverse search; it knows no mask."""
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = np.zeros((*first.shape, 2), np.float32)
    return np.asarray(method.calc(first, second, flow), np.float32)


def ours(first: UInt8, second: UInt8, mask: Bool | None, **kwargs: object) -> Float32:
    """`optical_flow`, its mask by position."""
    return optical_flow(first, second, mask=mask, **kwargs)  # pyright: ignore[reportArgumentType]


METHODS: dict[str, Flow] = {
    "accurate": partial(ours, preset="accurate"), "fast": partial(ours, preset="fast"),
    "2004": partial(ours, settings=BROX_2004), "DIS": dis,
}  # fmt: skip


def middlebury_rows(folder: Path) -> list[Row]:
    """Endpoint error and milliseconds on each pair."""
    rows: list[Row] = []
    for name, bar in MIDDLEBURY.items():
        first, second = (_grey(folder / name / f"frame1{k}.png") for k in (0, 1))
        width, height = np.fromfile(folder / name / "flow10.flo", np.int32, 3)[1:]
        truth = np.fromfile(folder / name / "flow10.flo", np.float32, offset=12).reshape(height, width, 2)
        known = np.abs(truth).max(axis=-1) < 1e9
        for method, flow_of in METHODS.items():
            start = time.perf_counter()
            flow = flow_of(first, second, None)
            ms = 1e3 * (time.perf_counter() - start)
            error = float(np.linalg.norm(flow - truth, axis=-1)[known].mean())
            limit = bar if method == "accurate" else None
            rows += [
                row(f"{name} {method}", "endpoint error", error, "px", at_most=limit),
                row(f"{name} {method}", "time", ms, "ms"),
            ]
    return rows


def _grey(path: Path) -> UInt8:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(f"{path} cannot be read as a picture; mend the folder that TWISTCAP_DATA names.")
    return np.asarray(image, np.uint8)


def studio_rows(pairs: Pairs) -> list[Row]:
    """Endpoint errors, and milliseconds of two methods, the mean over the seeds."""
    rows: list[Row] = []
    for scene, of_seed in pairs.items():
        for method in ("accurate", "fast", "DIS"):
            whole, limbs = np.array([errors_of(METHODS[method](p.first, p.second, p.mask), p) for p in of_seed]).T
            for name, values in (("endpoint error", whole), ("endpoint error, limbs", limbs)):
                mean = float(np.nanmean(values)) if np.isfinite(values).any() else np.nan
                rows.append(row(f"{scene} {method}", name, mean, "px", seeds=values.tolist()))
        times = np.array([times_of(p) for p in of_seed]).T
        for method, ms in zip(("fast", "DIS"), times, strict=True):
            rows.append(row(f"{scene} {method}", "time", float(ms.mean()), "ms", seeds=ms.tolist()))
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


def picture(pairs: Sequence[FlowPair], path: Path) -> None:
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


FLOW = OpticFlow()
