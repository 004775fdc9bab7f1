"""What `balance_4view`'s reference says of a result file: shared by the tables of that recording."""

from __future__ import annotations

import os
from pathlib import Path

from twistcap.evaluate.reference import evaluate
from twistcap.io.result import read_result

FLAWED = ("wrist_r:75-79", "wrist_r:86-92")  # of the reference
ROWS = {
    "IoU": "IoU, mean",
    "joints": "joints, median",
    "offset removed": "joints, median, offset removed",
    "lost": "lost frames, by the reference",
    "by itself": "lost frames, by the tracker itself",
}


def against_reference(path: Path) -> dict[str, float]:
    """Frames of a result, overlap, joints in mm, and lost frames, by column."""
    data = Path(os.environ["TWISTCAP_DATA"]) / "balance_4view"
    result = read_result(path)
    points = evaluate(result, data / "reference" / "keypoints3d_world.npz", 0.02167, exclude=FLAWED)
    rows = {r["metric"]: r["value"] for r in (*points.rows, *evaluate(result, data / "masks").rows)}
    return {"frames": float(len(result.indices)), **{column: float(rows[name]) for column, name in ROWS.items()}}
