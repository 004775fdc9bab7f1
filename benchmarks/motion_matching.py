"""Time and memory of motion matching on one thread: 16 scales, m = 5, 20 angles.

    python benchmarks/motion_matching.py [--json] [--calls 40]

Three kinds of libraries. "walks": gait-like motion, 20 phase-locked joints of many people whose cadence and style
wander, 60 poses a second; the query is another person's. "wander": 20 joints that wander smoothly and independently,
where no stretch resembles another. "noise": every pose independent, where bounds exclude little: no motion, the worst
case. Times are medians over queries of different places; each must find what trying all places finds (checked on the
smallest library of each kind here, and over random motion in tests/motion/test_motion_matching.py).
"""

from __future__ import annotations

import argparse
import json
import time
import tracemalloc
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from twistcap.motion import PAPER_SCALES, Matcher, MotionLibrary

Float = NDArray[np.float64]
JOINTS, POSES = 20, 5
BARS = {260: (0.1, None), 10_000: (None, None), 100_000: (8.0, None), 1_000_000: (80.0, 500.0)}  # ms, MB
Make = Callable[[np.random.Generator, int], Float]


def walks(rng: np.random.Generator, count: int) -> Float:
    """Gait-like: joints are harmonics of one phase; speed, amplitude and offset are the person's and wander."""
    style = np.random.default_rng(0)
    amplitude = style.uniform(0.1, 0.5, (2, JOINTS)) * [[1.0], [0.4]] * rng.uniform(0.8, 1.2, (2, JOINTS))
    shift = style.uniform(0, 2 * np.pi, (2, JOINTS)) + rng.normal(0, 0.15, (2, JOINTS))
    cadence = 2 * np.pi / 66 * rng.uniform(0.8, 1.2) * (1 + 0.05 * _wandering(rng, count, 1)[:, 0])
    phase = np.cumsum(cadence)[:, None] + rng.uniform(0, 6)
    swing = sum(amplitude[k] * np.sin((k + 1) * phase + shift[k]) for k in range(2))
    return np.asarray(swing + rng.normal(0, 0.05, JOINTS) + 0.05 * _wandering(rng, count, JOINTS))


def wander(rng: np.random.Generator, count: int) -> Float:
    """Joints that wander smoothly by about 0.4 rad, at up to a few rad a second."""
    return 0.4 * _wandering(rng, count, JOINTS)


def noise(rng: np.random.Generator, count: int) -> Float:
    """Poses without any order."""
    return rng.normal(0, 0.4, (count, JOINTS))


def _wandering(rng: np.random.Generator, count: int, joints: int) -> Float:
    t = np.arange(count)[:, None]
    out = np.zeros((count, joints))
    for _ in range(6):
        out += np.sin(t * rng.uniform(0.004, 0.1, joints) + rng.uniform(0, 6, joints)) / np.sqrt(3)
    return out


def measured(make: Make, size: int, calls: int) -> dict[str, float | str]:
    """Milliseconds of single matches (median and worst), and megabytes that library and matcher hold."""
    rng = np.random.default_rng(size)
    tracemalloc.start()
    motions = _library(make, rng, size)
    matcher = Matcher(motions)
    held = tracemalloc.get_traced_memory()[0] / 1e6
    tracemalloc.stop()
    tracked = make(rng, 50 + 7 * calls)
    queries = [tracked[k : k + POSES] for k in range(40, 40 + 7 * calls, 7)]
    matcher.best(queries[0])
    times = [_ms(lambda query=query: matcher.best(query)) for query in queries]
    out: dict[str, float | str] = {"kind": make.__name__, "poses": size, "median_ms": float(np.median(times))}
    out |= {"p90_ms": float(np.percentile(times, 90)), "worst_ms": max(times), "mb": held}
    if size == min(BARS):
        out["brute_ms"] = _checked(matcher, queries[: calls // 4])
    return out


def _library(make: Make, rng: np.random.Generator, size: int) -> MotionLibrary:
    """Clips of 1000 poses at most; roots stand still."""
    sizes = [min(1000, size - start) for start in range(0, size, 1000)]
    q = np.empty((size, JOINTS), np.float32)
    for k, n in enumerate(sizes):
        q[1000 * k : 1000 * k + n] = make(rng, n)
    starts = np.cumsum([0, *sizes]).astype(np.int32)
    roots = np.tile(np.eye(4), (size, 1, 1))
    names = tuple(f"joint_{k}" for k in range(JOINTS))
    return MotionLibrary(names, 60.0, tuple(f"clip {k}" for k in range(len(sizes))), starts, q, roots)


def _ms(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - start)


def _checked(matcher: Matcher, queries: list[Float]) -> float:
    """Median ms of numpy trying all places; raises where the answers differ."""
    times: list[float] = []
    for query in queries:
        start = time.perf_counter()
        best = (np.inf, 0.0, 0.0)
        for s in PAPER_SCALES:
            count = int((len(matcher.library) - 1) * s + 1e-6) + 1
            poses = matcher.library.angles(0, np.arange(count) / s)
            windows = np.lib.stride_tricks.sliding_window_view(poses, POSES, axis=0)
            sums = np.linalg.norm(windows - query.T, axis=1).sum(axis=1)
            ends = (np.arange(POSES - 1, count) + 1) / s <= len(matcher.library) - 1 + 1e-6
            k = int(np.argmin(np.where(ends, sums, np.inf)))
            best = min(best, (float(sums[k]), s, (k + POSES - 1) / s))
        times.append(time.perf_counter() - start)
        found = matcher.best(query)
        assert found is not None and abs(found.distance - best[0]) < 1e-5, (found, best)
        assert np.allclose((found.scale, found.position), best[1:]), (found, best)
    return 1e3 * float(np.median(times))


def main() -> None:
    """Print one row per kind and size."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--calls", type=int, default=40)
    given = parser.parse_args()
    rows = [measured(make, size, given.calls) for make in (walks, wander, noise) for size in BARS]
    if given.json:
        print(json.dumps(rows, indent=1))
        return
    for row in rows:
        bar = BARS[int(row["poses"])]
        cells = [f"{key} {row[key]:.3f}" for key in ("median_ms", "p90_ms", "worst_ms", "mb")]
        cells += [f"bar {bar[0]} ms, {bar[1]} MB"] + ([f"numpy {row['brute_ms']:.1f} ms"] if "brute_ms" in row else [])
        print(f"{row['kind']:>7} {row['poses']:>8}  " + "  ".join(cells), flush=True)


if __name__ == "__main__":
    main()
