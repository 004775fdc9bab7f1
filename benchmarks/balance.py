"""The tracker on the real recording: a table over frame rates and camera pairs.

    TWISTCAP_DATA=... python benchmarks/balance.py [--arms 60 30 20 cam01+cam02 ...] [--set KEY=VALUE]

Body and first pose are those that four cameras give, in every arm; what differs is what the tracker sees afterwards.
An arm whose table line of the same settings stands in --out already is not run again.
"""

from __future__ import annotations

import argparse
import json
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
from balance_rows import against_reference

from twistcap.commands.track import parsed_settings
from twistcap.io.recording import open_recording, rig_of, views_of
from twistcap.io.result import ResultWriter
from twistcap.io.session import load_session
from twistcap.track import Tracker

SESSION = Path(__file__).parents[1] / "examples" / "balance_4view.toml"
CAMERAS = ("cam01", "cam02", "cam03", "cam04")
STEPS = {"60": 1, "30": 2, "20": 3}
ARMS = [*STEPS, *("+".join(pair) for pair in combinations(CAMERAS, 2))]
COLUMNS = ("frames", "lost", "by itself", "IoU", "joints", "offset removed")


def followed(path: Path, arm: str, settings: dict[str, Any]) -> None:
    """Track the session, at a lower rate or in fewer cameras, into a result file."""
    own = {"step": STEPS[arm]} if arm in STEPS else {"cameras.use": arm.split("+")}
    whole, session = load_session(SESSION, settings), load_session(SESSION, {**settings, **own})
    recording, rig = open_recording(whole), rig_of(session)
    views = views_of(session, rig)
    tracker = Tracker(recording.body, views.image_rig, session.tracker_config)
    tracker.start(recording.first_pose, recording.first_time)
    with ResultWriter(path, recording.body, recording.rig, session.model_dump(mode="json")) as writer:
        for frame in views:
            writer.append(tracker.step(frame))


def main() -> None:
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", nargs="*", default=ARMS, choices=ARMS)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("out/balance-table"))
    options = parser.parse_args()
    print(f"{'arm':14}" + "".join(f"{name:>16}" for name in COLUMNS))
    for arm in options.arms:
        folder = options.out / arm
        folder.mkdir(parents=True, exist_ok=True)
        kept = folder / "line.json"
        if not kept.exists() or json.loads(kept.read_text())["set"] != options.set:
            followed(folder / "result.h5", arm, parsed_settings(options.set))
            kept.write_text(json.dumps({"set": options.set, **against_reference(folder / "result.h5")}))
        found = json.loads(kept.read_text())
        print(f"{arm:14}" + "".join(f"{found[name]:16.3f}" for name in COLUMNS), flush=True)


if __name__ == "__main__":
    main()
