"""How much of a loss is luck: TWISTCAP_DATA=... PYTHONPATH=. python benchmarks/draws.py [--draws 0-5] [cam01+cam03 …]

Each pair of cameras of the real recording is tracked from first poses that are 0.0001 rad and 0.1 mm apart; draw 0 is
the first pose as it is. Printed are, draw by draw, the frames lost by the reference, those that the tracker flags, and
the median of the joints in mm.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from reproduce.__main__ import parsed_seeds
from reproduce.experiments.real_recording import EXAMPLES, PAIRS, against_reference, tracked
from twistcap.body import Pose

APART = 1e-4  # rad and m


def moved(draw: int, pose: Pose) -> Pose:
    """A first pose next to another."""
    step = APART * np.random.default_rng(1000 + draw).normal(size=6 + len(pose.q))
    return pose.retract(step) if draw else pose


def measured(pair: str, draw: int) -> tuple[int, int, float]:
    """Frames lost, frames flagged, and mm."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "result.h5"
        tracked(EXAMPLES / "balance_4view.toml", PAIRS[pair], path, started=partial(moved, draw))
        found = {row["metric"]: row["value"] for row in against_reference(pair, path)}
    return int(found["lost"]), int(found["by itself"]), round(found["joints"], 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", default="0-5")
    parser.add_argument("pairs", nargs="*", metavar="PAIR", help=", ".join(PAIRS))
    args = parser.parse_args()
    if unknown := set(args.pairs) - set(PAIRS):
        parser.error(f"no pair {', '.join(sorted(unknown))}; choose of {', '.join(PAIRS)}")
    cv2.setNumThreads(1)
    for pair in args.pairs or PAIRS:
        print(pair, *(measured(pair, draw) for draw in parsed_seeds(args.draws)), sep="  ", flush=True)


if __name__ == "__main__":
    main()
