"""Kill `twistcap track` again and again; nothing that was acknowledged may be lost, and a resumed track is the same.

A child of this process tracks a small studio recording and tells each frame that `append` has returned from. It is
killed (SIGKILL) about a random frame, every third track within 0.2 s of the creation of its result file. At once the
file is read with plain h5py: all frames that were told must be there, equal to the undisturbed run. Then it is resumed,
some are killed again, and in the end every dataset must equal the undisturbed run's, bit for bit.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "TWISTCAP_THREADS": "1"}  # threads do not survive a fork

import cv2
import h5py
import numpy as np

from twistcap.cli import main
from twistcap.commands import outputs
from twistcap.io.result import ResultWriter, read_state

FRAMES = 24
SOON = 0.2  # s after the creation of the result file
JITTER = 0.02  # s after a frame
AGAIN = 0.3  # share of resumed runs that are killed too


def child(arguments: list[str], told: int) -> None:
    """Track, and tell every frame that has been written."""
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    append = ResultWriter.append

    def telling(self: ResultWriter, estimate: object) -> None:
        append(self, estimate)  # type: ignore[arg-type]
        os.write(told, int(estimate.index).to_bytes(2, "little"))  # type: ignore[attr-defined]

    ResultWriter.append = telling  # type: ignore[method-assign,assignment]
    code = 1
    try:
        main(arguments)
    except SystemExit as done:
        code = int(done.code or 0)
    finally:
        os._exit(code)


def run(arguments: list[str], wait: Callable[[BinaryIO], bytes] | None) -> tuple[int, int]:
    """Status of a child that is killed after `wait` (None: left alone), and how many frames it has told of."""
    reading, told = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(reading)
        child(arguments, told)
    os.close(told)
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        data = b""
        if wait is not None:
            data = wait(pipe)
            os.kill(process, signal.SIGKILL)
        _, status = os.waitpid(process, 0)
        data += pipe.read()
    indices = np.frombuffer(data, "<u2")
    return status, 1 + int(indices.max()) if len(indices) else 0


def soon_after(path: Path, delay: float) -> Callable[[BinaryIO], bytes]:
    """Waits until a file is there, and a little longer."""

    def wait(_: BinaryIO) -> bytes:
        end = time.monotonic() + 30.0
        while not path.exists() and time.monotonic() < end:
            time.sleep(0.0005)
        time.sleep(delay)
        return b""

    return wait


def after_frames(count: int, delay: float) -> Callable[[BinaryIO], bytes]:
    """Waits until so many frames have been told of, and a little longer; gives what has been told."""

    def wait(pipe: BinaryIO) -> bytes:
        data = b""
        while len(data) < 2 * count and (more := pipe.read(2)):
            data += more
        time.sleep(delay)
        return data

    return wait


def frames_of(path: Path) -> dict[str, np.ndarray]:
    """All datasets of the frames, by plain h5py, as far as they are written."""
    found: dict[str, np.ndarray] = {}
    with h5py.File(path) as file:
        index = file["frames/index"][:]
        count = len(index) if (index >= 0).all() else int(np.argmin(index >= 0))
        file["frames"].visititems(
            lambda name, item: found.update({name: item[:count]}) if isinstance(item, h5py.Dataset) else None
        )
    return found


def same(found: dict[str, np.ndarray], whole: dict[str, np.ndarray], count: int) -> bool:
    """Whether the first frames are those of the undisturbed run, bit for bit."""
    return all(held.tobytes() == whole[name][:count].tobytes() for name, held in found.items())


def trial(number: int, arguments: list[str], folder: Path, whole: dict[str, np.ndarray]) -> Counter[str]:
    """One track that is killed, once or more, and resumed to its end."""
    rng, counts, path, kept = random.Random(number), Counter[str](), folder / "result.h5", 0
    resume: list[str] = []
    while True:
        early = number % 3 == 0 and not resume
        frames = rng.randrange(FRAMES - (len(frames_of(path)["index"]) if path.exists() else 0) + 1)
        wait = soon_after(path, rng.uniform(0.0, SOON)) if early else after_frames(frames, rng.uniform(0.0, JITTER))
        status, told = run([*arguments, *resume], wait)
        kept = max(kept, told)
        counts["killed" if os.WIFSIGNALED(status) else "ended before"] += 1
        counts["killed soon after creation"] += early and os.WIFSIGNALED(status)
        try:
            found = frames_of(path) if path.exists() else {"index": np.zeros(0)}
        except (OSError, KeyError, RuntimeError) as error:
            print(f"trial {number}: not readable: {error}", file=sys.stderr)
            counts["not readable"] += 1
            return counts
        counts["killed with frames"] += bool(len(found["index"]))
        counts["frames lost"] += max(0, kept - len(found["index"]))
        counts["frames differ"] += not same(found, whole, len(found["index"])) if len(found["index"]) else 0
        resume = ["--resume"]
        if rng.random() > AGAIN:
            break
    status, _ = run([*arguments, "--resume"], None)
    counts["resume failed"] += status != 0
    found = frames_of(path)
    counts["resumed differ"] += (
        len(found["index"]) != FRAMES or found.keys() != whole.keys() or not same(found, whole, FRAMES)
    )
    counts["litter"] += sum(1 for item in folder.iterdir() if item.name != "result.h5")
    return counts


def bench(kills: int, folder: Path) -> Counter[str]:
    """So many kills, each followed by a resumed run."""
    session = ["track", str(folder / "walk" / "session.toml"), "--set", "output.report=false", "--out"]
    made = ["studio", str(folder / "walk"), "--size", "192x140", "--views", "2", "--frames", str(FRAMES)]
    assert run(made, None)[0] == 0
    with suppress(SystemExit):  # here, so that all children find all modules and kernels loaded
        main([*session, str(folder / "warm")])
    status, told = run([*session, str(folder / "whole")], None)
    assert status == 0 and told == FRAMES and read_state(folder / "whole" / "result.h5") is not None
    whole, total = frames_of(folder / "whole" / "result.h5"), Counter[str]()
    number = 0
    while total["killed"] < kills:
        out = folder / "out"
        out.mkdir()
        total += trial(number, [*session, str(out)], out, whole)
        shutil.rmtree(out)
        number += 1
        if number % 25 == 0:
            print(number, dict(total), file=sys.stderr, flush=True)
    return total


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=500)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    outputs.write_files = lambda *_: []  # type: ignore[assignment]  # plots take their time and are not at stake
    with tempfile.TemporaryDirectory() as made:
        found = bench(options.kills, Path(made))
    bad = ("not readable", "frames lost", "frames differ", "resume failed", "resumed differ")
    for name in (*found, *(name for name in bad if name not in found)):
        print(f"{name}: {found[name]}")
    sys.exit(any(found[name] for name in bad))
