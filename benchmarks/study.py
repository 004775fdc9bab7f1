"""`twistcap study`: nothing is lost or doubled when a worker is killed, what it costs, and how the cost grows.

kill      24 studio trials on 2 workers; a random worker is killed in a random trial, twice, here and on a Dask
          LocalCluster. All tables must equal those of the run without a kill, byte for byte.
overhead  the same trials, tracked by `run_session` alone in two processes, and by a study; wall and CPU time.
growth    bytes and scheduler time of one trial, measured on a real Dask scheduler with no-op trials; and a
          simulation of up to 10 000 trials on up to 1000 workers with these numbers.
"""

from __future__ import annotations

import argparse
import csv
import heapq
import os
import pickle
import random
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "TWISTCAP_THREADS": "1"}

from distributed import Client, LocalCluster

from twistcap.commands.study import Jobs, run_study
from twistcap.commands.study_jobs import Outcome, run_trial
from twistcap.commands.track import run_session
from twistcap.io import tidy
from twistcap.io.session import load_session
from twistcap.io.study import StudyFile, Trial, load_study
from twistcap.io.synthetic import write_session
from twistcap.studio import StudioConfig, capture

SUBJECTS, TRIALS, WORKERS = 3, 8, 2
SEED = 100  # of the first subject
FITTED = '[body]\nframes = 1\n[refine]\nrounds = 2\ncoarse_rounds = 1\n[output]\nexports = ["mot"]\n'
PLAIN = 'refine = false\n[body]\nfit = false\n[output]\nexports = ["mot"]\noverlay = false\n'


def made(folder: Path, frames: int, table: str) -> Path:
    """A study of 24 studio trials: each subject walks at eight speeds."""
    for subject in range(SUBJECTS):
        for trial in range(TRIALS):
            config = StudioConfig(SEED + subject, 2, (192, 140), frames=frames, speed_factor=0.8 + 0.05 * trial)
            write_session(capture(config), folder / "data" / f"s{subject}" / f"t{trial}", masks=False)
    head, _, rest = table.partition("[")
    (folder / "study.toml").write_text(f'trials = "data"\n{head}[{rest}')
    return folder / "study.toml"


# kill


@contextmanager
def killing(out: Path, workers: Callable[[], list[int]], rng: random.Random) -> Generator[None]:
    """One of the workers is killed meanwhile, when a random number of trials has been begun. Raises RuntimeError where
    none was killed.
    """
    begun, killed = rng.randint(1, SUBJECTS * TRIALS - WORKERS), list[int]()

    def kill() -> None:
        while len(list(out.rglob("result.h5"))) < begun:
            time.sleep(0.02)
        time.sleep(rng.uniform(0.0, 2.0))
        killed.append(rng.choice(sorted(workers())))
        os.kill(killed[0], signal.SIGKILL)
        print(f"  killed worker {killed[0]} after trial {begun} was begun", flush=True)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    yield
    thread.join(timeout=10.0)
    if not killed:
        raise RuntimeError("no worker was killed, so nothing is shown")


def own_workers() -> list[int]:
    return [child.pid for child in active_children() if child.pid]


def kills(folder: Path, count: int) -> int:
    """Faults found."""
    study, faults = load_study(made(folder, 10, FITTED)), 0
    run_study(study, _fresh(folder / "whole"), WORKERS)
    for number in range(count):
        rng, out = random.Random(number), _fresh(folder / "killed")
        with killing(out, own_workers, rng):
            run_study(study, out, WORKERS)
        faults += _compared(f"processes, kill {number}", folder / "whole", out)
    for number in range(count):
        rng, out = random.Random(100 + number), _fresh(folder / "killed")
        with LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=None) as cluster:
            pids = list(Client(cluster).run(os.getpid).values())
            with killing(out, pids.copy, rng):
                run_study(study, out, cluster=cluster.scheduler_address)
        faults += _compared(f"Dask, kill {number}", folder / "whole", out)
    return faults


def _fresh(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


def _compared(name: str, whole: Path, out: Path) -> int:
    files = ("trials.csv", "angles.csv", "angles.parquet")
    differ = [file for file in files if (whole / file).read_bytes() != (out / file).read_bytes()]
    rows = list(csv.DictReader((out / "trials.csv").open()))
    done = len({(row["subject"], row["trial"]) for row in rows if row["status"] == "done"})
    print(f"{name}: {done} of {len(rows)} trials done; other than without a kill: {differ or 'nothing'}", flush=True)
    return len(differ) + (done != SUBJECTS * TRIALS) + (len(rows) != SUBJECTS * TRIALS)


# overhead


def tracked(session: Path, out: Path) -> None:
    """One trial without any study."""
    out.mkdir(parents=True)
    run_session(load_session(session, {"output.exports": ["mot"], "output.overlay": False}), out)


def timed(work: Callable[[], Any]) -> tuple[float, float]:
    """Wall and CPU seconds, of this process and its children."""

    def cpu() -> float:
        spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(one.ru_utime + one.ru_stime for one in spent)

    wall, before = time.perf_counter(), cpu()
    work()
    for child in active_children():  # what a child has spent counts when it has ended
        child.join()
    return time.perf_counter() - wall, cpu() - before


def overhead(folder: Path, frames: int, times: int) -> None:
    study = load_study(made(folder, frames, PLAIN))

    def plainly(trials: tuple[Trial, ...] = study.trials) -> None:
        out = _fresh(folder / "plain")
        with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
            list(pool.map(tracked, [t.session for t in trials], [t.folder(out) for t in trials]))

    def by_study() -> None:
        run_study(study, _fresh(folder / "study"), WORKERS)

    plainly(study.trials[:WORKERS])  # kernels are compiled
    pairs = [(timed(plainly), timed(by_study)) for _ in range(times)]
    for name, k in (("wall", 0), ("CPU", 1)):
        plain, ours = (sorted(pair[which][k] for pair in pairs)[times // 2] for which in (0, 1))
        print(f"{name}: {plain:.1f} s tracked alone, {ours:.1f} s as a study: {100 * (ours / plain - 1):+.1f} %")


# growth


@dataclass(frozen=True)
class Laboratory:
    """One trial of a large study, and where it is done."""

    frames: int = 3600  # a minute at 60 Hz
    frame_s: float = 0.015  # four views of half HD, in one thread
    read: float = 240e6  # bytes of four videos of 8 Mbit/s
    storage: float = 1.25e9  # bytes/s: one link of 10 Gbit/s
    coordinates: int = 40


def nothing(trial: Trial, about: StudyFile, study: Path) -> Outcome:
    """A trial that costs nothing but its way."""
    return Outcome("", 3600, 0, {"track": 54.0, "rows": 1.0})


def scheduler_time(trials: int, workers: int) -> float:
    """Seconds a trial that a real scheduler, and the study before it, spend on the way there and back."""
    about = StudyFile(trials="trials.csv")
    jobs = [
        Trial(f"s{k // 10:04d}", f"t{k % 10}", Path(f"/data/s{k // 10:04d}/t{k % 10}.toml"), {}) for k in range(trials)
    ]
    here = LocalCluster(  # all workers in this process: only the scheduler's work and theirs is of interest
        n_workers=workers, threads_per_worker=1, processes=False, memory_limit=0, dashboard_address=None
    )
    with here as cluster, Client(cluster) as client:
        running = Jobs(client.get_executor())
        start = time.process_time()
        running.begin_all(tuple(jobs), nothing, about, Path("/out"))
        assert sum(1 for _ in running.ended()) == trials
        return (time.process_time() - start) / trials


def table_rates(folder: Path, rows: int = 1_000_000) -> tuple[float, float, float]:
    """Bytes of a row; bytes/s at which parts are joined, and turned into Parquet."""
    line = "subject01,trial01,{n},{t},knee_angle_r,deg,{v:.6f},0.412345,ok\n"
    part = folder / "part.csv"
    with part.open("w") as file:
        file.write(",".join(tidy.FRAME) + "\n")
        file.writelines(line.format(n=n // 40, t=n / 2400, v=random.uniform(-90, 90)) for n in range(rows))
    size, start = part.stat().st_size, time.perf_counter()
    tidy.join(folder / "angles.csv", tidy.FRAME, [part])
    joined = time.perf_counter()
    tidy.to_parquet(folder / "angles.csv")
    return size / rows, size / (joined - start), size / (time.perf_counter() - joined)


def simulated(trials: int, workers: int, send_s: float, lab: Laboratory) -> tuple[float, float, float]:
    """Hours until the last trial ends, and how busy scheduler and storage are (0 to 1).

    The scheduler sends one trial at a time; the storage is shared evenly by the workers that run.
    """
    free, sent, end = [0.0] * workers, 0.0, 0.0
    running = min(trials, workers)
    took = max(lab.frames * lab.frame_s, lab.read * running / lab.storage)  # decoding goes on while tracking
    for _ in range(trials):
        sent = max(sent, heapq.heappop(free)) + send_s
        end = max(end, sent + took)
        heapq.heappush(free, sent + took)
    return end / 3600, trials * send_s / end, trials * lab.read / lab.storage / end


def growth(folder: Path, trials: int, workers: int) -> None:
    lab, send_s = Laboratory(), scheduler_time(trials, workers)
    trial, about = Trial("s0001", "t1", Path("/data/s0001/t1.toml"), {}), StudyFile(trials="trials.csv")
    to = len(pickle.dumps((run_trial, trial, about, Path("/out"))))
    back = len(pickle.dumps(nothing(trial, about, Path())))
    print(
        f"a trial: {to} bytes to the worker, {back} back; {1e3 * send_s:.2f} ms of CPU ({trials} on {workers} workers)"
    )
    row, join, parquet = table_rates(folder)
    per_trial = row * lab.frames * lab.coordinates
    print(f"table: {row:.0f} bytes a row, joined at {join / 1e6:.0f} MB/s, made Parquet at {parquet / 1e6:.0f} MB/s")
    print(
        "trials workers | hours of trials | ideal | scheduler busy | storage busy | GB read, table | minutes of table"
    )
    for n in (24, 1000, 10_000):
        for w in (1, 10, 100, 1000):
            hours, scheduler, storage = simulated(n, w, send_s, lab)
            ideal = n * lab.frames * lab.frame_s / w / 3600
            size, late = n * per_trial, n * per_trial * (1 / join + 1 / parquet) / 60
            busy = f"{100 * scheduler:13.2f}% | {100 * storage:11.0f}%"
            print(f"{n:6} {w:7} | {hours:15.2f} | {ideal:5.2f} | {busy} | "
                  f"{n * lab.read / 1e9:7.0f}, {size / 1e9:5.1f} | {late:8.1f}")  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("kill", "overhead", "growth"))
    parser.add_argument("--kills", type=int, default=2)
    parser.add_argument("--frames", type=int, default=150, help="of each trial, for the overhead")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--trials", type=int, default=2000, help="of the measured scheduler")
    parser.add_argument("--workers", type=int, default=20, help="of the measured scheduler")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        if options.what == "kill":
            sys.exit(kills(Path(place), options.kills))
        if options.what == "overhead":
            overhead(Path(place), options.frames, options.times)
        else:
            growth(Path(place), options.trials, options.workers)
