"""``python -m tests.fuzz --budget N``: damaged files through all readers; with ``--results N`` through the commands."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.fuzz.commands import hunt_commands
from tests.fuzz.hunt import hunt
from tests.fuzz.targets import targets


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=int, default=0, help="damaged files over all readers")
    parser.add_argument("--results", type=int, default=0, help="damaged result files through the commands")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="readers whose names begin with this")
    chosen = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="fuzz_"))
    (folder / "seeds").mkdir()
    readers = {name: t for name, t in targets(folder / "seeds").items() if name.startswith(chosen.only)}
    faults = hunt(readers, chosen.budget, chosen.seed, folder, print) if chosen.budget else []
    faults += hunt_commands(chosen.results, chosen.seed, folder, print) if chosen.results else []
    for fault in faults:
        print(fault)
    print(f"{len(faults)} faults; damaged files of faults are in {folder}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
