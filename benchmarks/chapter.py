"""The chapter's own system on the real recording: a table over channels and statistics.

    TWISTCAP_DATA=... TWISTCAP_PRIOR=walk.npz python benchmarks/chapter.py [--arms lab/part ...] [--set KEY=VALUE]

Level set, no photometric term, flow prediction, prior: as `examples/balance_4view_chapter.toml` says. Results are kept
in --out, one folder for each arm, and an arm whose table line stands there already is not run again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np
from balance_rows import against_reference

from twistcap.commands.track import parsed_settings
from twistcap.io.recording import open_recording
from twistcap.io.result import ResultWriter
from twistcap.io.session import load_session
from twistcap.track import Tracker

SESSION = Path(__file__).parents[1] / "examples" / "balance_4view_chapter.toml"
ARMS = [f"{c}/{s}" for s in ("part", "whole") for c in ("grey", "lab", "grey+texture", "lab+texture")]
COLUMNS = ("IoU", "joints", "offset removed", "lost", "by itself", "ms")


def followed(path: Path, settings: dict[str, Any]) -> float:
    """Track the session into a result file; median milliseconds of a frame, decoding apart."""
    session = load_session(SESSION, settings)
    recording = open_recording(session)
    tracker = Tracker(recording.body, recording.views.image_rig, session.tracker_config, session.pose_prior)
    tracker.start(recording.first_pose, recording.first_time)
    times = list[float]()
    with ResultWriter(path, recording.body, recording.rig, session.model_dump(mode="json")) as writer:
        for frame in recording.views:
            began = perf_counter()
            writer.append(tracker.step(frame))
            times.append(1000.0 * (perf_counter() - began))
    return float(np.median(times[1:]))


def main() -> None:
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", nargs="*", default=ARMS)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("out/chapter"))
    options = parser.parse_args()
    print(f"{'channels / statistics':24}" + "".join(f"{name:>16}" for name in COLUMNS))
    for arm in options.arms:
        channels, statistics = arm.split("/")
        folder = options.out / arm.replace("/", "-")
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "line.json").exists():
            settings = {"tracker.channels": channels, "tracker.statistics": statistics, **parsed_settings(options.set)}
            ms = followed(folder / "result.h5", settings)
            (folder / "line.json").write_text(json.dumps({**against_reference(folder / "result.h5"), "ms": ms}))
        found = json.loads((folder / "line.json").read_text())
        print(f"{arm:24}" + "".join(f"{found[name]:16.3f}" for name in COLUMNS), flush=True)


if __name__ == "__main__":
    main()
