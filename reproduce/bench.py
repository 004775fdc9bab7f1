"""``python -m reproduce bench``: milliseconds per frame by stage, one thread, without rendering and decoding."""

from __future__ import annotations

import gc
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from reproduce.running import Table, Tell, one_thread_processes
from twistcap import stages
from twistcap.build import build
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.evaluate.metrics import Row, row
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Settings, Tracker

ID = "bench"
TOTAL = "total"
QUICK_FRAMES = 16
REPEATS = 3  # of each sequence: what else the machine does only ever adds, so the quickest is nearest to the truth
WARM = 3  # frames left out: compiling, the longer first frame, templates not yet all there

Times = dict[str, list[float]]
"""Milliseconds of every frame, by stage."""


@dataclass(frozen=True)
class Bench:
    """One timing.

    Attributes:
        id, says: name, and one line for the reader.
        studio: the scene; its seed is replaced.
        tracker: settings.
        at_most: median ms per frame to reach; None where there is no bar.
    """

    id: str
    says: str
    studio: StudioConfig
    tracker: Settings
    at_most: float | None = None


BENCHES = (
    Bench("stereo-direct", "two views 384x280, direct", StudioConfig(views=2), Settings(), 8.0),
    Bench("stereo-levelset", "two views, level sets", StudioConfig(views=2), Settings(method="levelset"), 25.0),
    Bench("4-views-direct", "four views, direct", StudioConfig(views=4), Settings()),
    Bench("4-views-levelset", "four views, level sets", StudioConfig(views=4), Settings(method="levelset")),
)


def run(case: str | None, seeds: Sequence[int], quick: bool, progress: Tell) -> Table:
    """Time every bench, one after the other, in a process of one thread.

    Args:
        case: id of one bench; None takes all.
        seeds: of the studio, not empty.
        quick: few frames.
        progress: is called each time a sequence is done.

    Returns:
        the table: the median over the frames of each stage, in the quickest of three repeats, as mean over the seeds.

    Raises:
        InputError: for a name that no bench has.
    """
    benches = selected(case)
    frames = QUICK_FRAMES if quick else None
    found: dict[str, list[Times]] = {bench.id: [] for bench in benches}
    jobs = [(bench, seed) for bench in benches for seed in seeds]
    with one_thread_processes(1) as pool:
        for done, (bench, seed) in enumerate(jobs, 1):
            found[bench.id].append(pool.submit(timed, bench, seed, frames).result())
            progress(f"{bench.id}, seed {seed}", done, len(jobs))
    return {"id": ID, "rows": [line for bench in benches for line in rows_of(bench, found[bench.id])]}


def selected(name: str | None) -> tuple[Bench, ...]:
    """The benches of a name.

    Raises:
        InputError: for a name that nothing has.
    """
    benches = tuple(b for b in BENCHES if name in (None, b.id))
    if not benches:
        raise InputError(f"there is no timing {name!r}; choose one of {', '.join(b.id for b in BENCHES)}.")
    return benches


def timed(bench: Bench, seed: int, frames: int | None = None) -> Times:
    """Milliseconds of every frame but the first few, in the quickest of a few repeats; decoding and rendering apart."""
    scene = capture(replace(bench.studio, seed=seed))
    pictures = [scene.frame(k) for k in range(frames or scene.config.frames)]
    repeats = [_once(bench, scene, pictures) for _ in range(REPEATS)]
    return min(repeats, key=lambda times: float(np.median(times[TOTAL])))


def _once(bench: Bench, scene: Capture, pictures: Sequence[Frame]) -> Times:
    tracker = Tracker(build(scene.body, scene.rig, bench.tracker))
    tracker.start(scene.first_pose)
    with _no_collection(), stages.record() as spent:
        totals = [_step(tracker, picture) for picture in pictures]
    by_stage = {stage: [1000.0 * seconds for seconds in values[WARM:]] for stage, values in spent.items()}
    return {TOTAL: totals[WARM:], **by_stage}


def rows_of(bench: Bench, times: Sequence[Mapping[str, Sequence[float]]]) -> list[Row]:
    """A line for the whole frame, then one for each stage."""
    names = {stage: None for by_seed in times for stage in by_seed}  # in the order they are met, the whole first
    rows: list[Row] = []
    for stage in names:
        medians = [float(np.median(by_seed.get(stage, [0.0]))) for by_seed in times]
        limit = bench.at_most if stage == TOTAL else None
        rows.append(row(bench.id, stage, float(np.mean(medians)), "ms", at_most=limit, seeds=medians))
    return rows


def _step(tracker: Tracker, picture: Frame) -> float:
    """Milliseconds of one frame."""
    began = perf_counter()
    tracker.step(picture)
    return 1000.0 * (perf_counter() - began)


@contextmanager
def _no_collection() -> Generator[None]:
    """A garbage collection would fall on some frames and not on others."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
