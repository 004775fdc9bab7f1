"""Damaged files through a reader in a child process: each must be read, or refused in one sentence that names it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import random
import resource
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.mutations import mutate
from tests.fuzz.targets import Target
from twistcap.errors import InputError

_MEMORY = 1 << 30  # bytes beyond what the process has at its start
_SECONDS = 10.0
_CHILDREN = (".h5",)  # kinds that are read in another process, and take longer


@dataclass(frozen=True)
class Fault:
    """What a reader did that it must not; `kept` is the damaged file."""

    target: str
    number: int
    what: str
    kept: Path

    def __str__(self) -> str:
        return f"{self.target} {self.number}: {self.what} ({self.kept})"


def hunt(
    targets: Mapping[str, Target], budget: int, seed: int, folder: Path, told: Callable[[str], None]
) -> list[Fault]:
    """About `budget` damaged files over all readers; those that are read in another process get a tenth of a share."""
    slow = sum(target.seed.suffix in _CHILDREN for target in targets.values())
    share = max(1, round(budget / (len(targets) - 0.9 * slow)))
    found: list[Fault] = []
    for name, target in targets.items():
        count = max(1, share // 10) if target.seed.suffix in _CHILDREN else share
        began, before = time.perf_counter(), len(found)
        found += through(name, target, range(count), seed, folder)
        told(f"{name}: {count} in {time.perf_counter() - began:.1f} s, {len(found) - before} faults")
    return found


def through(name: str, target: Target, numbers: range, seed: int, folder: Path) -> list[Fault]:
    """All numbers of one reader, in as many children as it takes."""
    context: Any = multiprocessing.get_context("fork")
    found: list[Fault] = []
    at, mine = numbers.start, folder / name.replace(" ", "_")
    mine.mkdir(parents=True, exist_ok=True)
    while at < numbers.stop:
        queue, reached = context.SimpleQueue(), context.Value("q", at)
        child = context.Process(target=_child, args=(name, target, range(at, numbers.stop), seed, mine, queue, reached))
        child.start()
        last, since = -1, time.monotonic()
        while child.is_alive():
            child.join(0.02)
            while not queue.empty():
                found.append(queue.get())
            if reached.value != last:
                last, since = reached.value, time.monotonic()
            elif time.monotonic() - since > 6 * _SECONDS:
                child.kill()
        while not queue.empty():
            found.append(queue.get())
        at = numbers.stop if child.exitcode == 0 else reached.value + 1
        if child.exitcode:
            found.append(Fault(name, at - 1, f"the process ended with {child.exitcode}", mine))
    return found


def _child(name: str, target: Target, numbers: range, seed: int, folder: Path, queue: Any, reached: Any) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # decoders talk
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(InputError):
        target.read(target.seed)  # kernels are compiled
    for number in numbers:
        reached.value = number
        path = folder / target.seed.name
        rng = random.Random(f"{name} {seed} {number}")
        mutate(target.seed, path, rng)
        began, what = _worked(), ""
        try:
            target.read(path)
        except InputError as error:
            what = _wrong(str(error), folder, target.seed.parent)
        except Exception as error:
            what = f"{type(error).__name__}: {error}"[:200] + _place(error)
        if _worked() - began > _SECONDS:
            what = what or f"{_worked() - began:.1f} s of processor time"
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
        if most - held > _MEMORY:
            what, held = what or f"{(most - held) >> 20} MB", most
        if what:
            kept = folder / f"fault_{number}{path.suffix}"
            mutate(target.seed, kept, random.Random(f"{name} {seed} {number}"))
            queue.put(Fault(name, number, what, kept))
    shutil.rmtree(folder / "cam0", ignore_errors=True)


def _worked() -> float:
    """Seconds of the processor for this process and its children; other work of the machine does not count."""
    return time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def _wrong(sentence: str, folder: Path, seeds: Path) -> str:
    if len(sentence) >= 300 or not sentence.isprintable():
        return f"the sentence is long or not printable: {sentence!r}"
    if folder.name not in sentence and str(seeds) not in sentence:
        return f"the sentence names no file: {sentence!r}"
    return ""


def _place(error: BaseException) -> str:
    trace, ours = error.__traceback__, ""
    while trace is not None:
        if "twistcap" in trace.tb_frame.f_code.co_filename:
            ours = f" at {Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return ours
