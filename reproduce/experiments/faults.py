"""The fault bench: captures with everyday faults, tracked, and whether the tracker says when it is lost.

Each seed is one capture: person, room, motion, cameras, rate, and a kind of fault, somewhere in it. Kinds
follow each other over the seeds.

    python -m reproduce faults --seeds 0-54 --out out/faults
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from reproduce.arms import Findings
from reproduce.faults.drawing import course_picture, error_picture, reliability_picture
from reproduce.faults.measures import rows, tables
from reproduce.faults.runs import Run, run_seed
from reproduce.running import Tell, jobs, over_seeds


@dataclass(frozen=True)
class FaultBench:
    """The experiment; its folder gets the table, a file with everything by frame for each seed, and pictures."""

    id: str = "faults"
    says: str = "captures with everyday faults: is the body lost, does the tracker say so, is it found again"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """Film and track every seed; as many at once as the environment variable JOBS says, by default 1."""
        runs = over_seeds(run_seed if out is None else partial(kept_run, out), seeds, progress, self.id, jobs(1))
        if out is not None:
            (out / "table.txt").write_text(tables(runs) + "\n")
            course_picture(out / "courses.png", runs)
            error_picture(out / "errors.png", runs)
            if any(np.isfinite(r.probability).any() for r in runs):
                reliability_picture(out / "reliability.png", runs)
        return Findings(rows(runs), "", (), text=tables(runs))


def kept_run(folder: Path, seed: int) -> Run:
    """The run of a seed, kept in a folder as soon as it is done."""
    run = run_seed(seed)
    (folder / f"run-{seed:04d}.json").write_text(json.dumps(run.document()))
    return run


FAULTS = FaultBench()
