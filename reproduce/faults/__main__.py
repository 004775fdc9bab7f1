"""``python -m reproduce.faults FOLDER …``: the table of runs that ``python -m reproduce faults --out`` has kept."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from reproduce.faults.measures import tables
from reproduce.faults.runs import Run

if __name__ == "__main__":
    files = [file for folder in sys.argv[1:] for file in sorted(Path(folder).glob("run-*.json"))]
    print(tables([Run.of(json.loads(file.read_text())) for file in files]) if files else "no runs")
